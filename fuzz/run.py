#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Runs the libFuzzer targets for a while, two at a time, and prints what they found.

    fuzz/run.py [--seconds 60] [--build build/fuzz] [TARGET...]

Build first: cmake --preset fuzz && cmake --build --preset fuzz. Each target starts from a copy of its
corpus; what it finds besides is kept only when somebody puts it into fuzz/corpus (docs/fuzzing.md). Exit
status 0: nothing was found. The seed of a target is the same in each run, unless --seed says otherwise.
"""

import argparse
import base64
import concurrent.futures
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parent
AT_ONCE = 2
PATIENCE = 60  # seconds that one input may take on a busy machine
LONGEST = 600  # bytes of an input
DONE = re.compile(r'^#(\d+)\s+(?:DONE|pulse|NEW|REDUCE|INITED).*?cov: (\d+).*?corp: (\d+)', re.M)

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

running = set()
stopping = False


class Stopped(Exception):
    """A signal says that it is enough."""


def run(target, binary, seconds, seed, scratch):
    """One row of the table, and what a failing run has said."""
    corpus = scratch / target / 'corpus'
    found = scratch / target / 'found'
    shutil.copytree(ROOT / 'corpus' / target, corpus)
    found.mkdir()
    command = [binary, f'-max_total_time={seconds}', f'-timeout={PATIENCE}', f'-max_len={LONGEST}',
               f'-seed={seed}', '-len_control=20', '-print_final_stats=1', f'-artifact_prefix={found}/', corpus]
    with open(scratch / target / 'log', 'w+', errors='replace') as log:
        process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, cwd=scratch)
        running.add(process)
        if stopping:  # looked at when it can be found: stop() does it the other way round
            process.kill()
        process.wait()
        running.discard(process)
        log.seek(0)
        text = log.read()
    last = DONE.findall(text)
    coverage, kept = last[-1][1:] if last else ('-', '-')
    stat = dict(re.findall(r'^stat::(\w+):\s+(\d+)', text, re.M))
    inputs = [(f.name, base64.b64encode(f.read_bytes()).decode()) for f in sorted(found.iterdir())
              if not f.name.startswith('slow-unit-')]
    good = process.returncode == 0 and not inputs
    return {'target': target, 'runs': int(stat.get('number_of_executed_units', 0)),
            'speed': stat.get('average_exec_per_sec', '-'), 'coverage': coverage, 'corpus': kept,
            'good': good, 'inputs': inputs, 'tail': '' if good else text[-6000:]}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--seconds', type=int, default=60, help='for each target (default: 60)')
    parser.add_argument('--build', type=pathlib.Path, default=ROOT.parent / 'build' / 'fuzz',
                        help='a tree built with LOT_BUILD_FUZZ (default: build/fuzz)')
    parser.add_argument('--seed', type=int, default=1, help='of libFuzzer; 0: another one each time')
    parser.add_argument('target', nargs='*', help='such as ring (default: all)')
    arguments = parser.parse_args()

    binaries = {b.name.removesuffix('_fuzz'): b.resolve() for b in sorted((arguments.build / 'fuzz').glob('*_fuzz'))}
    targets = arguments.target or list(binaries)
    unknown = [t for t in targets if t not in binaries]
    if unknown or not targets:
        sys.exit(f'fuzz/run.py: {" ".join(unknown) or "no target"} is not built in {arguments.build}: '
                 'cmake --preset fuzz && cmake --build --preset fuzz')

    print(f'{arguments.seconds} s each, seed {arguments.seed}')
    print(f'{"target":<10} {"runs":>9} {"exec/s":>7} {"coverage":>8} {"corpus":>6}  result', flush=True)
    rows = []
    with tempfile.TemporaryDirectory(prefix='lot-fuzz.') as scratch, \
            concurrent.futures.ThreadPoolExecutor(AT_ONCE) as pool:
        try:
            work = [pool.submit(run, t, binaries[t], arguments.seconds, arguments.seed, pathlib.Path(scratch))
                    for t in targets]
            for future in concurrent.futures.as_completed(work):
                row = future.result()
                rows.append(row)
                print(f'{row["target"]:<10} {row["runs"]:>9} {row["speed"]:>7} {row["coverage"]:>8} '
                      f'{row["corpus"]:>6}  {"ok" if row["good"] else "FAILED"}', flush=True)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
    for row in rows:
        if row['good']:
            continue
        print(f'\n-- {row["target"]}: the end of its output\n{row["tail"]}')
        for name, text in row['inputs']:
            print(f'-- {row["target"]}: {name}, as base64\n{text}')
    failed = [row['target'] for row in rows if not row['good']]
    print(f'summary: {len(rows)} targets, {sum(row["runs"] for row in rows)} runs, '
          + (f'{len(failed)} FAILED: {" ".join(sorted(failed))}' if failed else 'nothing found'))
    return 1 if failed else 0


def stop(number, _):
    global stopping
    for other in SIGNALS:
        signal.signal(other, signal.SIG_IGN)
    stopping = True
    for process in list(running):
        process.kill()
    raise Stopped(number)


if __name__ == '__main__':
    for number in SIGNALS:
        signal.signal(number, stop)
    try:
        sys.exit(main())
    except Stopped as stopped:
        print('summary: stopped by a signal')
        sys.exit(128 + stopped.args[0])
