#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""A cable between two network namespaces that loses a share of what it carries, and delays the rest.

    forwarder.py DEVICE PROCESS PROCESS SEED LOSS_PERCENT DELAY_MS

Each of the two processes has a namespace, in which DEVICE is made, a TAP device. SIGTERM ends it, and it says what it
has carried and lost. SIGUSR1: from now on it loses nothing.
"""

import collections
import ctypes
import fcntl
import os
import random
import select
import signal
import struct
import sys
import time

SET_DEVICE, TAP, BARE_FRAMES = 0x400454CA, 0x0002, 0x1000  # linux/if_tun.h
MOST = 65536  # bytes of a frame


def device_in(process, name):
    libc = ctypes.CDLL(None, use_errno=True)
    with open(f'/proc/{process}/ns/net', 'rb') as namespace:
        if libc.setns(namespace.fileno(), 0) != 0:
            raise OSError(ctypes.get_errno(), 'setns')
    device = os.open('/dev/net/tun', os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(device, SET_DEVICE, struct.pack('16sH', name.encode(), TAP | BARE_FRAMES))
    return device


class Cable:
    def __init__(self, name, processes, seed, loss, delay):
        self.devices = [device_in(process, name) for process in processes]
        self.random = random.Random(seed)
        self.loss, self.delay = loss, delay
        self.waiting = collections.deque()  # (when, to which device, frame)
        self.carried = self.lost = 0
        self.is_over = False

    def over(self, *_):
        self.is_over = True

    def lose_nothing(self, *_):
        self.loss = 0

    def take(self, i):
        while True:
            try:
                frame = os.read(self.devices[i], MOST)
            except OSError:  # no frame; or the other end is down
                return
            if self.random.random() < self.loss:
                self.lost += 1
            else:
                self.waiting.append((time.monotonic() + self.delay, self.devices[1 - i], frame))

    def give(self):
        """What is due; returns how long the next frame has to wait."""
        while self.waiting:
            when, to, frame = self.waiting[0]
            left = when - time.monotonic()
            if left > 0:
                return left
            self.waiting.popleft()
            try:
                os.write(to, frame)
                self.carried += 1
            except OSError:
                self.lost += 1
        return 1

    def work(self):
        while not self.is_over:
            ready, _, _ = select.select(self.devices, [], [], self.give())
            for device in ready:
                self.take(self.devices.index(device))
        print(f'carried {self.carried}, lost {self.lost}', flush=True)


def main():
    name, *processes, seed, loss, delay = sys.argv[1:]
    cable = Cable(name, processes, int(seed), float(loss) / 100, float(delay) / 1000)
    signal.signal(signal.SIGTERM, cable.over)
    signal.signal(signal.SIGUSR1, cable.lose_nothing)
    print('ready', flush=True)
    cable.work()


if __name__ == '__main__':
    main()
