#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""beside.py asks lot_ab only for what it can do, has the right tool beside it, and ends it. Nothing is measured.

    beside_test.py [build/release/bench/latency/lot_ab]
"""

import os
import pathlib
import subprocess
import sys
import tempfile

from checks import check, run

LOT_AB = os.path.abspath(sys.argv[1] if len(sys.argv) > 1 else 'build/release/bench/latency/lot_ab')
BESIDE = pathlib.Path(__file__).resolve().parents[2] / 'bench/latency/beside.py'
WATCHDOG = 120

# Lets lot_ab judge what it is asked for, and makes a run up: twice as long with a tool beside it, which it waits for.
STUB = '''#!/usr/bin/python3
import json, os, pathlib, subprocess, sys, time
words = sys.argv[1:]
subprocess.run([os.environ['REAL'], *words, '--dry-run'], check=True, stdout=subprocess.DEVNULL)
here = pathlib.Path(os.environ['HERE'])
order = here / 'order'
number = len(order.read_text().split()) if order.exists() else 0
tool = ['', 'top', 'echo', 'hz', 'record'][(number + number // 15) % 5]
with order.open('a') as file:
    file.write('x ')
while tool and not (here / tool).exists():
    time.sleep(0.01)
if not tool and list(here.glob('*_runs')):
    sys.exit('a tool has stayed')
took = 2000 if tool else 1000
blocks = [{'took_ns': took * 4, 'messages': 4}] if '--mode' in words else []
stream = {'blocks': blocks, 'all': {'latency_us': {'from_fill': {'median': took / 100}}}}
pathlib.Path(words[words.index('--out') + 1], 'run.json').write_text(
    json.dumps({'cells': [{'arms': [{'transport': 'ring', 'refused': '', 'streams': [stream]}]}]}))
'''
# A tool runs until Ctrl-C, and writes more than a terminal keeps.
TOOL = '''#!/usr/bin/python3
import os, pathlib, sys, time
here = pathlib.Path(os.environ['HERE'])
(here / f'{sys.argv[1]}_runs').touch()
try:
    sys.stdout.write('line\\n' * 20000)
    (here / sys.argv[1]).touch()
    while True:
        time.sleep(1)
except KeyboardInterrupt:
    (here / f'{sys.argv[1]}_runs').unlink()
    (here / sys.argv[1]).unlink()
'''


def beside(*arguments):
    with tempfile.TemporaryDirectory() as directory:
        for name, text in (('lot_ab', STUB), ('lot', TOOL)):
            (pathlib.Path(directory) / name).write_text(text, encoding='utf-8')
            (pathlib.Path(directory) / name).chmod(0o755)
        done = subprocess.run([BESIDE, '--lot-ab', directory + '/lot_ab', '--lot', directory + '/lot', *arguments], check=False,
                              capture_output=True, text=True, timeout=WATCHDOG, env={**os.environ, 'REAL': LOT_AB, 'HERE': directory})
        return done, sorted(path.name for path in pathlib.Path(directory).iterdir())


def makes_its_table():
    done, left = beside('--runs', '2')
    check(done.returncode == 0, f'every command is understood: {done.stderr}')
    check(left == ['lot', 'lot_ab', 'order'], f'each tool has ended: {left}')
    rows = [[cell.strip() for cell in line.split('|')[1:-1]] for line in done.stdout.splitlines()]
    check(len(rows) == 5 and all(len(row) == 6 for row in rows), f'a table of three rows: {done.stdout}')
    check(rows[2][1:3] == ['10 (10-10)', '20 (20-20), 2.00'], f'the latency, and its ratio: {rows[2]}')
    check(rows[4][1:3] == ['1 (1-1)', '2 (2-2), 2.00'], f'of blocks: the time of a message: {rows[4]}')


def refuses_wrong_use():
    check(beside('--runs', '0')[0].returncode == 2, 'no runs at all: wrong use')


run((makes_its_table, refuses_wrong_use))
