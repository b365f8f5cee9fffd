#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""What recording costs: four cameras, recorded to a tmpfs, beside `cp` of the same file.

    bench/record/record.py [--runs 5] [--quick] [--cameras PROGRAM] [--lot PROGRAM] [--to DIRECTORY]

CPU is the recorder's own, user and system, in seconds; behind it the ratio to `cp` of its file in the same run.
Each figure is the median of the runs, with the lowest and the highest of them. `push` is what a camera's loan
and push take together, and its ratio to the arm without a recorder.

A recording and its `cp` get the pages of a file that was there, which shrinks as theirs grows: so they are a guest's
own, and not given by the host at their first touch. `tmpfs` is how fast that file was written, the second time.
"""

import argparse
import contextlib
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import threading
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
ARMS = {'no recorder': None, 'CRCs off': ['--no-crc'], 'CRCs on': []}
# Title; bytes of a frame; frames a second; seconds.
ROWS = (('4 cameras of 1 MiB, 30 Hz, 60 s', 1 << 20, 30, 60), ('4 cameras of 8 MiB, 30 Hz, 8 s', 8 << 20, 30, 8))


def cpu_of(command, **how):
    """(CPU seconds of a command, what it prints). It ends with 0."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, **how)
    output = process.stdout.read()
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        sys.exit(f'record.py: {command[0]} ended with {process.returncode}')
    return used.ru_utime + used.ru_stime, output


def fill(file, size):
    """Writes so many bytes; returns GB/s."""
    piece = bytes(8 << 20)
    before = time.monotonic()
    with open(file, 'wb', buffering=0) as out:
        for _ in range(0, size, len(piece)):
            out.write(piece)
    return size / (time.monotonic() - before) / 1e9


@contextlib.contextmanager
def shrinking(warm, size, grows):
    """Meanwhile `warm`, of that size, gives up what `grows` takes, and half a GB more."""
    over = threading.Event()

    def shrink():
        while not over.wait(0.05):
            there = grows.stat().st_size if grows.exists() else 0
            os.truncate(warm, max(0, size - there - (512 << 20)))

    thread = threading.Thread(target=shrink)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        warm.unlink()


def film(arguments, row, words, directory, environment):
    """One arm: {cpu, cp, missed, push, p99, tmpfs}."""
    _, size, hz, seconds = row
    if arguments.quick:
        seconds = 2
    warm, all_bytes = directory / 'warm', 4 * size * hz * seconds
    file = directory / 'cameras.mcap'
    recorder = None
    if words is not None:
        fill(warm, all_bytes)
        tmpfs = fill(warm, all_bytes)
        recorder = subprocess.Popen([arguments.lot, 'record', '/camera/*', '--json', '-o', file, *words],
                                    stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environment)
        while not file.exists():
            if recorder.poll() is not None:
                sys.exit('record.py: lot record has ended')
            time.sleep(0.01)
    with shrinking(warm, all_bytes, file) if recorder else contextlib.nullcontext():
        _, said = cpu_of([arguments.cameras, '--bytes', str(size), '--hz', str(hz), '--seconds', str(seconds)],
                         env=environment)
    cameras = json.loads(said)
    figures = {'push': cameras['push_us_median'], 'p99': cameras['push_us_p99']}
    if recorder is None:
        return figures
    recorder.terminate()
    said = recorder.stdout.read()
    _, status, used = os.wait4(recorder.pid, 0)
    recorder.returncode = os.waitstatus_to_exitcode(status)
    if recorder.returncode != 0:
        sys.exit(f'record.py: lot record ended with {recorder.returncode}')
    topics = json.loads(said)['topics']
    recorded = sum(t['messages'] for t in topics)
    figures['tmpfs'] = tmpfs
    figures['missed'] = cameras['sent'] - recorded
    figures['cpu'] = used.ru_utime + used.ru_stime
    fill(warm, all_bytes)
    with shrinking(warm, all_bytes, directory / 'copy'):
        figures['cp'], _ = cpu_of(['cp', file, directory / 'copy'])
    figures['GB'] = file.stat().st_size / 1e9
    (directory / 'copy').unlink()
    file.unlink()
    return figures


def cell(values, digits):
    values = sorted(values)
    return f'{statistics.median(values):.{digits}f} ({values[0]:.{digits}f}-{values[-1]:.{digits}f})'


def table(rows, runs):
    lines = ['| | | tmpfs GB/s | written GB | missed | CPU s | of `cp` | push us | of no recorder | push us, 99 % |',
             '|---|---|---|---|---|---|---|---|---|---|']
    for row in rows:
        for arm, words in ARMS.items():
            got = [run[row[0], arm] for run in runs]
            alone = [run[row[0], 'no recorder'] for run in runs]
            push = cell([g['push'] for g in got], 1)
            p99 = cell([g['p99'] for g in got], 1)
            ratio = cell([g['push'] / a['push'] for g, a in zip(got, alone)], 2)
            if words is None:
                lines.append(f'| {row[0]} | {arm} | | | | | | {push} | | {p99} |')
                continue
            tmpfs = cell([g['tmpfs'] for g in got], 1)
            lines.append(f'| {row[0]} | {arm} | {tmpfs} | {got[0]["GB"]:.2f} | {max(g["missed"] for g in got)} | '
                         f'{cell([g["cpu"] for g in got], 2)} | {cell([g["cpu"] / g["cp"] for g in got], 2)} | '
                         f'{push} | {ratio} | {p99} |')
    return '\n'.join(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--runs', type=int, default=5)
    parser.add_argument('--quick', action='store_true', help='two seconds of the first row')
    parser.add_argument('--cameras', type=pathlib.Path, default=ROOT / 'build/release/bench/lot_cameras')
    parser.add_argument('--lot', type=pathlib.Path, default=ROOT / 'build/release/src/tool/lot')
    parser.add_argument('--to', type=pathlib.Path, default='/dev/shm',
                        help='a directory in a tmpfs with 17 GB free (%(default)s)')
    arguments = parser.parse_args()
    if arguments.runs < 1:
        parser.error('--runs: at least one')
    with tempfile.TemporaryDirectory(prefix='lot_record.', dir=arguments.to) as name:
        directory = pathlib.Path(name)
        environment = {**os.environ, 'LOT_DIR': name, 'LOT_SEGMENT': 'bench', 'LOT_SIZE': str(1 << 30)}
        runs = []
        rows = ROWS[:1] if arguments.quick else ROWS
        for number in range(arguments.runs):
            print(f'run {number + 1} of {arguments.runs}', file=sys.stderr, flush=True)
            figures = {}
            for row in rows:
                names = list(ARMS)
                for arm in names[number % len(names):] + names[:number % len(names)]:  # each one first in turn
                    figures[row[0], arm] = film(arguments, row, ARMS[arm], directory, environment)
            runs.append(figures)
    print(table(rows, runs))


if __name__ == '__main__':
    main()
