#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""An example ends well by itself and by SIGINT (Ctrl-C) or SIGTERM, and leaves nothing behind.

    check.py PROGRAM [ARGUMENT]...
"""

import ctypes
import glob
import os
import random
import signal
import subprocess
import sys
import time

PATIENCE = 250  # seconds; a watchdog, not a measure
PR_SET_CHILD_SUBREAPER = 36


def files():
    directory = os.environ.get("LOT_DIR", "/dev/shm")
    return glob.glob(os.path.join(directory, os.environ["LOT_SEGMENT"] + "*"))


def wait_until(what, true):
    end = time.monotonic() + PATIENCE
    while not true():
        if time.monotonic() > end:
            sys.exit(f"waited in vain: {what}")
        time.sleep(0.002)


def run(command, number=None, delay=0.0):
    """Returns the exit code, and whether a signal came in time.

    With a signal's number: sends that so much after its segment has come.
    All its processes get the signal, as from a terminal or a service manager.
    """
    in_time = False
    process = subprocess.Popen(command, start_new_session=True)
    try:
        if number is not None:
            wait_until("its segment", lambda: files() or process.poll() is not None)
            time.sleep(delay)
            in_time = process.poll() is None
            if in_time:
                os.killpg(process.pid, number)
        code = process.wait(PATIENCE)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    # Its children too: one that a signal ends later would publish to the next run.
    wait_until("its processes end", lambda: not any_left(process.pid))
    wait_until("its files go", lambda: not files())
    return code, in_time


def any_left(group):
    """Whether a process of this group lives; those that have ended are ours to wait for."""
    try:
        while os.waitpid(-group, os.WNOHANG)[0] != 0:
            continue
        return True
    except ChildProcessError:
        return False


def interrupt(command, number, chance, seed):
    """Ends it by this signal four times, at times by chance while it works."""
    ended = 0
    longest = 0.3
    for _ in range(40):
        delay = chance.uniform(0, longest)
        code, in_time = run(command, number, delay)
        if in_time and code in (-number, 0, 130):  # 0 and 130: it catches the signal itself
            ended += 1
        elif code == 0:
            longest *= 0.8  # it was through before
        else:
            sys.exit(f"{number.name} after {delay:.3f} s (seed {seed}): exit code {code}")
        if ended == 4:
            return
    sys.exit(f"{number.name} (seed {seed}): it was always through before")


def main():
    command = sys.argv[1:]
    os.environ["LOT_SEGMENT"] += f"_{os.getpid()}"
    if ctypes.CDLL(None, use_errno=True).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0) != 0:
        sys.exit(f"prctl: {os.strerror(ctypes.get_errno())}")
    seed = random.SystemRandom().getrandbits(32)
    chance = random.Random(seed)
    try:
        code, _ = run(command)
        if code != 0:
            sys.exit(f"by itself: exit code {code}")
        for number in (signal.SIGINT, signal.SIGTERM):
            interrupt(command, number, chance, seed)
    finally:
        for name in files():
            os.remove(name)


main()
