#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Checks that a test is found: by tests/README.md, and by grep in the names of cases.

    finding.py [ROOT]       check the tree at ROOT (default: the tree this file lies in)
    finding.py --self-test  plant mistakes in a scratch tree and see that each is found

The page names every *_test.cpp and *_test.py, and only files and tests that there are. Each word of the
interface stands in a case's name. A name stands on the line of its TEST_CASE, where one grep finds
both, and it names who acts. A case that another page names, by -tc='...' or as `some_test`: *a part of
its name*, is there.
"""

import fnmatch
import pathlib
import re
import sys
import tempfile

WORDS = (
    'ShmEngine', 'ShmPusher', 'ShmPuller', 'ShmQueue', 'ShmListener', 'WaitSet',
    'ShmUniquePtr', 'ShmSharedPtr', 'ShmWeakPtr', 'weak', 'ShmRef', 'ShmString', 'ShmVector',
    'Policy::Block', 'Policy::Overwrite', 'Policy::Refuse', 'Overwrite', 'Refuse', 'block_for',
    'history', 'latched', 'missed()', 'envelope', 'PusherOptions::stamp', 'LOT_STAMP',
    'loan', 'reserve', 'max_bytes', 'max_held_bytes', 'OutOfMemory',
    'HoldsTooMuch', 'PublisherGone', 'on_error', 'fd()', 'finish()', 'redeliver', 'persist',
    'permissions', 'LOT_GROUP', 'LOT_USER', 'fork', 'end_cleanly_on_signals', 'stop_on_signals', 'StopToken', 'call()',
    'lot ls', 'lot who', 'lot clean', 'lot doctor')
CASE = re.compile(r'TEST_CASE(?:_FIXTURE|_TEMPLATE)?\(.*')
NAME = re.compile(r'"((?:[^"\\]|\\.)*)"')
VAGUE = re.compile(r'\b(?:(?:any|every|no|some)body|who(?:m|so)?ever)\b|^who\b', re.I)
CODE = re.compile(r'`([^`]+)`')
TEST = re.compile(r'(?:\b(?:lot|tool|faults)_test\(|\badd_test\(NAME )([\w.]+)')
PATTERN = re.compile(r"-tc='([^']+)'")
PARTS = re.compile(r'`\w+`: ((?:\*[^*]+\*(?:, )?)+)')


def names_of_cases(root, complaints):
    names = []
    for file in sorted((root / 'tests').rglob('*.cpp')):
        for number, line in enumerate(file.read_text().splitlines(), 1):
            case = CASE.match(line.strip())
            if not case:
                continue
            name = NAME.search(case.group())
            place = f'{file.relative_to(root)}:{number}'
            if not name:
                complaints.append(f'{place}: the name is not on the line of its TEST_CASE')
                continue
            names.append(name.group(1))
            if VAGUE.search(name.group(1)):
                complaints.append(f'{place}: does not name who acts: {name.group(1)}')
    return names


def check_page(root):
    """Complaints about tests/README.md."""
    tests = root / 'tests'
    known = set()
    for top in ('tests', 'bench'):
        for file in (root / top).rglob('CMakeLists.txt'):
            known |= set(TEST.findall(file.read_text()))
    named = set()
    for number, line in enumerate((tests / 'README.md').read_text().splitlines(), 1):
        cells = [cell.strip() for cell in line.split('|')[1:-1]]
        if len(cells) != 3:
            continue
        for path in CODE.findall(cells[1]):
            named.add(path)
            if path == 'README.md' or not (tests / path).exists():
                yield f'tests/README.md:{number}: no such file: tests/{path}'
        for test in CODE.findall(cells[2]):
            if ' ' not in test and not any(name.startswith(test) for name in known):
                yield f'tests/README.md:{number}: no such test: {test}'
    for file in sorted(tests.rglob('*_test.*')):
        path = file.relative_to(tests).as_posix()
        if file.suffix in ('.cpp', '.py') and path not in named:
            yield f'tests/README.md: does not name tests/{path}'


def check_mentions(root, names):
    """Complaints about pages that name a case."""
    names = [name.lower() for name in names]
    for page in sorted([*root.glob('*.md'), *root.glob('docs/*.md'), *root.glob('tests/*.md')]):
        for number, line in enumerate(page.read_text().splitlines(), 1):
            wanted = PATTERN.findall(line)
            for parts in PARTS.findall(line):
                wanted += [f'*{part}*' for part in re.findall(r'\*([^*]+)\*', parts)]
            for pattern in wanted:
                if not fnmatch.filter(names, pattern.lower()):
                    yield f'{page.relative_to(root)}:{number}: no case is named {pattern}'


def check(root):
    complaints = []
    names = names_of_cases(root, complaints)
    complaints += [f'no name of a case has the word {word}'
                   for word in WORDS if not any(word in name for name in names)]
    return complaints + list(check_page(root)) + list(check_mentions(root, names))


PAGE = '''
| behaviour | file | run it |
|---|---|---|
| **Words** | | |
| all of them | `low/low_test.cpp`, `low/` | `low_test`, `scripts/test --stage docs` |
| more | `low/more_test.py` | `more` |
'''
GOOD = {
    'tests/README.md': PAGE,
    'tests/CMakeLists.txt': 'lot_test(low_test low/low_test.cpp)\nadd_test(NAME more COMMAND more)\n',
    'tests/low/low_test.cpp': ''.join(f'TEST_CASE_FIXTURE(F, "the reader has {word}") {{\n}}\n' for word in WORDS),
    'tests/low/more_test.py': '',
    'bench/CMakeLists.txt': '',
    'docs/low.md': "`low_test`: *has fd()*, *has fork*. `build/low_test -tc='The reader*missed()'`\n",
}
PLANTED = [  # file, its text, what must be complained about
    ('tests/README.md', PAGE + '| gone | `low/gone.cpp` | `low_test` |\n',
     'tests/README.md:7: no such file: tests/low/gone.cpp'),
    ('tests/README.md', PAGE + '| gone | `low/` | `gone` |\n', 'tests/README.md:7: no such test: gone'),
    ('tests/README.md', PAGE.replace('`low/low_test.cpp`, ', ''), 'does not name tests/low/low_test.cpp'),
    ('tests/README.md', PAGE.replace('| `low/more_test.py` |', '| |'), 'does not name tests/low/more_test.py'),
    ('tests/low/new_test.cpp', '', 'does not name tests/low/new_test.cpp'),
    ('tests/low/low_test.cpp', GOOD['tests/low/low_test.cpp'].replace('on_error', 'the error'),
     'no name of a case has the word on_error'),
    ('tests/low/help.cpp', 'TEST_CASE(\n    "long") {}\n', 'help.cpp:1: the name is not on the line'),
    ('tests/low/help.cpp', '\nTEST_CASE("who waits") {}\n', 'help.cpp:2: does not name who acts'),
    ('tests/low/help.cpp', 'TEST_CASE("it goes when nobody waits" *\n', 'help.cpp:1: does not name who'),
    ('docs/low.md', '\n(`low_test`: *has fd()*, *has no fd()*.)\n', 'docs/low.md:2: no case is named *has no fd()*'),
    ('docs/low.md', "`build/low_test -tc='reader*'`\n", 'docs/low.md:1: no case is named reader*'),
]


def self_test():
    """Each planted mistake must be found, and alone."""
    failures = []
    with tempfile.TemporaryDirectory() as scratch:
        root = pathlib.Path(scratch)

        def write(name, text):
            (root / name).parent.mkdir(parents=True, exist_ok=True)
            (root / name).write_text(text)

        for name, text in GOOD.items():
            write(name, text)
        failures += [f'a right tree is refused: {c}' for c in check(root)]
        for name, text, expected in PLANTED:
            write(name, text)
            complaints = check(root)
            (root / name).unlink()
            if name in GOOD:
                write(name, GOOD[name])
            if len(complaints) != 1 or expected not in complaints[0]:
                failures.append(f'{name}: expected {expected!r}, got {complaints}')
    return failures, 1 + len(PLANTED)


def main(arguments):
    if arguments == ['--self-test']:
        failures, count = self_test()
        print('\n'.join(failures + [f'finding self-test: {count} cases, {len(failures)} failed']))
        return 1 if failures else 0
    root = pathlib.Path(arguments[0]) if arguments else pathlib.Path(__file__).resolve().parent.parent
    complaints = check(root)
    print('\n'.join(complaints + [f'finding: {len(complaints)} wrong']))
    return 1 if complaints else 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
