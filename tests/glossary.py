#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Checks docs/glossary.md: few terms, each once, and none of the words that were given up.

    glossary.py [ROOT]       check the tree at ROOT (default: the tree this file lies in)
    glossary.py --self-test  plant mistakes in a scratch tree and see that each is found

A term that the code does not use as well is for users: then a public header or a page has it.
"""

import pathlib
import re
import sys
import tempfile

MOST = 40
ROW = re.compile(r'^\| ([^|]+?) \| (.+) \|$')
# Words for things that the field calls otherwise, and what LOT says now.
GIVEN_UP = {
    'bequests': 'adoptions', 'lie_down': 'prepare_to_sleep', 'Alone': 'QueueGuard',
    'came_home': 'last_hold_gone', 'bury': 'destroy, free', 'buried': 'destroyed, freed',
    'ControlCell': 'ControlBlock', 'Door': 'PeerNews', 'kEdge': 'kBusy', 'is_content': 'has_confirmed',
    'Chosen': 'Selection', 'Served': 'SelectedReader', 'taken_back': 'resent',
}


def check(root):
    page = root / 'docs' / 'glossary.md'
    complaints = []
    seen = {}
    for number, line in enumerate(page.read_text().splitlines(), 1):
        row = ROW.match(line)
        if not row or row.group(1) == 'term':
            continue
        for term in (t.strip() for t in row.group(1).split(',')):
            if term in seen:
                complaints.append(f'docs/glossary.md:{number}: {term} has a meaning in line {seen[term]}')
            seen[term] = number
    rows = len(set(seen.values()))
    if rows > MOST:
        complaints.append(f'docs/glossary.md: {rows} rows, at most {MOST}')
    texts = {f: f.read_text(errors='replace') for folder in ('src', 'include', 'docs', 'tests', 'fuzz')
             for f in sorted((root / folder).rglob('*')) if f.suffix in ('.hpp', '.cpp', '.md') and f != page}
    everything = '\n'.join(texts.values())
    for term, number in seen.items():
        if not re.search(rf'\b{re.escape(term)}', everything, re.I):
            complaints.append(f'docs/glossary.md:{number}: nothing uses {term}')
    for file, text in texts.items():
        for word, instead in GIVEN_UP.items():
            # As a word, or as the part of a name before or behind a _.
            found = re.search(rf'(?<![A-Za-z]){word}(?![a-z])', text, re.I if word.islower() else 0)
            if found:
                line = text.count('\n', 0, found.start()) + 1
                complaints.append(f'{file.relative_to(root)}:{line}: {word} is called {instead} now')
    return complaints


def self_test():
    good = {'docs/glossary.md': '| term | meaning |\n|---|---|\n| ring, slot | a |\n| hold | b |\n',
            'src/a.hpp': 'int ring, slot, hold;\n'}
    planted = [('docs/glossary.md', good['docs/glossary.md'] + '| slot | c |\n', 'has a meaning'),
               ('docs/glossary.md', good['docs/glossary.md'] + '| whim | c |\n', 'nothing uses whim'),
               ('docs/glossary.md', good['docs/glossary.md'] +
                ''.join(f'| slot{i} | c |\n' for i in range(MOST)), f'at most {MOST}'),
               ('src/a.hpp', good['src/a.hpp'] + 'int bury();\n', 'src/a.hpp:2: bury is called')]
    failures = []
    with tempfile.TemporaryDirectory(prefix='lot_glossary_') as scratch:
        root = pathlib.Path(scratch)
        for folder in ('docs', 'src', 'include'):
            (root / folder).mkdir()

        def write(name, text):
            (root / name).write_text(text)

        for name, text in good.items():
            write(name, text)
        failures += [f'a right tree is refused: {c}' for c in check(root)]
        for name, text, expected in planted:
            write(name, text)
            if not any(expected in c for c in check(root)):
                failures.append(f'not found: {expected}')
            write(name, good[name])
    return failures, 1 + len(planted)


def main():
    if '--self-test' in sys.argv[1:]:
        failures, count = self_test()
        print(*failures, f'glossary self-test: {count} cases, {len(failures)} failed', sep='\n')
        return 1 if failures else 0
    root = pathlib.Path(sys.argv[1]) if len(sys.argv) > 1 else pathlib.Path(__file__).parent.parent
    complaints = check(root.resolve())
    print(*complaints, f'glossary: {len(complaints)} wrong', sep='\n')
    return 1 if complaints else 0


if __name__ == '__main__':
    sys.exit(main())
