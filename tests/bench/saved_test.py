#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""What lot_ab does with cells that are saved already, what it says before it measures, and how it ends.

    saved_test.py [build/release/bench/latency/lot_ab]
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile

from checks import check, run

LOT_AB = sys.argv[1] if len(sys.argv) > 1 else 'build/release/bench/latency/lot_ab'
WATCHDOG = 120
CELL = ('-s', '128', '-n', '20', '--block', '5', '-r', '1000')


def lot_ab(*arguments):
    return subprocess.run([LOT_AB, *arguments], capture_output=True, text=True, timeout=WATCHDOG, check=False)


def arms(out):
    cells = json.load(open(out + '/run.json', encoding='utf-8'))['cells']
    return [[a['transport'] for a in c['arms']] for c in cells]


def contents(directory):
    return {(path, name): open(os.path.join(path, name), 'rb').read()
            for path, _, names in os.walk(directory) for name in names}


def keeps_what_is_saved(directory):
    out = directory + '/kept'
    r = lot_ab('-t', 'ring', '-o', out, *CELL)
    check(r.returncode == 0, 'a first run')
    before = contents(out)
    r = lot_ab('-t', 'tcp', '-o', out, *CELL)
    check(r.returncode == 2, 'a run that would replace a cell is bad use')
    check(all(word in r.stderr for word in ('128 B', '--out', '--resume', '--replace')), 'and names the ways out')
    check(contents(out) == before, 'and has changed nothing')
    r = lot_ab('-t', 'ring', '-o', out, '--resume', *CELL)
    check(r.returncode == 0 and r.stdout == '' and contents(out) == before, 'a whole cell is not measured again')
    r = lot_ab('-t', 'tcp', '-o', out, '--resume', *CELL)
    check(r.returncode == 0 and arms(out)[0][-1] == 'ring' and set(arms(out)[0]) >= {'tcp', 'ring', 'floor-futex'},
          'a cell that lacks an arm is measured with all that it had')
    r = lot_ab('-t', 'uds', '-o', out, '--replace', '--no-floors', *CELL)
    check(r.returncode == 0 and arms(out) == [['uds']], '--replace replaces')
    run = json.load(open(out + '/run.json', encoding='utf-8'))
    run['cells'][0]['arms'][0]['refused'] = 'failed: publisher 0: made up'
    json.dump(run, open(out + '/run.json', 'w', encoding='utf-8'))
    r = lot_ab('-t', 'uds', '-o', out, '--resume', '--no-floors', *CELL)
    run = json.load(open(out + '/run.json', encoding='utf-8'))
    check(r.returncode == 0 and run['cells'][0]['arms'][0]['refused'] == '', 'an arm that failed is measured again')


def says_what_it_will_do(directory):
    out = directory + '/dry'
    r = lot_ab('-t', 'ring,tcp,ring', '-m', 'paced,throughput', '-s', '128,64K', '-n', '90', '-o', out, '--dry-run')
    lines = r.stdout.splitlines()
    check(r.returncode == 0 and not os.path.exists(out), '--dry-run measures and writes nothing')
    check(len(lines) == 9 and lines[1].split()[:2] == ['ring', 'tcp'] and 'floor-futex' in lines[1],
          'it lists cells, and arms once')
    seconds = 2 * len(lines[1].split()) * 90 // 30
    check(lines[-1].startswith(f'4 cells, at least 0 min {seconds} s; of 2'), '2 cells x arms x 90 / 30 Hz')
    r = lot_ab('-t', 'ring', '-g', 'av', '-n', '800', '--no-floors', '--dry-run')
    check(r.stdout.endswith('ring ring quiet\n1 cell, at least 0 min 4 s\n'),
          'a scenario is paced by its first sensor, and has quiet twins')
    r = lot_ab('-t', 'ring quiet', '-g', 'av', '-n', '800', '--dry-run')
    check(r.returncode == 2 and '--graph av' in r.stderr, 'which nobody asks for by name')
    r = lot_ab('-t', 'ring', '--no-floors', '-n', '20', '-r', '1000', '-s', '1G,128', '--depth', '4096')
    check(r.returncode == 1 and 'not measured: 1p1s, 1024 MiB' in r.stderr and '== 1p1s, 128 B' in r.stdout,
          'a cell that needs too much memory is left out, the others are measured')
    r = lot_ab('-t', 'ring', '--no-floors', '-n', '20', '-r', '1000', '-s', '128,256')
    check(r.stderr.startswith('2 cells, at least 0 min 1 s\n'), 'a run says first how long it takes')
    lines = r.stderr.splitlines()
    check(len(lines) == 3 and lines[1].startswith('[1/2] 1p1s, 128 B') and lines[2].startswith('[2/2] 1p1s, 256 B'),
          'in a pipe each cell has a line')


def shows_and_compares(directory):
    out = directory + '/shown'
    r = lot_ab('-t', 'ring,tcp', '-o', out, *CELL)
    shown = lot_ab('show', out)
    check(shown.returncode == 0 and r.stdout.strip() in shown.stdout, 'show prints what the run has printed')
    check('cores' in shown.stdout.splitlines()[0], 'and where that was')
    pushed = lot_ab('show', out, '--stamp', 'push', '--per-subscriber').stdout
    check('from push to' in pushed and 'tcp s0' in pushed, 'show has the options of tables')
    other = directory + '/other'
    lot_ab('-t', 'ring', '-o', other, '-s', '256', '-n', '20', '-r', '1000')
    check(lot_ab('compare', out, other).returncode == 3, 'nothing in common: 3')
    check(lot_ab('compare', out, directory + '/nowhere').returncode == 2, 'no such directory: 2')
    run = json.load(open(out + '/run.json', encoding='utf-8'))
    run['cells'][0]['arms'][0]['streams'][0]['subscribers'][0]['received'] += 1
    json.dump(run, open(out + '/run.json', 'w', encoding='utf-8'))
    r = lot_ab('show', out)
    check(r.returncode == 1 and 'WRONG' in r.stdout, 'counts that do not add up: 1')
    kept = directory + '/without-samples'
    os.mkdir(kept)
    shutil.copy(out + '/run.json', kept)
    for command in ['show', kept], ['compare', out, kept]:
        r = lot_ab(*command)
        check(r.returncode == 4 and 'were not kept' in r.stderr, f'a run without its samples says so ({command[0]})')
    run['machine']['kernel'] = 'made up'
    json.dump(run, open(out + '/run.json', 'w', encoding='utf-8'))
    r = lot_ab('-t', 'ring', '-n', '1000000', '-o', out, '--resume')
    check(r.returncode == 2 and 'another machine' in r.stderr, 'what another machine measured is refused at once')
    open(out + '/run.json', 'w', encoding='utf-8').write('{')
    for command in (['compare', out, other], ['show', out], ['plot', out], ['-t', 'ring', '--resume', '-o', out]):
        r = lot_ab(*command)
        check(r.returncode == 4 and 'run.json' in r.stderr, f'a run that cannot be read: 4 ({command[0]})')


with tempfile.TemporaryDirectory() as temporary:
    run((keeps_what_is_saved, says_what_it_will_do, shows_and_compares), temporary)
