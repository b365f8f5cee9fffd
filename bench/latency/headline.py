#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""The first table of docs/bench.md: six cells of lot_ab, again and again, all transports in turn.

    bench/latency/headline.py [--runs 10] [--quick] [--out build/headline] [--lot-ab PROGRAM]

Each figure is the median of the runs' medians, in microseconds, with the lowest and the highest of them.
A run takes two minutes; --quick asks for a few messages, to see that all of it works. Runs that OUT has
already are left out, so that a series that was broken off goes on. 16 MiB between containers needs root
for TCP.
"""

import argparse
import json
import pathlib
import statistics
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parents[2]
COLUMNS = (('LOT', 'ring'), ('LOT, borrowed', 'ring-borrow'), ('iceoryx', 'iceoryx'), ('Fast DDS', 'fastdds'),
           ('UDS', 'uds'), ('TCP', 'tcp'), ('2021', 'lot2021'), ('line', 'floor-spin'), ('futex', 'floor-futex'))
BALL = ('--mode', 'ping-pong', '--size', '128', '--pool', '100', '--messages')
PACED = ('--wait', 'park', '--messages')
# Title; the floor that belongs to it; messages, and a few; what lot_ab is asked for before their number.
ROWS = (
    ('ping-pong, spinning, 128 B', 'floor-spin', 20000, ('--wait', 'spin', '--pin', 'other-core', *BALL)),
    ('ping-pong, asleep, one core, 128 B', 'floor-futex', 20000, ('--wait', 'park', '--pin', 'same-core', *BALL)),
    ('one message in a stream, 128 B', 'floor-spin', 100000,
     ('--mode', 'throughput', '--size', '128', '--wait', 'adaptive', '--pin', 'other-core', '--pool', '100',
      '--messages')),
    ('30 Hz, asleep, 128 B', 'floor-futex', 120, ('--size', '128', '--pool', '100', *PACED)),
    ('30 Hz, asleep, 1 MiB', 'floor-futex', 120, ('--size', '1M', '--pool', '100', *PACED)),
    ('30 Hz, asleep, 16 MiB, in containers of their own', 'floor-futex', 120,
     ('--size', '16M', '--pool', '10', '--depth', '4', '--place', 'containers', *PACED)),
)
QUICK = 60  # a run with one message of so many


def transports(lot_ab):
    """Those of the table that lot_ab has been built with."""
    listed = subprocess.run([lot_ab, 'list'], capture_output=True, text=True, check=True).stdout
    here = {words[0] for words in map(str.split, listed.splitlines()) if not words[1].startswith('(')}
    return [name for _, name in COLUMNS if not name.startswith('floor-') and name in here]


def measure(lot_ab, names, out, quick):
    """One run: all cells, each in a directory of its own."""
    for number, (title, _, messages, options) in enumerate(ROWS):
        if quick:
            messages = max(messages // QUICK, 10)
        command = [lot_ab, '--out', out / str(number), '--resume', '--transports', ','.join(names), *options,
                   str(messages), '--block', str(max(messages // (20 if messages > 1000 else 6), 1))]
        status = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, check=False)
        if status.returncode > 1:  # 1: a transport was refused, or has failed: read() tells them apart
            sys.exit(f'headline.py: {title}: {status.stderr}')


def microseconds(arm):
    """The figure of an arm: of a paced one the latency, else the time of a message in whole blocks."""
    stream = arm['streams'][0]
    if stream['blocks']:
        return statistics.median(block['took_ns'] / block['messages'] for block in stream['blocks']) / 1000
    return stream['all']['latency_us']['from_fill']['median']


def read(out):
    """[{transport: microseconds} of each row]"""
    names = [name for _, name in COLUMNS]
    rows = []
    for number in range(len(ROWS)):
        saved = json.loads((out / str(number) / 'run.json').read_text(encoding='utf-8'))
        arms = [arm for cell in saved['cells'] for arm in cell['arms']]
        for arm in arms:
            if arm['refused'].startswith('failed'):
                sys.exit(f"headline.py: {out / str(number)}: {arm['transport']}: {arm['refused']}")
        rows.append({arm['transport']: microseconds(arm) for arm in arms
                     if arm['transport'] in names and not arm['refused']})
    return rows


def digits(value):
    return f'{value:.3g}' if value < 1000 else f'{value:.0f}'


def cell(values):
    if not values:
        return ''
    return f'{digits(statistics.median(values))} ({digits(min(values))}-{digits(max(values))})'


def table(runs):
    """The table in Markdown: of the two floors each row has the one that belongs to it."""
    names = [title for title, name in COLUMNS if not name.startswith('floor-')]
    lines = ['| | ' + ' | '.join([*names, 'floor']) + ' |', '|' + '---|' * (len(names) + 2)]
    for number, (title, floor, _, _) in enumerate(ROWS):
        cells = [cell([run[number][name] for run in runs if name in run[number]])
                 for _, name in COLUMNS if not name.startswith('floor-') or name == floor]
        cells[-1] = f"{dict((name, title) for title, name in COLUMNS)[floor]} {cells[-1]}"
        lines.append(f'| {title} | ' + ' | '.join(cells) + ' |')
    return '\n'.join(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--runs', type=int, default=10)
    parser.add_argument('--quick', action='store_true')
    parser.add_argument('--out', type=pathlib.Path, default=ROOT / 'build/headline')
    parser.add_argument('--lot-ab', type=pathlib.Path, default=ROOT / 'build/release/bench/latency/lot_ab')
    arguments = parser.parse_args()
    if arguments.runs < 1:
        parser.error('--runs: at least one')
    names = transports(arguments.lot_ab)
    runs = []
    for number in range(1, arguments.runs + 1):
        print(f'run {number} of {arguments.runs}', file=sys.stderr, flush=True)
        out = arguments.out / f'run-{number}'
        measure(arguments.lot_ab, names, out, arguments.quick)
        runs.append(read(out))
    print(table(runs))


if __name__ == '__main__':
    main()
