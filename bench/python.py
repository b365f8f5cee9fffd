#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""What the package for Python costs, beside multiprocessing.shared_memory, a Unix socket with pickle, and pyzmq (where
it is installed), in one run, in turn.

    python.py PACKAGES [--rounds N] [--json FILE] [--cpp PROGRAM] [--quick]

PACKAGES: the folder that has lot/; PROGRAM: of python_arm.cpp, which is LOT in C++; --quick: that it works, not how fast.

  view      a frame from the call that receives it to an array of numpy that shows it, in microseconds, for frames of
            several sizes: one after another. LOT's have all been sent by then; the other arms have no room for so many
  rested    the same where the reader has slept for 20 ms before each frame: the processor has other things in its caches
  small     messages of 16 bytes a second, from before the first push to after the last receipt, from one process to
            another: both ends work as fast as they can
  parked    a message at 30 Hz, from before its push to after its receipt, in microseconds: the reader sleeps

Each array is read at its last byte, which says which frame it must be.
"""

import argparse
import json
import multiprocessing
import multiprocessing.shared_memory
import os
import pickle
import socket
import statistics
import struct
import subprocess
import sys
import tempfile
import time

arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
arguments.add_argument('packages')
arguments.add_argument('--rounds', type=int, default=5)
arguments.add_argument('--json')
arguments.add_argument('--cpp')
arguments.add_argument('--quick', action='store_true')
OPTIONS = arguments.parse_args()
sys.path.insert(0, OPTIONS.packages)

import lot  # noqa: E402
import numpy as np  # noqa: E402

try:
    import zmq
except ImportError:
    zmq = None

SIZES = (1 << 10, 1 << 20) if OPTIONS.quick else (1 << 10, 1 << 16, 1 << 20, 16 << 20)
FRAMES, SMALL, PARKED = (4, 1000, 3) if OPTIONS.quick else (20, 100_000, 60)
HZ = 30


@lot.message
class Frame:
    number: lot.u64
    data: lot.vector[lot.u8]


@lot.message
class Small:
    number: lot.u64
    stamp: lot.u64


class Lot:
    """Each arm has the two ends of one pair of processes; a frame is an array of bytes."""

    def __init__(self, place):
        self.place = place

    def open(self, is_sender, what):
        self.engine = lot.Engine(segment=self.place, size_bytes=1 << 29)
        kind = Frame if what == 'frame' else Small
        if is_sender:
            self.end = self.engine.advertise('/topic', kind, policy=lot.Policy.BLOCK, block_for=60, depth=64)
            self.end.wait_for_readers()
        else:
            self.end = self.engine.subscribe('/topic', kind, wait=lot.Wait.PARK if what == 'parked' else lot.Wait.ADAPTIVE)

    def send(self, frame):
        loan = self.end.loan()
        loan.data.resize(frame.size)
        np.asarray(loan.data)[:] = frame
        self.end.push(loan)
        del loan

    def receive(self):
        return np.asarray(self.end.pull().data)

    def send_small(self, number, stamp):
        self.end.push(self.end.loan(number=number, stamp=stamp))

    def receive_small(self):
        with self.end.borrow() as small:
            return small.number, small.stamp


class Pickled:
    """A Unix socket: a length, and what pickle makes."""

    def __init__(self, place):
        self.place = f'{tempfile.gettempdir()}/{place}.socket'

    def open(self, is_sender, what):
        if is_sender:
            with socket.socket(socket.AF_UNIX) as listener:
                listener.bind(self.place)
                listener.listen()
                self.socket = listener.accept()[0]
            os.remove(self.place)
        else:
            self.socket = socket.socket(socket.AF_UNIX)
            while self.socket.connect_ex(self.place) != 0:
                time.sleep(0.001)
        self.file = self.socket.makefile('rwb', buffering=1 << 16)

    def send(self, frame):
        self.write(pickle.dumps(frame, protocol=5))

    def write(self, data):
        self.file.write(struct.pack('=Q', len(data)))
        self.file.write(data)
        self.file.flush()

    def receive(self):
        length, = struct.unpack('=Q', self.file.read(8))
        return pickle.loads(self.file.read(length))

    def send_small(self, number, stamp):
        self.write(pickle.dumps((number, stamp), protocol=5))

    receive_small = receive


class SharedMemory:
    """multiprocessing.shared_memory: two slots, whose numbers go over a pipe of multiprocessing, since it has no queue of
    its own."""

    SLOTS = 2

    def __init__(self, place):
        self.place = place
        self.near, self.far = multiprocessing.Pipe()

    def open(self, is_sender, what):
        self.pipe = self.near if is_sender else self.far
        size = self.SLOTS * SIZES[-1]
        if is_sender:
            self.memory = multiprocessing.shared_memory.SharedMemory(self.place, create=True, size=size)
            self.pipe.send('there')
            self.free = list(range(self.SLOTS))
        else:
            self.pipe.recv()
            self.memory = multiprocessing.shared_memory.SharedMemory(self.place)
            self.last = None

    def send(self, frame):
        slot = self.free.pop() if self.free else self.pipe.recv()
        np.ndarray(frame.shape, np.uint8, self.memory.buf, slot * SIZES[-1])[:] = frame
        self.pipe.send((slot, frame.size))

    def receive(self):
        if self.last is not None:
            self.pipe.send(self.last)
        self.last, size = self.pipe.recv()
        return np.ndarray((size,), np.uint8, self.memory.buf, self.last * SIZES[-1])

    def send_small(self, number, stamp):
        self.pipe.send((number, stamp))

    def receive_small(self):
        return self.pipe.recv()


class Zmq:
    def __init__(self, place):
        self.place = f'ipc://{tempfile.gettempdir()}/{place}.zmq'

    def open(self, is_sender, what):
        self.socket = zmq.Context.instance().socket(zmq.PUSH if is_sender else zmq.PULL)
        if is_sender:
            self.socket.bind(self.place)
        else:
            self.socket.connect(self.place)

    def send(self, frame):
        self.socket.send(frame)  # a copy: the next frame goes into the same memory

    def receive(self):
        return np.frombuffer(self.socket.recv(copy=False).buffer, np.uint8)

    def send_small(self, number, stamp):
        self.socket.send(struct.pack('=QQ', number, stamp))

    def receive_small(self):
        return struct.unpack('=QQ', self.socket.recv())


ARMS = {'lot': Lot, 'shared_memory': SharedMemory, 'socket and pickle': Pickled, **({'pyzmq': Zmq} if zmq else {})}


def send_frames(arm, sent, size, pause):
    frame = np.zeros(size, np.uint8)
    for number in range(FRAMES):
        frame[-1] = number
        arm.send(frame)
    sent.set()


def receive_frames(arm, sent, size, pause):
    sent.wait(1 if isinstance(arm, Lot) else 0.2)  # the others wait for the receiver
    times = []
    for number in range(FRAMES):
        time.sleep(pause)
        begin = time.perf_counter_ns()
        view = arm.receive()
        times.append((time.perf_counter_ns() - begin) / 1000)
        if view.size != size or view[-1] != number:
            raise RuntimeError(f'{type(arm).__name__}: frame {number} is another one')
        del view
    return statistics.median(times[FRAMES // 4:])


def send_small(arm, sent, count, pause):
    for number in range(count):
        if pause:
            time.sleep(pause)
        arm.send_small(number, time.monotonic_ns())


def receive_small(arm, sent, count, pause):
    delays, total, begin = [], 0, 0
    for number in range(count):
        seen, stamp = arm.receive_small()
        if pause:
            delays.append((time.monotonic_ns() - stamp) / 1000)
        total += seen
        begin = begin or stamp
    seconds = (time.monotonic_ns() - begin) / 1e9
    if total != count * (count - 1) // 2:
        raise RuntimeError(f'{type(arm).__name__}: not all messages came')
    return statistics.median(delays) if pause else count / seconds


def far_end(arm, what, work, sent, rest):
    arm.open(True, what)
    work(arm, sent, *rest)
    time.sleep(0.2)  # until all is read
    if isinstance(arm, SharedMemory):
        arm.memory.unlink()


def measure(arm_type, what, sender, receiver, *rest):
    arm, forked = arm_type(place()), multiprocessing.get_context('fork')
    sent = forked.Event()
    far = forked.Process(target=far_end, args=(arm, what, sender, sent, rest))
    far.start()
    arm.open(False, what)
    figure = receiver(arm, sent, *rest)
    far.join()
    return figure


def place():
    return f'lot_bench_{os.getpid()}_{time.monotonic_ns()}'


def measure_cpp(count, pause):
    """What measure() says of LOT: the same ends in C++."""
    env = dict(os.environ, LOT_SEGMENT=place())
    words = [str(count), str(int(pause * 1e9))]
    with subprocess.Popen([OPTIONS.cpp, 'send', *words], env=env) as sender:
        said = subprocess.run([OPTIONS.cpp, 'receive', *words], env=env, check=True, capture_output=True, text=True).stdout
    if sender.returncode != 0:
        raise RuntimeError(f'{OPTIONS.cpp} send: {sender.returncode}')
    return float(said)


def one_round(rows):
    def add(question, unit, name, figure):
        rows.setdefault((question, unit, name), []).append(figure)
    for name, arm in ARMS.items():
        for size in SIZES:
            for question, pause in (('view', 0), ('rested', 0.02)):
                add(question, f'{size >> 10} KiB, us', name, measure(arm, 'frame', send_frames, receive_frames, size, pause))
        add('small', '1/s', name, measure(arm, 'small', send_small, receive_small, SMALL, 0))
        add('parked', 'us', name, measure(arm, 'parked', send_small, receive_small, PARKED, 1 / HZ))
    if OPTIONS.cpp:
        add('small', '1/s', 'lot in C++', measure_cpp(SMALL, 0))
        add('parked', 'us', 'lot in C++', measure_cpp(PARKED, 1 / HZ))


def main():
    rows = {}
    for _ in range(1 if OPTIONS.quick else OPTIONS.rounds):
        one_round(rows)
    for (question, unit, name), figures in sorted(rows.items()):
        print(f'{question:7} {unit:14} {name:18} {statistics.median(figures):12.1f}  ({min(figures):.1f} .. {max(figures):.1f})')
    if OPTIONS.json:
        with open(OPTIONS.json, 'w') as file:
            json.dump([[*key, figures] for key, figures in rows.items()], file, indent=1)


if __name__ == '__main__':
    main()
