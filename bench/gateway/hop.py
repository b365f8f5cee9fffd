#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""What a hop by two gateways costs, beside a plain program of CycloneDDS; and what a gateway costs local readers.

    bench/gateway/hop.py [--runs 10] [--quick] [--only NAME]... [--build build/release]

Two network namespaces with a cable between them. Each run has every cell of every arm, the arms one after the other,
each one first in turn. Each figure is the median of the runs, with the lowest and the highest of them; each ratio is
one of the same run.

latency     from the push, or dds_write(), to the receipt, at a steady pace. At 1 KiB the floor is a futex that wakes
            a process at the same pace.
throughput  as fast as it goes, with eight frames under way at most
local       from the push to the receipt by two readers on one host: without a gateway, with one that nobody listens
            to, and with one that carries all of it to the other host, which this machine is as well: as it is
            started by default, and where both gateways take only what the processors have left
"""

import argparse
import json
import os
import pathlib
import statistics
import sys

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / 'tests/gateway'))
import hosts  # noqa: E402  pylint: disable=wrong-import-position

KIB, MIB = 1 << 10, 1 << 20
SIZES = {'1 KiB': KIB, '64 KiB': 64 * KIB, '1 MiB': MIB, '4 MiB': 4 * MIB, '16 MiB': 16 * MIB}
# Of a cell: frames, of these the warm-up, microseconds between two.
LATENCY = {'1 KiB': (1050, 50, 2000), '64 KiB': (1050, 50, 2000), '1 MiB': (240, 40, 10000),
           '4 MiB': (140, 40, 20000), '16 MiB': (90, 40, 80000)}
THROUGHPUT = {'1 KiB': (30000, 3000, 0), '64 KiB': (6000, 600, 0), '1 MiB': (550, 50, 0), '4 MiB': (240, 40, 0),
              '16 MiB': (100, 40, 0)}
IDLE = ['chrt', '-i', '0']
LOCAL_ARMS = ['no gateway', 'a gateway without a peer', 'a gateway, and its peer here, too', 'the same, by chrt -i 0']
LOCAL = {'1 KiB': (2050, 50, 1000), '1 MiB': (420, 20, 10000)}
# What the gateway tells CycloneDDS for itself, for the plain program.
URI = ('<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface name="lot0"/></Interfaces></General><Internal>'
       '<MaxSampleSize>67108864 B</MaxSampleSize><Watermarks><WhcHigh>256 MB</WhcHigh></Watermarks>'
       '<SocketReceiveBufferSize max="32 MB"/></Internal></Domain></CycloneDDS>')


DEPTH = 16
hosts.PATIENCE_S = 600  # a cell may be slow, and nothing is wrong
GATEWAY = f"""\
interface: {hosts.CABLE}
{{direction}}:
  - {{{{topics: {{topic}}, depth: {DEPTH}}}}}
