#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Checks who includes whom, against the table in src/README.md.

    arrows.py [ROOT]       check the tree at ROOT (default: the tree this file lies in)
    arrows.py --self-test  plant wrong includes in a scratch tree and see that each is found

A section "Inside `ROOM`" lists the units of a room, bottom first: a unit (a header and its source) includes
units of rows above its own, and itself. Every file of the room belongs to a unit that is listed.

An include is looked up as the compiler would (beside the file, then in src/, include/, tests/ and so
on). One that names a room is judged by its name even when the file does not exist.
"""

import pathlib
import re
import sys
import tempfile

INCLUDE = re.compile(r'^[ \t]*#[ \t]*(?:include|include_next|import)[ \t]*["<]([^">]+)[">]', re.M)
COMMENT = re.compile(r'/\*.*?\*/', re.S)
ROW = re.compile(r'^\|\s*`(\w+)/?`\s*\|(.*)\|([^|]*)\|\s*$')
INSIDE = re.compile(r'^## Inside `(\w+)`$')
UNITS = re.compile(r'^\|\s*((?:`\w+`(?:,\s*)?)+)\s*\|[^|]*\|\s*$')
SUFFIXES = {'.hpp', '.cpp', '.h', '.cc', '.inc', '.in'}
BASES = ('src', 'include', 'tests', 'bench', 'fuzz', 'examples', '')
# Who, outside a folder, may include it. Folders of src/ are the table's business.
OUTER = {
    'bench': {'bench', 'tests'},  # tests of the harness
    'examples': {'examples'},
    'tests': {'tests', 'fuzz'},
    'fuzz': {'fuzz', 'tests'},
}


def read_table(readme):
    """{room: set of rooms it may include}, in the table's order. A room's arrows only point up the page."""
    table = {}
    for line in readme.read_text().splitlines():
        row = ROW.match(line)
        if not row:
            continue
        room, allowed = row.group(1), row.group(3).strip()
        if allowed == 'nothing':
            rooms = set()
        elif allowed == 'all above':
            rooms = set(table)
        else:
            rooms = set(re.findall(r'`(\w+)`', allowed))
            if not rooms or re.sub(r'`\w+`|[,\s]', '', allowed):
                raise ValueError(f'{readme}: cannot read what {room} may include: {allowed!r}')
        if rooms - set(table):
            raise ValueError(f'{readme}: {room} may only include rooms above it, not '
                             + ', '.join(sorted(rooms - set(table))))
        table[room] = rooms
    if not table:
        raise ValueError(f'{readme}: no table of rooms found')
    return table


def read_units(readme):
    """{room: {unit: its row, from the bottom}}, for the rooms whose units are listed."""
    units, room = {}, None
    for line in readme.read_text().splitlines():
        if line.startswith('## '):
            head = INSIDE.match(line)
            room = head and head.group(1)
            continue
        row = UNITS.match(line)
        if not room or not row:
            continue
        known = units.setdefault(room, {})
        number = len(set(known.values()))
        for unit in re.findall(r'`(\w+)`', row.group(1)):
            if unit in known:
                raise ValueError(f'{readme}: {room} has two rows for {unit}')
            known[unit] = number
    return units


def objection_inside(relative, name, units):
    """Why the file may not include the header `name` of its own room, or None."""
    rows = units.get(relative.parts[1], {}) if relative.parts[0] == 'src' and len(relative.parts) == 3 else {}
    unit, other = relative.name.split('.')[0], pathlib.PurePosixPath(name).name.split('.')[0]
    if unit not in rows or other not in rows or unit == other or rows[other] < rows[unit]:
        return None
    return f'{unit} is no unit above {other}'


def place(relative):
    """The room or folder of a path relative to the root: ('src', 'futex'), ('include', ''), ..."""
    parts = relative.parts
    if len(parts) > 2 and parts[0] == 'src':
        return 'src', parts[1]
    return (parts[0], '') if len(parts) > 1 else ('', '')


def target(root, file, name, table):
    """Where an include leads: a place as above, or None for a header that is not ours."""
    for base in (file.parent, *(root / b for b in BASES)):
        found = (base / name).resolve()
        if found.is_file() and root in found.parents:
            return place(found.relative_to(root))
    parts = [p for p in pathlib.PurePosixPath(name).parts if p not in ('.', '..')]
    if parts and parts[0] == 'src':
        return 'src', parts[1] if len(parts) > 2 else ''
    if len(parts) > 1 and parts[0] in table:
        return 'src', parts[0]
    if len(parts) > 1 and parts[0] in OUTER:
        return parts[0], ''
    return None


def objection(source, goal, table):
    """Why `source` may not include `goal`, or None."""
    folder, room = source
    if goal[0] in OUTER:
        return None if folder in OUTER[goal[0]] else f'nobody includes {goal[0]}/'
    if goal[0] != 'src':
        return None
    if folder == 'include':
        return 'include/ never includes src/'
    if folder != 'src' or room == goal[1] or goal[1] in table.get(room, ()):
        return None
    return f'src/{room} may not include src/{goal[1]}'


def check(root):
    """All complaints about the tree at root, as lines 'file:line: why'."""
    root = root.resolve()
    table = read_table(root / 'src' / 'README.md')
    units = read_units(root / 'src' / 'README.md')
    complaints = []
    for top in ('include', 'src', *OUTER):
        for file in sorted((root / top).rglob('*')):
            if file.suffix not in SUFFIXES or not file.is_file():
                continue
            relative = file.relative_to(root)
            source = place(relative)
            if top == 'src' and source[1] not in table:
                complaints.append(f'{relative}:1: lies in no room of src/README.md')
                continue
            rows = units.get(source[1]) if top == 'src' and len(relative.parts) == 3 else None
            if rows is not None and file.name.split('.')[0] not in rows:
                complaints.append(f'{relative}:1: belongs to no unit of src/README.md')
            text = file.read_text(errors='replace')
            text = COMMENT.sub(lambda c: '\n' * c.group().count('\n'), text)
            for include in INCLUDE.finditer(text):
                goal = target(root, file, include.group(1), table)
                why = goal and (objection(source, goal, table) or
                                (goal == source and
                                 objection_inside(relative, include.group(1), units)))
                if why:
                    line = text.count('\n', 0, include.start(1)) + 1
                    complaints.append(f'{relative}:{line}: {include.group(1)}: {why}')
    return complaints


TABLE = '''
| room | what | may include |
|---|---|---|
| `low` | a | nothing |
| `side` | b | nothing |
| `middle` | c | `low` |
| `high` | d | all above |

## Inside `high`

| unit | job |
|---|---|
| `floor` | a |
| `left`, `right` | b |
| `high` | c |

## Around
'''
GOOD = {
    'include/lot/noun.hpp': '#include <vector>\n#include "detail/inline.hpp"\n',
    'include/lot/detail/inline.hpp': '#include <lot/noun.hpp>\n',
    'src/low/low.hpp': '// #include "high/high.hpp"\n/*\n#include "high/high.hpp"\n*/\n',
    'src/side/side.hpp': '#include <lot/noun.hpp>\n',
    'src/middle/middle.cpp': '#include "low/low.hpp"\n#include <benchmark/benchmark.h>\n',
    'src/high/high.hpp': '#include "../middle/none.hpp"\n#include <side/side.hpp>\n#include "high/left.hpp"\n',
    'src/high/high.cpp': '#include "high/high.hpp"\n#include "right.hpp"\n',
    'src/high/left.hpp': '#include "high/floor.hpp"\n',
    'src/high/right.hpp': '',
    'src/high/floor.hpp': '',
    'tests/low/test.cpp': '#include "low/low.hpp"\n#include "support/help.hpp"\n',
    'tests/support/help.hpp': '#include "high/high.hpp"\n',
    'fuzz/fuzz.cpp': '#include "tests/support/help.hpp"\n',
    'bench/micro/main.cpp': '#include "floor.hpp"\n',
    'bench/micro/floor.hpp': '#include "high/high.hpp"\n',
}
PLANTED = [  # file, its text, what must be complained about
    ('src/low/bad.hpp', '\n#include "middle/middle.hpp"\n', 'src/low/bad.hpp:2:'),
    ('src/low/bad.hpp', '#include "high/high.hpp"\n', 'src/low may not include src/high'),
    ('src/middle/bad.cpp', '#include <side/side.hpp>\n', 'src/middle may not include src/side'),
    ('src/middle/bad.cpp', '# include "../side/side.hpp"\n', 'src/middle may not include src/side'),
    ('src/high/left.cpp', '#include "high/right.hpp"\n', 'left is no unit above right'),
    ('src/high/floor.cpp', '\n#include "high.hpp"\n', 'src/high/floor.cpp:2:'),
    ('src/high/stray.cpp', '', 'belongs to no unit'),
    ('src/high/left.cpp', '#include "support/help.hpp"\n', 'nobody includes tests/'),
    ('src/high/left.cpp', '#include "../../bench/micro/floor.hpp"\n', 'nobody includes bench/'),
    ('src/stray/bad.cpp', '', 'lies in no room'),
    ('src/bad.cpp', '', 'lies in no room'),
    ('include/lot/bad.hpp', '#include "low/low.hpp"\n', 'include/ never includes src/'),
    ('include/lot/bad.hpp', '#include "../../src/gone/gone.hpp"\n', 'include/ never includes src/'),
    ('include/lot/bad.hpp', '#include "bench/micro/floor.hpp"\n', 'nobody includes bench/'),
    ('fuzz/low/bad.cpp', '#include "bench/micro/floor.hpp"\n', 'nobody includes bench/'),
    ('bench/micro/bad.cpp', '#include "support/help.hpp"\n', 'nobody includes tests/'),
    ('examples/bad.cpp', '#include "fuzz/fuzz.cpp"\n', 'nobody includes fuzz/'),
]


def self_test():
    """Each planted include must be found, and alone."""
    failures = []
    with tempfile.TemporaryDirectory() as scratch:
        root = pathlib.Path(scratch)

        def write(name, text):
            (root / name).parent.mkdir(parents=True, exist_ok=True)
            (root / name).write_text(text)

        write('src/README.md', TABLE)
        for name, text in GOOD.items():
            write(name, text)
        failures += [f'a right include is refused: {c}' for c in check(root)]
        for name, text, expected in PLANTED:
            write(name, text)
            complaints = check(root)
            (root / name).unlink()
            if len(complaints) != 1 or expected not in complaints[0]:
                failures.append(f'{name} {text.strip()!r}: expected {expected!r}, got {complaints}')
        write('src/README.md', TABLE + '| `top` | e | `missing` |\n')
        try:
            check(root)
            failures.append('a table that names an unknown room is accepted')
        except ValueError:
            pass
        write('src/README.md', TABLE.replace('`left`, `right`', '`left`, `floor`'))
        try:
            check(root)
            failures.append('a unit with two rows is accepted')
        except ValueError:
            pass
    return failures, len(GOOD) + len(PLANTED) + 2


def main(arguments):
    if arguments == ['--self-test']:
        failures, count = self_test()
        print('\n'.join(failures + [f'arrows self-test: {count} cases, {len(failures)} failed']))
        return 1 if failures else 0
    root = pathlib.Path(arguments[0]) if arguments else pathlib.Path(__file__).parent.parent
    try:
        complaints = check(root)
    except (OSError, ValueError) as error:
        complaints = [str(error)]
    print('\n'.join(complaints + [f'arrows: {len(complaints)} wrong']))
    return 1 if complaints else 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
