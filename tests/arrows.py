#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Checks who includes whom, against the two tables in src/README.md.

    arrows.py [ROOT]       check the tree at ROOT (default: the tree this file lies in)
    arrows.py --self-test  plant wrong includes in a scratch tree and see that each is found

A section "Inside `MODULE`" lists the units of a module, bottom first: a unit (a header and its source) includes
units of rows above its own, and itself. Every file of the module belongs to a unit that is listed.

An include is looked up as the compiler would (beside the file, then in src/, include/, tests/ and so
on). One that names a module is judged by its name even when the file does not exist.

The second table says which module lends which header of include/lot/detail/. What `anybody` lends
belongs to no module: every module may include it. A module, and a header that it lends, may include what is lent by the module itself and by the modules that it may include. A
public header brings what it includes, by itself or by other public headers, so a module may include
it only if it may include all of that.
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
ANYBODY = 'anybody'
LENT = re.compile(r'^\|\s*`(\w+)`\s*\|((?:\s*`\w+`,?)+)\s*\|\s*$')
DETAIL = pathlib.PurePosixPath('include/lot/detail')
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
    """{module: set of modules it may include}, in the table's order, and {module: set of modules whose lent
    headers it may include}. A module's arrows only point up the page."""
    table, borrows = {}, {}
    for line in readme.read_text().splitlines():
        row = ROW.match(line)
        if not row:
            continue
        module, allowed = row.group(1), row.group(3).strip()
        if allowed in ('nothing', 'what all above lend'):
            modules = set()
        elif allowed == 'all above':
            modules = set(table)
        else:
            modules = set(re.findall(r'`(\w+)`', allowed))
            if not modules or re.sub(r'`\w+`|[,\s]', '', allowed):
                raise ValueError(f'{readme}: cannot read what {module} may include: {allowed!r}')
        if modules - set(table):
            raise ValueError(f'{readme}: {module} may only include modules above it, not '
                             + ', '.join(sorted(modules - set(table))))
        borrows[module] = modules | {module}
        if allowed == 'what all above lend':
            borrows[module] |= set(table)
        table[module] = modules
    if not table:
        raise ValueError(f'{readme}: no table of modules found')
    return table, borrows


def read_lent(readme, table):
    """{header of include/lot/detail/: the module that lends it}."""
    lent = {}
    for line in readme.read_text().splitlines():
        row = LENT.match(line)
        if not row:
            continue
        module = row.group(1)
        if module not in table and module != ANYBODY:
            raise ValueError(f'{readme}: {module} lends headers and is no module')
        for name in re.findall(r'`(\w+)`', row.group(2)):
            header = (DETAIL / f'{name}.hpp').as_posix()
            if header in lent:
                raise ValueError(f'{readme}: two modules lend {name}')
            lent[header] = module
    return lent


def read_units(readme):
    """{module: {unit: its row, from the bottom}}, for the modules whose units are listed."""
    units, module = {}, None
    for line in readme.read_text().splitlines():
        if line.startswith('## '):
            head = INSIDE.match(line)
            module = head and head.group(1)
            continue
        row = UNITS.match(line)
        if not module or not row:
            continue
        known = units.setdefault(module, {})
        number = len(set(known.values()))
        for unit in re.findall(r'`(\w+)`', row.group(1)):
            if unit in known:
                raise ValueError(f'{readme}: {module} has two rows for {unit}')
            known[unit] = number
    return units


def objection_inside(relative, name, units):
    """Why the file may not include the header `name` of its own module, or None."""
    rows = units.get(relative.parts[1], {}) if relative.parts[0] == 'src' and len(relative.parts) == 3 else {}
    unit, other = relative.name.split('.')[0], pathlib.PurePosixPath(name).name.split('.')[0]
    if unit not in rows or other not in rows or unit == other or rows[other] < rows[unit]:
        return None
    return f'{unit} is no unit above {other}'


def place(relative):
    """The module or folder of a path relative to the root: ('src', 'futex'), ('include', ''), ..."""
    parts = relative.parts
    if len(parts) > 2 and parts[0] == 'src':
        return 'src', parts[1]
    return (parts[0], '') if len(parts) > 1 else ('', '')