"""


class Bench:
    def __init__(self, arguments):
        self.arguments = arguments
        self.number = 0
        self.size = '512M' if arguments.quick else '2G'
        build = arguments.build
        self.lot = build / 'bench/gateway/lot_arm'
        self.dds = build / 'bench/gateway/dds_arm'
        self.gateway = build / 'src/gateway/lot_gateway'
        for program in self.lot, self.dds, self.gateway:
            if not program.exists():
                sys.exit(f'hop.py: there is no {program}')

    def words(self, size, cell):
        frames, warm_up, period = cell
        if self.arguments.quick:
            frames, warm_up = 12, 2
        return ['--depth', DEPTH, '--bytes', size, '--frames', frames, '--warm-up', warm_up, '--period-us', period]

    def run(self, where, readers, program, words, gateways=(), **environment):
        """What each reader prints. `readers`: their hosts. `gateways`: (host, direction, what it is started by). The
        sender is on host 0."""
        self.number += 1
        topic = f'/frames{self.number}'
        board = os.path.join(where.folder.name, f'board{self.number}')
        running = []
        for host, direction, by in gateways:
            settings = pathlib.Path(where.folder.name, f'{direction}.yaml')
            settings.write_text(GATEWAY.format(direction=direction, topic=topic), encoding='utf-8')
            running.append(where.run(host, *by, self.gateway, '--config', settings, **environment))
        there = [where.run(host, program, 'receive', topic, board, *words, '--reader', number, **environment)
                 for number, host in enumerate(readers)]
        sender = where.run(0, program, 'send', topic, board, *words, '--readers', len(readers), **environment)
        for receiver in there:
            receiver.finish()
        sender.finish()
        for gateway in running:
            gateway.process.terminate()
            gateway.finish()
        where.programs.clear()
        return [json.loads(receiver.said()) for receiver in there]

    def hop(self, where, size, cell):
        return {
            'LOT - DDS - LOT': lambda: self.run(where, [1], self.lot, self.words(size, cell),
                                                [(0, 'out', []), (1, 'in', [])], LOT_SIZE=self.size),
            'CycloneDDS': lambda: self.run(where, [1], self.dds, self.words(size, cell), CYCLONEDDS_URI=URI)}

    def local(self, where, size, cell):
        def arm(*gateways):
            return lambda: self.run(where, [0, 0], self.lot, self.words(size, cell), gateways, LOT_SIZE=self.size)
        return dict(zip(LOCAL_ARMS, [arm(), arm((0, 'out', [])), arm((0, 'out', []), (1, 'in', [])),
                                     arm((0, 'out', IDLE), (1, 'in', IDLE))]))

    def floor(self, where, cell):
        frames = where.run(0, self.lot, 'futex', '-', '-', *self.words(0, cell))
        frames.finish()
        return json.loads(frames.said())


def quantile(values, share):
    values = sorted(values)
    return values[min(len(values) - 1, int(share * len(values)))]


def figures_of(seen):
    """Of the readers of one arm: the worst."""
    return {'median': max(statistics.median(r['latencies_us']) for r in seen),
            'p99': max(quantile(r['latencies_us'], 0.99) for r in seen),
            'rate': min(r['mb_per_s'] for r in seen),
            'lost': max(r['lost'] for r in seen)}


def measure(bench, where, number, wanted):
    """One run: {(table, size, arm): figures}."""
    figures = {}
    tables = {'latency': (LATENCY, bench.hop), 'throughput': (THROUGHPUT, bench.hop), 'local': (LOCAL, bench.local)}
    for name in wanted:
        cells, arms_of = tables[name]
        for size, cell in cells.items():
            arms = arms_of(where, SIZES[size], cell)
            names = list(arms)
            for arm in names[number % len(names):] + names[:number % len(names)]:
                figures[name, size, arm] = figures_of(arms[arm]())
    if 'latency' in wanted:
        latencies = bench.floor(where, LATENCY['1 KiB'])['latencies_us']
        figures['floor'] = statistics.median(latencies)
    return figures


def cell(values, digits):
    values = sorted(values)
    return f'{statistics.median(values):.{digits}f} ({values[0]:.{digits}f}-{values[-1]:.{digits}f})'


def column(runs, key, figure):
    return [run[key][figure] for run in runs]


def ratio(runs, key, base, figure):
    return cell([a / b for a, b in zip(column(runs, key, figure), column(runs, base, figure))], 2)


def hop_table(runs, name, figure, unit, digits):
    lines = [f'| {name} | LOT - DDS - LOT, {unit} | CycloneDDS, {unit} | ratio | lost |', '|---|---|---|---|---|']
    for size in SIZES:
        lot, dds = (name, size, 'LOT - DDS - LOT'), (name, size, 'CycloneDDS')
        ours_first = (lot, dds) if figure == 'median' else (dds, lot)
        lines.append(f'| {size} | {cell(column(runs, lot, figure), digits)} | {cell(column(runs, dds, figure), digits)} | '
                     f'{ratio(runs, *ours_first, figure)} | '
                     f'{max(column(runs, lot, "lost"))}, {max(column(runs, dds, "lost"))} |')
    return lines


def floor_lines(runs):
    added = [run['latency', '1 KiB', 'LOT - DDS - LOT']['median'] - run['latency', '1 KiB', 'CycloneDDS']['median']
             for run in runs]
    floors = [run['floor'] for run in runs]
    return ['', f'A wake-up by a futex at that pace: {cell(floors, 1)} us. At 1 KiB the hop adds {cell(added, 1)} us, '
            f'which are {cell([a / f for a, f in zip(added, floors)], 2)} wake-ups.']


def local_table(runs):
    lines = ['| local | arm | median us | of no gateway | 99 % us | of no gateway |', '|---|---|---|---|---|---|']
    for size in LOCAL:
        alone = ('local', size, LOCAL_ARMS[0])
        for arm in LOCAL_ARMS:
            key = ('local', size, arm)
            lines.append(f'| {size} | {arm} | {cell(column(runs, key, "median"), 1)} | {ratio(runs, key, alone, "median")} | '
                         f'{cell(column(runs, key, "p99"), 1)} | {ratio(runs, key, alone, "p99")} |')
    return lines


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--runs', type=int, default=10)
    parser.add_argument('--quick', action='store_true', help='a dozen frames a cell')
    parser.add_argument('--only', action='append', choices=['latency', 'throughput', 'local'])
    parser.add_argument('--build', type=pathlib.Path, default=ROOT / 'build/release')
    arguments = parser.parse_args()
    if arguments.runs < 1:
        parser.error('--runs: at least one')
    wanted = arguments.only or ['latency', 'throughput', 'local']
    most = int(pathlib.Path('/proc/sys/net/core/rmem_max').read_text())
    if most < 32 << 20:
        print(f'net.core.rmem_max is {most}: the sockets of both arms get no more', file=sys.stderr)
    bench = Bench(arguments)
    runs = []
    try:
        with hosts.Hosts() as where:
            for number in range(arguments.runs):
                print(f'run {number + 1} of {arguments.runs}', file=sys.stderr, flush=True)
                runs.append(measure(bench, where, number, wanted))
    except hosts.Refused as refused:
        print(hosts.skipped())
        print(refused, file=sys.stderr)
        return
    lines = []
    if 'latency' in wanted:
        lines += hop_table(runs, 'latency', 'median', 'us', 0) + floor_lines(runs) + ['']
    if 'throughput' in wanted:
        lines += hop_table(runs, 'throughput', 'rate', 'MB/s', 0) + ['']
    if 'local' in wanted:
        lines += local_table(runs)
    print('\n'.join(lines))


if __name__ == '__main__':
    main()
