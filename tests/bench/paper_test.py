#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""paper.sh asks lot_ab only for what it can do, and in the time that it says. Nothing is measured.

    paper_test.py [build/release/bench/latency/lot_ab]
"""

import os
import pathlib
import re
import subprocess
import sys
import tempfile

from checks import check, run

LOT_AB = os.path.abspath(sys.argv[1] if len(sys.argv) > 1 else 'build/release/bench/latency/lot_ab')
PAPER = pathlib.Path(__file__).resolve().parents[2] / 'bench/latency/paper.sh'
WATCHDOG = 120

# Says what it was asked for, and lets lot_ab judge it. $MISSING is shown as missing.
STUB = f'''#!/usr/bin/env bash
case $1 in
  list) '{LOT_AB}' list | sed -E "s/^(${{MISSING:-none}}) .*/\\1 (was not found)/" ;;
  plot) echo "drawn: $2"; exit 0 ;;
  *)
    echo "asked: $*"
    '{LOT_AB}' "$@" --dry-run || exit
    exit "${{STATUS:-0}}" ;;
esac
'''


class Paper:
    """A run of paper.sh with these arguments."""

    def __init__(self, *arguments, **environment):
        with tempfile.TemporaryDirectory() as directory:
            stub = pathlib.Path(directory) / 'lot_ab'
            stub.write_text(STUB, encoding='utf-8')
            stub.chmod(0o755)
            self.out = directory + '/out'
            r = subprocess.run([PAPER, *arguments, '--out', self.out], capture_output=True, text=True, timeout=WATCHDOG,
                               check=False, env={**os.environ, 'LOT_AB': str(stub), **environment})
            self.wrote = os.path.exists(self.out)
        self.status, self.said, self.complained = r.returncode, r.stdout, r.stderr
        self.asked = [line.split()[1:] for line in self.said.splitlines() if line.startswith('asked: ')]

    def seconds(self):
        return sum(60 * int(m) + int(s) for m, s in re.findall(r'at least (\d+) min (\d+) s', self.said))


def value(command, option):
    return command[command.index(option) + 1] if option in command else ''


def names(command):
    return set(value(command, '--transports').split(','))


def is_understood():
    have = subprocess.run([LOT_AB, 'list'], capture_output=True, text=True, check=True).stdout.splitlines()
    every = {line.split()[0] for line in have if not line.split()[1].startswith('(') and
             not line.startswith(('floor-', 'ros-'))}
    for option, most in ((None, 86 * 60), ('--quick', 8 * 60), ('--full', None)):
        paper = Paper(*([option] if option else []))
        word = option or 'normal'
        check(paper.status == 0, f'{word}: every command is understood')
        if paper.status != 0:
            print(paper.said[-500:], paper.complained)
        check(paper.asked and not paper.wrote, f'{word}: nothing was measured')
        check(f'drawn: {paper.out}' in paper.said, f'{word}: figures are drawn at the end')
        for command in paper.asked:
            options = [w for w in command if w.startswith('--')]
            check(len(options) == len(set(options)), f'{word}: no option is given twice: {" ".join(command)}')
            check(value(command, '--out') == paper.out and '--resume' in command, f'{word}: cells are resumed')
            of_table_1 = '--profile' in command  # the paper's own four
            check(of_table_1 or ('lot2021' in names(command)) == ('lot2021-direct' in names(command)),
                  f'{word}: the stack of 2021 in both its forms, or not at all')
        print(f'{word}: {paper.seconds()} s of pacing')
        if most:
            check(0 < paper.seconds() < most, f'{word}: in time, with some to spare for what is not paced')
        else:
            pools = [value(command, '--pool') for command in paper.asked]
            half = len(pools) // 2
            check('0' not in pools[:half] and set(pools[half:]) == {'0'} and '100' in pools,
                  'full: with and without a pool')
            broad = [command for command in paper.asked if every <= names(command)]
            check(len(broad) == len(pools) - 4, 'full: every transport, but for load')
        check(any(every <= names(command) for command in paper.asked), f'{word}: every transport somewhere')


def leaves_out_what_is_missing():
    paper = Paper('--quick', MISSING='iceoryx|fastdds|fastdds-loan')
    check(paper.status == 0, 'transports that are missing are no error')
    check('left out: fastdds-loan' in paper.complained and 'left out: iceoryx' in paper.complained, 'they are named')
    check(not any({'iceoryx', 'fastdds'} & names(command) for command in paper.asked), 'and not asked for')
    said = [line.split()[2].rstrip(',') for line in Paper('--quick').complained.splitlines() if 'left out: ' in line]
    check(set(said) <= {'iceoryx', 'fastdds', 'fastdds-loan'}, 'only peers can be missing: no name is misspelt')


def ends_well():
    check(Paper('--quick', STATUS='1').status == 1, 'a transport that failed: the rest goes on, and 1 at the end')
    check(len(Paper('--quick', STATUS='1').asked) > 10, 'all of the rest')
    paper = Paper('--quick', STATUS='130')
    check(paper.status == 130 and len(paper.asked) == 1, 'Ctrl-C ends it')
    helped = subprocess.run([PAPER, '--help'], capture_output=True, text=True, check=False, timeout=WATCHDOG)
    check(helped.returncode == 0 and '--quick' in helped.stdout and 'set -e' not in helped.stdout, '--help')
    check(Paper('--fast').status == 2, 'an unknown option')


def has_ros():
    have = subprocess.run([LOT_AB, 'list'], capture_output=True, text=True, check=True).stdout
    if not re.search(r'^ros-lot +[^( ]', have, re.MULTILINE):
        paper = Paper('--ros')
        check(paper.status == 2 and not paper.asked, '--ros where lot_ab has no ROS: an error')
        check('built without ROS: run scripts/setup ros' in paper.complained, 'it says what to do')
        return
    for option, most in ((None, 60 * 60), ('--quick', 6 * 60)):
        paper = Paper(*([option] if option else []), '--ros')
        word = f'{option or "normal"} --ros'
        check(paper.status == 0 and paper.asked and not paper.wrote, f'{word}: every command is understood')
        check(f'drawn: {paper.out}' in paper.said, f'{word}: figures are drawn at the end')
        print(f'{word}: {paper.seconds()} s of pacing')
        check(0 < paper.seconds() < most, f'{word}: in time')
        check(all(any(n.startswith('ros-') for n in names(command)) for command in paper.asked), f'{word}: nodes of ROS')


run((has_ros, is_understood, leaves_out_what_is_missing, ends_well))
