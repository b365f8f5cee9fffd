#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Compares the codec with one of two others, byte for byte, for types and values made up by chance.

    tests/codec/independent.py fastcdr|rosmsg2 PROGRAM [COMPILER]

PROGRAM is random_messages. `fastcdr` makes C++ of our IDL by fastddsgen, and encodes by Fast CDR. `rosmsg2` reads our
.msg by @foxglove/rosmsg, and encodes by @foxglove/rosmsg2-serialization. Each gets the values of a message as a
list, and must make the bytes of it that the codec has made.

A usual run takes 20 types, LOT_TEST_ONE_IN=1 all 500. LOT_TEST_SEED says which.
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
FEW = 20
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


def getters(idl):
    """(C++ that reads a value of each struct in an IDL file, the last struct's name)."""
    text, name = '', ''
    for package, struct, members in STRUCT.findall(idl):
        name = f'{package}::msg::{struct}'
        fields = ''.join(f' get(values, v.{m}());' for m in MEMBER.findall(members))
        text += f'inline void get(Values& values, {name}& v) {{{fields} }}\n'
    return text, name


def declared(idl):
    """The same functions, declared before the templates that call them."""
    return ''.join(f'inline void get(Values& values, {p}::msg::{s}& v);\n' for p, s, _ in STRUCT.findall(idl))


def driver(folder, numbers, part):
    """Writes the program that encodes types by Fast CDR, and returns its sources."""
    idls = {n: (folder / f'{n}.idl').read_text() for n in numbers}
    joined = ''.join(dict.fromkeys(  # types of namespace `lot` are alike in name alone: each file has its own
        idls[n].replace('lot::msg::', f'lot{n}::msg::').replace('module lot {', f'module lot{n} {{') for n in numbers))
    (folder / f'types{part}.idl').write_text(joined)
    run(['fastddsgen', '-d', folder, '-t', folder, '-replace', folder / f'types{part}.idl'])
    calls, text = '', declared(joined)
    bodies = ''
    for n in numbers:
        own = idls[n].replace('lot::msg::', f'lot{n}::msg::').replace('module lot {', f'module lot{n} {{')
        code, name = getters(own)
        bodies += code
        calls += f'  good = compare<{name}>({n}) && good;\n'
    source = (HERE / 'fastcdr_driver.cpp').read_text()
    source = source.replace('// TYPES\n', f'#include "types{part}.h"\n').replace('// DECLARED\n', text)
    source = source.replace('// BODIES\n', bodies).replace('  // CALLS\n', calls)
    (folder / f'driver{part}.cpp').write_text(source)
    return [folder / f'driver{part}.cpp', folder / f'types{part}.cxx']


def fastcdr(folder, count, compiler):
    for part, first in enumerate(range(0, count, IN_ONE_FILE)):
        sources = driver(folder, range(first, min(first + IN_ONE_FILE, count)), part)
        program = folder / f'driver{part}'
        run([compiler, '-std=c++17', '-O0', '-w', *sources, '-o', program, '-lfastcdr'])
        print(run([program], cwd=folder), end='')


def rosmsg2(folder, count, _):
    modules = run(['npm', 'root', '-g']).strip()
    environment = dict(os.environ, NODE_PATH=modules)
    print(run(['node', HERE / 'rosmsg2_driver.cjs', folder, str(count)], env=environment), end='')


def main():
    which, program = sys.argv[1], sys.argv[2]
    if which == 'fastcdr' and not (shutil.which('fastddsgen') and pathlib.Path('/usr/include/fastcdr/Cdr.h').exists()):
        skip('no fastddsgen and Fast CDR here')
    if which == 'rosmsg2':
        found = shutil.which('npm') and shutil.which('node') and subprocess.run(
            ['npm', 'ls', '-g', '@foxglove/rosmsg2-serialization'], stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL).returncode == 0
        if not found:
            skip('no @foxglove/rosmsg2-serialization here')
    count = ALL if os.environ.get('LOT_TEST_ONE_IN') == '1' else FEW
    seed = os.environ.get('LOT_TEST_SEED') or str(random.SystemRandom().randrange(2 ** 32))
    print(f'seed: LOT_TEST_SEED={seed}', flush=True)
    with tempfile.TemporaryDirectory(prefix='lot_codec.') as folder:
        run([program, seed, str(count), folder])
        {'fastcdr': fastcdr, 'rosmsg2': rosmsg2}[which](pathlib.Path(folder), count, *sys.argv[3:4] or ['g++'])
    print(f'{which}: {count} types have the same bytes')


if __name__ == '__main__':
    main()
