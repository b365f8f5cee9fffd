#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Checks docs/private-locks.md against the locks in the code.

    private_locks.py [ROOT]       check the tree at ROOT (default: the tree this file lies in)
    private_locks.py --self-test  plant mistakes in a scratch tree and see that each is found

1. The page's table has the ranks of `enum class Rank` (include/lot/detail/mutex.hpp), in their order.
2. Each row names the files that have locks of its rank, and no others.
3. What a row says may be held when the lock is taken stands above it.
4. src/ and include/ have no mutex or condition of std's besides: these would have no rank.
"""

import pathlib
import re
import sys
import tempfile

HEADER = 'include/lot/detail/mutex.hpp'
PAGE = 'docs/private-locks.md'
ENUM = re.compile(r'enum class Rank\b[^{]*\{(.*?)\};', re.S)
COMMENT = re.compile(r'//[^\n]*|/\*.*?\*/', re.S)
USE = re.compile(r'\bRank::(\w+)')
STD = re.compile(r'\bstd::((?:recursive_|timed_|recursive_timed_|shared_|shared_timed_)?mutex'
                 r'|condition_variable(?:_any)?)\b')
CODE = re.compile(r'`([^`]+)`')
RANK = re.compile(r'[A-Z]\w*')
SUFFIXES = {'.hpp', '.cpp'}


def ranks_of(root):
    enum = ENUM.search(COMMENT.sub('', (root / HEADER).read_text()))
    if not enum:
        raise ValueError(f'{HEADER}: no enum class Rank')
    return re.findall(r'\w+', enum.group(1))


def rows_of(root):
    """(line, rank, files, ranks that may be held) of each row of the page's table."""
    for number, line in enumerate((root / PAGE).read_text().splitlines(), 1):
        cells = [cell.strip() for cell in line.split('|')[1:-1]]
        first = CODE.fullmatch(cells[0]) if len(cells) == 5 else None
        if first and RANK.fullmatch(first.group(1)):
            files = {c for c in CODE.findall(cells[1]) if '/' in c}
            yield number, first.group(1), files, CODE.findall(cells[3])


def check(root):
    """All complaints about the tree at root."""
    complaints = []
    ranks = ranks_of(root)
    place = {rank: i for i, rank in enumerate(ranks)}
    uses = {}
    for top in ('include', 'src'):
        for file in sorted((root / top).rglob('*')):
            relative = file.relative_to(root).as_posix()
            if file.suffix not in SUFFIXES or not file.is_file() or relative == HEADER:
                continue
            text = COMMENT.sub(lambda c: '\n' * c.group().count('\n'), file.read_text())
            for found in STD.finditer(text):
                line = text.count('\n', 0, found.start()) + 1
                complaints.append(f'{relative}:{line}: std::{found.group(1)} has no rank')
            for rank in USE.findall(text):
                uses.setdefault(rank, set()).add(relative)
    rows = list(rows_of(root))
    named = [rank for _, rank, _, _ in rows]
    if named != ranks:
        complaints.append(f'{PAGE}: the rows are not the ranks in their order: '
                          + ', '.join(named) + '; the ranks are ' + ', '.join(ranks))
    for number, rank, files, held in rows:
        for file in sorted(files - uses.get(rank, set())):
            complaints.append(f'{PAGE}:{number}: {file} has no lock of rank {rank}')
        for file in sorted(uses.get(rank, set()) - files):
            complaints.append(f'{PAGE}:{number}: {file} has a lock of rank {rank}, too')
        for other in held:
            if place.get(other, len(ranks)) >= place.get(rank, -1):
                complaints.append(f'{PAGE}:{number}: {other} does not stand above {rank}')
    return complaints


GOOD = {
    HEADER: '''
enum class Rank : unsigned char {
  // one, and others
  Outer,
  Middle,
  Leaf,
};
class Mutex { std::mutex mutex_; };
''',
    'src/a/outer.hpp': 'Mutex mutex_{Rank::Outer};\nbool has() { return mutex_.try_lock(); }\n',
    'src/a/outer.cpp': 'static Mutex other(detail::Rank::Outer);  // beside std::mutex\n',
    'src/b/middle.hpp': 'Mutex mutex_{detail::Rank::Middle};\n',
    'src/b/leaf.cpp': 'Mutex mutex_{Rank::Leaf};\n',
    PAGE: '''
| lock | where | guards | held when it is taken | application code |
|---|---|---|---|---|
| `Outer` | `src/a/outer.hpp`, `src/a/outer.cpp`: `mutex_` | a | | no |
| `Middle` | `src/b/middle.hpp` | b | `Outer` | yes |
| `Leaf` | `src/b/leaf.cpp` | c | `Outer`, `Middle` | no |
''',
}
PLANTED = [  # file, what is replaced, by what, what must be complained about
    ('src/a/outer.hpp', 'Mutex', 'std::mutex', 'std::mutex has no rank'),
    ('src/b/leaf.cpp', 'Mutex', 'std::condition_variable_any c;\nMutex',
     'src/b/leaf.cpp:1: std::condition_variable_any has no rank'),
    (HEADER, '  Middle,\n', '', 'are not the ranks in their order'),
    (HEADER, '  Middle,\n  Leaf,', '  Leaf,\n  Middle,', 'are not the ranks in their order'),
    (PAGE, '| `Leaf`', '| `Twig`', 'are not the ranks in their order'),
    (PAGE, '| `Outer` | yes |', '| `Leaf` | yes |', 'Leaf does not stand above Middle'),
    (PAGE, '`Outer`, `Middle` | no', '`Leaf` | no', 'Leaf does not stand above Leaf'),
    (PAGE, '`Outer` | yes', '`Gone` | yes', 'Gone does not stand above Middle'),
    (PAGE, ', `src/a/outer.cpp`', '', 'src/a/outer.cpp has a lock of rank Outer, too'),
    ('src/b/leaf.cpp', 'Rank::Leaf', 'Rank::Middle', 'src/b/leaf.cpp has no lock of rank Leaf'),
]


def self_test():
    """Each planted mistake must be found."""
    failures = []
    with tempfile.TemporaryDirectory() as scratch:
        root = pathlib.Path(scratch)

        def write(name, text):
            (root / name).parent.mkdir(parents=True, exist_ok=True)
            (root / name).write_text(text)

        for name, text in GOOD.items():
            write(name, text)
        failures += [f'a right tree is refused: {c}' for c in check(root)]
        for name, old, new, expected in PLANTED:
            if GOOD[name].count(old) == 0:
                failures.append(f'{name}: nothing to plant {new!r} in')
            write(name, GOOD[name].replace(old, new, 1))
            complaints = check(root)
            write(name, GOOD[name])
            if not any(expected in c for c in complaints):
                failures.append(f'{name} {new!r}: expected {expected!r}, got {complaints}')
    return failures, 1 + len(PLANTED)


def main(arguments):
    if arguments == ['--self-test']:
        failures, count = self_test()
        print('\n'.join(failures + [f'private locks self-test: {count} cases, {len(failures)} failed']))
        return 1 if failures else 0
    root = pathlib.Path(arguments[0]) if arguments else pathlib.Path(__file__).resolve().parent.parent
    try:
        complaints = check(root)
    except (OSError, ValueError) as error:
        complaints = [str(error)]
    print('\n'.join(complaints + [f'private locks: {len(complaints)} wrong']))
    return 1 if complaints else 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
