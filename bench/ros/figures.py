#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""From publish() to the callback in ROS: nodelets of LOT beside plain ones, and image_transport's transport
`lot` beside raw. Arms take turns; each figure is a ratio of two arms' medians of the same round.

    bench/ros/figures.py [--build build/release] [--rounds 10] [--messages 30]
"""

import argparse
import collections
import pathlib
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / 'tests' / 'lot_ros'))
from graph import Graph  # noqa: E402

MIB = 1 << 20
SIZES = (1 * MIB, 16 * MIB)
# What is compared, with what, at which sizes, and the most that it is to be.
FIGURES = (
    ('LOT in one process / plain by pointer', 'lot', 'plain', SIZES, 1.3),
    ('LOT between processes, immediate queue / plain by pointer in one', 'lot-between', 'plain', SIZES, 1.5),
    ('LOT camera, plain subscriber of its process / one memcpy', 'converted', 'memcpy', SIZES[1:], 1.2),
    ('standard image through lot::ros / plain by pointer', 'standard', 'plain', SIZES, None),
    ('transport lot / image_transport raw', 'plugin', 'raw', SIZES[:1], None),
    ('transport lot / image_transport raw', 'plugin', 'raw', SIZES[1:], 1 / 1.8),
)


def medians(build, rounds, messages):
    """{(arm, bytes): [the median of each round, in microseconds]}"""
    prefix = pathlib.Path(tempfile.mkdtemp(prefix='lot_figures_'))
    samples = collections.defaultdict(list)
    try:
        subprocess.run(['cmake', '--install', build, '--prefix', str(prefix)], check=True, stdout=subprocess.DEVNULL)
        program = str(pathlib.Path(build).resolve() / 'bench' / 'ros_figures')
        with Graph() as graph:
            graph.env['ROS_PACKAGE_PATH'] = f'{prefix}/share:/usr/share'
            subscriber = graph.run([program, 'subscriber'])
            publisher = graph.run([program, 'publisher', str(rounds), str(messages), *map(str, SIZES)])
            if publisher.wait(1800) != 0:
                raise SystemExit(graph.said(publisher))
            subscriber.send_signal(signal.SIGINT)
            subscriber.wait(60)
            for end in publisher, subscriber:
                for line in graph.output(end).splitlines():
                    arm, size, number, ns = line.split()
                    samples[arm, int(size), int(number)].append(int(ns) / 1000)
    finally:
        shutil.rmtree(prefix)
    by_arm = collections.defaultdict(list)
    for (arm, size, _), values in sorted(samples.items()):
        by_arm[arm, size].append(statistics.median(values))
    return by_arm


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument('--build', default=str(ROOT / 'build' / 'release'))
    arguments.add_argument('--rounds', type=int, default=10)
    arguments.add_argument('--messages', type=int, default=30)
    given = arguments.parse_args()
    by_arm = medians(given.build, given.rounds, given.messages)
    print(f'{"arm":14}{"MiB":>4}{"median us":>11}  of {given.rounds} rounds')
    for (arm, size), values in sorted(by_arm.items(), key=lambda each: (each[0][1], each[0][0])):
        print(f'{arm:14}{size // MIB:4}{statistics.median(values):11.0f}  {min(values):.0f} .. {max(values):.0f}')
    print()
    for what, arm, beside, sizes, most in FIGURES:
        for size in sizes:
            ratios = [a / b for a, b in zip(by_arm[arm, size], by_arm[beside, size])]
            middle = statistics.median(ratios)
            verdict = '' if most is None else f'   at most {most:.2f}: {"reached" if middle <= most else "NOT reached"}'
            print(f'{size // MIB:3} MiB  {what}: {middle:.2f} ({min(ratios):.2f} .. {max(ratios):.2f}){verdict}')


if __name__ == '__main__':
    main()