def file_of(root, file, name):
    """The file of this tree that an include leads to, relative to the root, or None."""
    for base in (file.parent, *(root / b for b in BASES)):
        found = (base / name).resolve()
        if found.is_file() and root in found.parents:
            return found.relative_to(root)
    return None


def target(found, name, table):
    """Where an include leads: a place as above, or None for a header that is not ours."""
    if found is not None:
        return place(found)
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
    folder, module = source
    if goal[0] in OUTER:
        return None if folder in OUTER[goal[0]] else f'nobody includes {goal[0]}/'
    if goal[0] != 'src':
        return None
    if folder == 'include':
        return 'include/ never includes src/'
    if folder != 'src' or module == goal[1] or goal[1] in table.get(module, ()):
        return None
    return f'src/{module} may not include src/{goal[1]}'


def includes_of(file):
    """(name, line) of each include of a file."""
    text = file.read_text(errors='replace')
    text = COMMENT.sub(lambda c: '\n' * c.group().count('\n'), text)
    return [(i.group(1), text.count('\n', 0, i.start(1)) + 1) for i in INCLUDE.finditer(text)]


class Lent:
    """What the headers of include/lot/ bring of what modules lend."""

    def __init__(self, root, readme, table):
        self.root = root
        self.modules = read_lent(readme, table)
        self.brought = {}

    def missing(self):
        """Complaints: the table and the folder name the same headers."""
        there = {p.relative_to(self.root).as_posix() for p in (self.root / DETAIL).glob('*')}
        return [f'{h}:1: no module of src/README.md lends it' for h in sorted(there - set(self.modules))] + [
            f'src/README.md:1: {self.modules[h]} lends {h}, which is not there'
            for h in sorted(set(self.modules) - there)]

    def brings(self, header):
        """{module: a lent header of it} for a header of include/lot/."""
        name = header.as_posix()
        if name in self.modules:
            return {self.modules[name]: name}
        if name not in self.brought:
            self.brought[name] = modules = {}
            file = self.root / header
            for include, _ in includes_of(file):
                found = file_of(self.root, file, include)
                if found is not None and found.parts[0] == 'include':
                    modules.update(self.brings(found))
        return self.brought[name]

    def objection(self, module, header, borrows):
        """Why a module, or a header that it lends, may not include a header of include/lot/, or None."""
        for lender, name in sorted(self.brings(header).items()):
            if lender != ANYBODY and lender not in borrows.get(module, ()):
                how = '' if name == header.as_posix() else f' brings {name}, which'
                return f'{how} {lender} lends, and {module} may not include'.strip()
        return None


def check(root):
    """All complaints about the tree at root, as lines 'file:line: why'."""
    root = root.resolve()
    readme = root / 'src' / 'README.md'
    table, borrows = read_table(readme)
    lent = Lent(root, readme, table)
    complaints = lent.missing()
    units = read_units(readme)
    for top in ('include', 'src', *OUTER):
        for file in sorted((root / top).rglob('*')):
            if file.suffix not in SUFFIXES or not file.is_file():
                continue
            relative = file.relative_to(root)
            source = place(relative)
            if top == 'src' and source[1] not in table:
                complaints.append(f'{relative}:1: lies in no module of src/README.md')
                continue
            rows = units.get(source[1]) if top == 'src' and len(relative.parts) == 3 else None
            if rows is not None and file.name.split('.')[0] not in rows:
                complaints.append(f'{relative}:1: belongs to no unit of src/README.md')
            borrower = source[1] if top == 'src' else lent.modules.get(relative.as_posix())
            for name, line in includes_of(file):
                found = file_of(root, file, name)
                goal = target(found, name, table)
                why = goal and (objection(source, goal, table) or
                                (goal == source and objection_inside(relative, name, units)))
                if not why and borrower and goal and goal[0] == 'include':
                    why = lent.objection(borrower, found, borrows)
                if why:
                    complaints.append(f'{relative}:{line}: {name}: {why}')
    return complaints


