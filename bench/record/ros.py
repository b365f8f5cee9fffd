#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""What recording topics of ROS costs: `lot record` beside `rosbag record`, of the same four cameras.

    bench/record/ros.py [--runs 5] [--quick] [--build build/release] [--to DIRECTORY]

CPU is in seconds: the recorder's own, and the cameras' beside that of the arm without a recorder. Neither recorder
compresses, nor computes a CRC. A viewer by LOT sees each topic in all arms. Each figure is the median of the runs, with the lowest and the highest of them.
"""

import argparse
import json
import os
import pathlib
import signal
import statistics
import sys
import tempfile
import time

import rosbag

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / 'tests' / 'lot_ros'))
from graph import Graph  # noqa: E402

CAMERAS = 4
ARMS = ('no recorder', 'lot record', 'rosbag record')
# Title; bytes of a frame; frames a second; seconds.
ROWS = (('4 cameras of 1 MiB, 30 Hz, 20 s', 1 << 20, 30, 20), ('4 cameras of 4 MiB, 30 Hz, 8 s', 4 << 20, 30, 8))


def cpu_of(process):
    """CPU seconds of a process that ends by itself."""
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        sys.exit(f'ros.py: {process.name} ended with {process.returncode}: {Graph.said(process)}')
    return used.ru_utime + used.ru_stime


def recorder_of(arm, graph, lot, directory):
    """(a recorder that is starting, its file); (None, None) where the arm has none."""
    topics = [f'/camera/{n}' for n in range(CAMERAS)]
    if arm == 'lot record':
        file = directory / 'cameras.mcap'
        return graph.run([lot, 'record', *topics, '--json', '--no-crc', '-o', file]), file
    if arm == 'rosbag record':
        file = directory / 'cameras.bag'
        return graph.run(['/usr/lib/rosbag/record', '-q', '-O', file, *topics]), file
    return None, None


def recorded(arm, graph, recorder, file):
    """How many messages its file has."""
    if arm == 'lot record':
        return sum(topic['messages'] for topic in json.loads(graph.output(recorder))['topics'])
    with rosbag.Bag(str(file)) as bag:
        return bag.get_message_count()


def film(arm, row, seconds, arguments, directory):
    """One arm: {cameras, recorder, missed, GB}."""
    _, size, hz, _ = row
    lot = arguments.build / 'src' / 'tool' / 'lot'
    with Graph() as graph:
        graph.env['LOT_SIZE'] = str(1 << 30)
        recorder, file = recorder_of(arm, graph, lot, directory)
        if recorder is not None:
            active = file if arm == 'lot record' else pathlib.Path(f'{file}.active')
            graph.wait_for(active.exists, f'{arm} to begin')
        program = arguments.build / 'bench' / 'ros_cameras'
        graph.run([program, 'viewer', str(CAMERAS)])
        subscribers = 2 if arm == 'rosbag record' else 1
        cameras = graph.run([program, *map(str, (CAMERAS, size, hz, seconds, subscribers))])
        figures = {'cameras': cpu_of(cameras)}
        if recorder is None:
            return figures
        recorder.send_signal(signal.SIGTERM if arm == 'lot record' else signal.SIGINT)  # a script's & ignores SIGINT
        figures['recorder'] = cpu_of(recorder)
        graph.wait_for(file.exists, 'the file')
        figures['missed'] = int(graph.output(cameras)) - recorded(arm, graph, recorder, file)
        figures['GB'] = file.stat().st_size / 1e9
        file.unlink()
        return figures


def cell(values, digits=2):
    values = sorted(values)
    return f'{statistics.median(values):.{digits}f} ({values[0]:.{digits}f}-{values[-1]:.{digits}f})'


def table(rows, runs):
    lines = ['| | | written GB | missed | CPU s of the recorder | of the cameras | of both, but for the cameras alone |',
             '|---|---|---|---|---|---|---|']
    for row in rows:
        alone = [run[row[0], ARMS[0]]['cameras'] for run in runs]
        lines.append(f'| {row[0]} | {ARMS[0]} | | | | {cell(alone)} | |')
        for arm in ARMS[1:]:
            got = [run[row[0], arm] for run in runs]
            both = [g['recorder'] + g['cameras'] - a for g, a in zip(got, alone)]
            lines.append(f'| {row[0]} | {arm} | {got[0]["GB"]:.2f} | {max(g["missed"] for g in got)} | '
                         f'{cell([g["recorder"] for g in got])} | {cell([g["cameras"] for g in got])} | {cell(both)} |')
    return '\n'.join(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--runs', type=int, default=5)
    parser.add_argument('--quick', action='store_true', help='a second of the first row')
    parser.add_argument('--build', type=pathlib.Path, default=ROOT / 'build/release')
    parser.add_argument('--to', type=pathlib.Path, default='/dev/shm',
                        help='a directory in a tmpfs with 8 GB free (%(default)s)')
    arguments = parser.parse_args()
    if arguments.runs < 1:
        parser.error('--runs: at least one')
    runs = []
    rows = ROWS[:1] if arguments.quick else ROWS
    with tempfile.TemporaryDirectory(prefix='lot_record.', dir=arguments.to) as name:
        for number in range(arguments.runs):
            print(f'run {number + 1} of {arguments.runs}', file=sys.stderr, flush=True)
            figures = {}
            for row in rows:
                turn = number % len(ARMS)
                for arm in ARMS[turn:] + ARMS[:turn]:  # each one first in turn
                    seconds = 1 if arguments.quick else row[3]
                    figures[row[0], arm] = film(arm, row, seconds, arguments, pathlib.Path(name))
            runs.append(figures)
    print(table(rows, runs))


if __name__ == '__main__':
    main()
