#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""headline.py asks lot_ab only for what it can do, and makes its table of the runs. Nothing is measured.

    headline_test.py [build/release/bench/latency/lot_ab]
"""

import os
import pathlib
import subprocess
import sys
import tempfile

from checks import check, run

LOT_AB = os.path.abspath(sys.argv[1] if len(sys.argv) > 1 else 'build/release/bench/latency/lot_ab')
HEADLINE = pathlib.Path(__file__).resolve().parents[2] / 'bench/latency/headline.py'
WATCHDOG = 120

# Lets lot_ab judge what it is asked for, and makes a run up: run N of the first cell took N us a message,
# run N of a paced one 10 N us.
STUB = '''#!/usr/bin/python3
import json, os, pathlib, subprocess, sys
real, words = os.environ['REAL'], sys.argv[1:]
if words == ['list']:
    os.execv(real, [real, 'list'])
subprocess.run([real, *words, '--dry-run'], check=True, stdout=subprocess.DEVNULL)
out = pathlib.Path(words[words.index('--out') + 1])
n = int(out.parent.name.rpartition('-')[2])
blocks = [{'took_ns': 4000 * n, 'messages': 4}] if '--mode' in words else []
stream = {'blocks': blocks, 'all': {'latency_us': {'from_fill': {'median': 10.0 * n}}}}
arms = [{'transport': 'ring', 'refused': '', 'streams': [stream]},
        {'transport': 'lot2021', 'refused': os.environ['REFUSED'], 'streams': []}]
out.mkdir(parents=True)
(out / 'run.json').write_text(json.dumps({'cells': [{'arms': arms}]}))
'''


def headline(*arguments, refused='sleeps on a condition'):
    with tempfile.TemporaryDirectory() as directory:
        stub = pathlib.Path(directory) / 'lot_ab'
        stub.write_text(STUB, encoding='utf-8')
        stub.chmod(0o755)
        return subprocess.run([HEADLINE, '--lot-ab', stub, '--out', directory + '/out', *arguments], check=False,
                              capture_output=True, text=True, timeout=WATCHDOG, env={**os.environ, 'REAL': LOT_AB, 'REFUSED': refused})


def makes_its_table():
    done = headline('--runs', '3')
    check(done.returncode == 0, 'every command is understood')
    rows = [[cell.strip() for cell in line.split('|')[1:-1]] for line in done.stdout.splitlines()]
    check(len(rows) == 8 and all(len(row) == len(rows[0]) for row in rows), f'a table of six rows: {done.stdout}')
    check(rows[2][:2] == ['ping-pong, spinning, 128 B', '2 (1-3)'], 'of blocks: the median of three runs, and their range')
    check(rows[5][:2] == ['30 Hz, asleep, 128 B', '20 (10-30)'], 'of paced ones: the latency')
    check(rows[2][rows[0].index('2021')] == '', 'what was refused has an empty place')


def says_what_failed():
    done = headline('--runs', '1', refused='failed: a group of nodes: exit status 1')
    check(done.returncode == 1 and not done.stdout, 'a transport that failed: no table')
    check('lot2021: failed: a group of nodes' in done.stderr, 'it says which')
    check(headline('--runs', '0').returncode == 2, 'no runs at all: wrong use')


run((makes_its_table, says_what_failed))