TABLE = '''
| module | what | may include |
|---|---|---|
| `low` | a | nothing |
| `side` | b | nothing |
| `middle` | c | `low` |
| `high` | d | all above |
| `guest` | e | what all above lend |

| module | lends |
|---|---|
| `anybody` | `common` |
| `low` | `deep`, `other` |
| `high` | `inline` |

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
    'include/lot/plain.hpp': '#include <vector>\n',
    'include/lot/detail/inline.hpp': '#include <lot/noun.hpp>\n#include "deep.hpp"\n',
    'include/lot/detail/deep.hpp': '#include "lot/plain.hpp"\n',
    'include/lot/detail/common.hpp': '#include <atomic>\n',
    'include/lot/detail/other.hpp': '#include "lot/detail/deep.hpp"\n',
    'src/low/low.hpp': '// #include "high/high.hpp"\n/*\n#include "high/high.hpp"\n*/\n',
    'src/side/side.hpp': '#include <lot/plain.hpp>\n#include "lot/detail/common.hpp"\n',
    'src/middle/middle.cpp': '#include "low/low.hpp"\n#include <benchmark/benchmark.h>\n'
                             '#include "lot/detail/other.hpp"\n',
    'src/high/high.hpp': '#include "../middle/none.hpp"\n#include <side/side.hpp>\n'
                         '#include "lot/noun.hpp"\n',
    'src/guest/guest.cpp': '#include "lot/noun.hpp"\n#include "lot/detail/deep.hpp"\n',
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
    ('src/stray/bad.cpp', '', 'lies in no module'),
    ('src/bad.cpp', '', 'lies in no module'),
    ('include/lot/bad.hpp', '#include "low/low.hpp"\n', 'include/ never includes src/'),
    ('include/lot/bad.hpp', '#include "../../src/gone/gone.hpp"\n', 'include/ never includes src/'),
    ('include/lot/bad.hpp', '#include "bench/micro/floor.hpp"\n', 'nobody includes bench/'),
    ('fuzz/low/bad.cpp', '#include "bench/micro/floor.hpp"\n', 'nobody includes bench/'),
    ('bench/micro/bad.cpp', '#include "support/help.hpp"\n', 'nobody includes tests/'),
    ('examples/bad.cpp', '#include "fuzz/fuzz.cpp"\n', 'nobody includes fuzz/'),
    ('src/guest/bad.cpp', '#include "low/low.hpp"\n', 'src/guest may not include src/low'),
    ('src/side/bad.cpp', '#include "lot/detail/deep.hpp"\n', 'low lends, and side may not include'),
    ('src/low/bad.cpp', '#include <lot/detail/inline.hpp>\n', 'high lends, and low may not include'),
    ('src/low/bad.cpp', '#include "../../include/lot/detail/inline.hpp"\n', 'high lends'),
    ('src/middle/bad.cpp', '#include "lot/noun.hpp"\n',
     'brings include/lot/detail/inline.hpp, which high lends, and middle may not include'),
    ('include/lot/detail/deep.hpp', '#include "inline.hpp"\n', 'high lends, and low may not include'),
    ('include/lot/detail/deep.hpp', '\n#include "lot/noun.hpp"\n', 'detail/deep.hpp:2:'),
    ('include/lot/detail/common.hpp', '#include "inline.hpp"\n', 'high lends, and anybody may not include'),
    ('include/lot/detail/stray.hpp', '', 'no module of src/README.md lends it'),
]


TABLES = [  # a row more, and what is wrong with it
    ('| `top` | e | `missing` |\n', 'names an unknown module'),
    ('| `missing` | `more` |\n', 'lends for an unknown module'),
    ('| `side` | `deep` |\n', 'lends a header twice'),
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
            if name in GOOD:
                write(name, GOOD[name])
            if len(complaints) != 1 or expected not in complaints[0]:
                failures.append(f'{name} {text.strip()!r}: expected {expected!r}, got {complaints}')
        (root / 'include/lot/detail/other.hpp').unlink()
        write('src/middle/middle.cpp', '')
        if len(check(root)) != 1 or 'which is not there' not in check(root)[0]:
            failures.append(f'a lent header that is not there: {check(root)}')
        for row, what in TABLES:
            write('src/README.md', TABLE + row)
            try:
                check(root)
                failures.append(f'a table is accepted that {what}')
            except ValueError:
                pass
        write('src/README.md', TABLE.replace('`left`, `right`', '`left`, `floor`'))
        try:
            check(root)
            failures.append('a unit with two rows is accepted')
        except ValueError:
            pass
    return failures, len(GOOD) + len(PLANTED) + 2 + len(TABLES)


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
