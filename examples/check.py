#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""An example ends well by itself and after Ctrl-C, and leaves nothing behind either way.

    check.py PROGRAM
"""

import glob
import os
import random
import signal
import subprocess
import sys
import time

PATIENCE = 250  # seconds; a watchdog, not a measure


def files():
    directory = os.environ.get("LOT_DIR", "/dev/shm")
    return glob.glob(os.path.join(directory, os.environ["LOT_SEGMENT"] + "*"))


def wait_until(what, true):
    end = time.monotonic() + PATIENCE
    while not true():
        if time.monotonic() > end:
            sys.exit(f"waited in vain: {what}")
        time.sleep(0.002)


def run(program, delay):
    """Returns the exit code. With a delay: Ctrl-C so much after its segment has come."""
    process = subprocess.Popen([program], start_new_session=True)
    try:
        if delay is not None:
            wait_until("its segment", lambda: files() or process.poll() is not None)
            time.sleep(delay)
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGINT)
        code = process.wait(PATIENCE)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    wait_until("its processes leave", lambda: not files())
    return code


def main():
    program = sys.argv[1]
    os.environ["LOT_SEGMENT"] += f"_{os.getpid()}"
    seed = random.SystemRandom().getrandbits(32)
    chance = random.Random(seed)
    try:
        code = run(program, None)
        if code != 0:
            sys.exit(f"by itself: exit code {code}")
        for _ in range(5):
            delay = chance.uniform(0, 0.3)
            code = run(program, delay)
            if code not in (0, -signal.SIGINT):
                sys.exit(f"Ctrl-C after {delay:.3f} s (seed {seed}): exit code {code}")
    finally:
        for name in files():
            os.remove(name)


main()
