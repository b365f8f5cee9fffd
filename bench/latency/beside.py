#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""What a publisher and its reader notice of a tool that looks at their topic: lot_ab, with and without it in turn.

    bench/latency/beside.py [--runs 10] [--quick] [--lot-ab PROGRAM] [--lot PROGRAM]

Each figure is the median of the runs' medians, in microseconds, with the lowest and the highest of them;
behind it the median of the ratios to the arm without a tool of the same run. `lot top` has a terminal of 100 columns.
"""

import argparse
import contextlib
import fcntl
import json
import os
import pathlib
import pty
import signal
import statistics
import struct
import subprocess
import sys
import tempfile
import termios
import threading

from headline import QUICK, ROOT, cell, microseconds

# What runs beside; none: nothing does.
ARMS = {'nothing': None, 'lot top': ['top'], 'lot echo': ['echo', '/ab'], 'lot hz': ['hz', '/ab'],
        'lot record': ['record', '/ab', '-o', 'FILE']}  # FILE: one in a tmpfs, which goes again
# Title; messages, and a few; what lot_ab is asked for.
ROWS = (
    ('30 Hz, asleep, 1 MiB', 120, ('--size', '1M', '--wait', 'park')),
    ('1 kHz, asleep, 128 B', 3000, ('--size', '128', '--rate', '1000', '--wait', 'park')),
    ('one message in a stream, 128 B', 300000,
     ('--mode', 'throughput', '--size', '128', '--wait', 'adaptive', '--pin', 'other-core')),
)


@contextlib.contextmanager
def tool(lot, words):
    """The tool runs meanwhile, in a terminal that is read."""
    if words is None:
        yield
        return
    pid, terminal = pty.fork()
    if pid == 0:
        os.environ['TERM'] = 'xterm'
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # a script's & has it ignored
        os.execv(lot, [lot, *words])
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack('HHHH', 40, 100, 0, 0))

    def read():
        with contextlib.suppress(OSError):
            while os.read(terminal, 65536):
                pass

    reader = threading.Thread(target=read)
    reader.start()
    try:
        yield
        if os.waitpid(pid, os.WNOHANG)[0] != 0:
            sys.exit(f'beside.py: lot {" ".join(words)} has ended')
    finally:
        with contextlib.suppress(ProcessLookupError, ChildProcessError):
            os.kill(pid, signal.SIGINT)
            os.waitpid(pid, 0)
        os.close(terminal)
        reader.join()


def measure(lot_ab, messages, options):
    """The figure of one run without its floors."""
    with tempfile.TemporaryDirectory(prefix='lot_beside.') as out:
        command = [lot_ab, '--out', out, '--transports', 'ring', '--no-floors', *options, '--messages', str(messages),
                   '--block', str(max(messages // 6, 1))]
        done = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, check=False)
        if done.returncode != 0:
            sys.exit(f'beside.py: {" ".join(map(str, command))}: {done.stderr}')
        saved = json.loads(pathlib.Path(out, 'run.json').read_text(encoding='utf-8'))
    arms = [arm for cell in saved['cells'] for arm in cell['arms'] if arm['transport'] == 'ring']
    return microseconds(arms[0])


def table(runs):
    """The table in Markdown."""
    lines = ['| | ' + ' | '.join(ARMS) + ' |', '|' + '---|' * (len(ARMS) + 1)]
    for title, _, _ in ROWS:
        cells = []
        for name in ARMS:
            values = [run[title, name] for run in runs]
            ratio = statistics.median(run[title, name] / run[title, 'nothing'] for run in runs)
            cells.append(cell(values) + (f', {ratio:.2f}' if name != 'nothing' else ''))
        lines.append(f'| {title} | ' + ' | '.join(cells) + ' |')
    return '\n'.join(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--runs', type=int, default=10)
    parser.add_argument('--quick', action='store_true')
    parser.add_argument('--lot-ab', type=pathlib.Path, default=ROOT / 'build/release/bench/latency/lot_ab')
    parser.add_argument('--lot', type=pathlib.Path, default=ROOT / 'build/release/src/tool/lot')
    arguments = parser.parse_args()
    if arguments.runs < 1:
        parser.error('--runs: at least one')
    runs = []
    for number in range(arguments.runs):
        print(f'run {number + 1} of {arguments.runs}', file=sys.stderr, flush=True)
        figures = {}
        for title, messages, options in ROWS:
            if arguments.quick:
                messages = max(messages // QUICK, 10)
            names = list(ARMS)
            for name in names[number % len(names):] + names[:number % len(names)]:  # each one first in turn
                with tempfile.TemporaryDirectory(prefix='lot_beside.', dir='/dev/shm') as place:
                    words = ARMS[name] and [w.replace('FILE', f'{place}/file.mcap') for w in ARMS[name]]
                    with tool(arguments.lot, words):
                        figures[title, name] = measure(arguments.lot_ab, messages, options)
        runs.append(figures)
    print(table(runs))


if __name__ == '__main__':
    main()
