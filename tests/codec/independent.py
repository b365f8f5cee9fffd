#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Compares the codec with one of two others, byte for byte, for types and values made up by chance.

    tests/codec/independent.py fastcdr PROGRAM COMPILER
    tests/codec/independent.py rosmsg2 PROGRAM MODULES

PROGRAM is random_messages; MODULES the node_modules that scripts/setup makes. `fastcdr` makes C++ of our IDL by fastddsgen, and encodes by Fast CDR. `rosmsg2` reads our
.msg by @foxglove/rosmsg, and encodes by @foxglove/rosmsg2-serialization. Each gets the values of a message as a
list, and must make the bytes of it that the codec has made.

LOT_TEST_ONE_IN=N: a share of the types, others with each LOT_TEST_SEED, which is printed.
"""

import os
import pathlib
import random
import re
import shutil
import subprocess
import sys
import tempfile

HERE = pathlib.Path(__file__).resolve().parent
ALL = 500
IN_ONE_FILE = 50  # types that one run of the compiler takes

STRUCT = re.compile(r'module (\w+) \{\nmodule msg \{\nstruct (\w+) \{\n(.*?)\};\n\};\n\};\n', re.S)
MEMBER = re.compile(r'^  \S+ _?(\w+)(?:\[\d+\])?;', re.M)


def skip(why):
    print(f'skipped: {why}')
    sys.exit(0)


def run(command, **options):
    """Runs a program; what it has said is shown if it fails."""
    result = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, **options)
    if result.returncode != 0:
        sys.exit(f'{" ".join(map(str, command[:3]))} ...: exit status {result.returncode}\n{result.stdout[-6000:]}')
    return result.stdout


def own(idl, number):
    """Types of the codec's own package are alike in name alone: each file gets its own package of them."""
    return idl.replace('lot::msg::', f'lot{number}::msg::').replace('module lot {', f'module lot{number} {{')


def getters(idl):
    """(C++ that declares what gives each struct of an IDL file its values, C++ that defines it, the last struct)."""
    declared, defined, name = '', '', ''
    for package, struct, members in STRUCT.findall(idl):
        name = f'{package}::msg::{struct}'
        fields = ''.join(f' get(values, v.{m}());' for m in MEMBER.findall(members))
        declared += f'inline void get(Values& values, {name}& v);\n'
        defined += f'inline void get(Values& values, {name}& v) {{{fields} }}\n'
    return declared, defined, name


def driver(folder, numbers, part):
    """Builds the program that encodes these types by Fast CDR."""
    idls = {n: own((folder / f'{n}.idl').read_text(), n) for n in numbers}
    (folder / f'types{part}.idl').write_text(''.join(idls.values()))
    run(['fastddsgen', '-cs', '-d', folder, '-t', folder, '-replace', folder / f'types{part}.idl'])
    source = (HERE / 'fastcdr_driver.cpp').read_text().replace('// TYPES\n', f'#include "types{part}.h"\n')
    made = {n: getters(idl) for n, idl in idls.items()}
    source = source.replace('// DECLARED\n', ''.join(m[0] for m in made.values()))
    source = source.replace('// BODIES\n', ''.join(m[1] for m in made.values()))
    source = source.replace('  // CALLS\n', ''.join(f'  good = compare<{m[2]}>({n}) && good;\n'
                                                  for n, m in made.items()))
    (folder / f'driver{part}.cpp').write_text(source)
    return [folder / f'driver{part}.cpp', folder / f'types{part}.cxx']


def fastcdr(folder, count, compiler):
    """The commands that compare all types by Fast CDR."""
    commands = []
    for part, first in enumerate(range(0, count, IN_ONE_FILE)):
        sources = driver(folder, range(first, min(first + IN_ONE_FILE, count)), part)
        program = folder / f'driver{part}'
        run([compiler, '-std=c++17', '-O0', '-w', *sources, '-o', program, '-lfastcdr'])
        commands.append([program])
    return commands


def rosmsg2(folder, count, modules):
    os.environ['NODE_PATH'] = modules
    return [['node', HERE / 'rosmsg2_driver.cjs', folder, str(count)]]


def require_can_fail(command, folder):
    """A comparison that cannot fail proves nothing: the first type gets another byte."""
    file = folder / '0.cdr'
    changed = bytearray(file.read_bytes())
    changed[-1] ^= 1
    file.write_bytes(changed)
    result = subprocess.run(command, stdout=subprocess.PIPE, text=True, cwd=folder)
    if result.returncode == 0 or not result.stdout.startswith('type 0: '):
        sys.exit(f'a changed byte was not found: {result.stdout}')


def main():
    which, program, other = sys.argv[1:]
    if which == 'fastcdr' and not (shutil.which('fastddsgen') and pathlib.Path('/usr/include/fastcdr/Cdr.h').exists()):
        skip('no fastddsgen and Fast CDR here')
    if which == 'rosmsg2' and not (shutil.which('node') and pathlib.Path(other, '@foxglove/rosmsg2-serialization').is_dir()):
        skip('no packages of npm here (scripts/setup test)')
    count = max(1, ALL // int(os.environ.get('LOT_TEST_ONE_IN', 1)))
    seed = os.environ.get('LOT_TEST_SEED') or str(random.SystemRandom().randrange(2 ** 32))
    print(f'seed: LOT_TEST_SEED={seed}', flush=True)
    with tempfile.TemporaryDirectory(prefix='lot_codec.') as folder:
        folder = pathlib.Path(folder)
        run([program, seed, str(count), folder])
        commands = {'fastcdr': fastcdr, 'rosmsg2': rosmsg2}[which](folder, count, other)
        for command in commands:
            run(command, cwd=folder)
        require_can_fail(commands[0], folder)
    print(f'{which}: {count} types have the same bytes')


if __name__ == '__main__':
    main()
