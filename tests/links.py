#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Follows every link of the pages: to a file that is there, and to a heading that is in it.

    links.py [ROOT]       check the pages of the tree at ROOT (default: the tree this file lies in)
    links.py --self-test  plant mistakes in a scratch tree and see that each is found

Links to other sites are not followed. A heading's anchor is GitHub's: small letters, no signs, a
hyphen for each space, -1 for the second of a name.
"""

import pathlib
import re
import sys
import tempfile

PAGES = ('*.md', 'docs/**/*.md', 'src/*.md', 'tests/*.md', 'bench/notes/*.md', 'bench/results/*/*.md')
FENCE = re.compile(r'^(```|~~~).*?^\1', re.M | re.S)
LINK = re.compile(r'\]\(([^)\s]+)\)')
HEADING = re.compile(r'^#{1,6} +(.*?) *#*$', re.M)


def anchors(text):
    seen = {}
    for heading in HEADING.findall(FENCE.sub('', text)):
        plain = re.sub(r'\[([^]]*)\]\([^)]*\)', r'\1', heading).replace('`', '')
        anchor = re.sub(r'[^\w\- ]', '', plain.lower()).replace(' ', '-')
        count = seen[anchor] = seen.get(anchor, -1) + 1
        yield anchor if count == 0 else f'{anchor}-{count}'


def check(root):
    complaints = []
    for page in sorted({p for pattern in PAGES for p in root.glob(pattern)}):
        text = FENCE.sub(lambda m: re.sub(r'[^\n]', ' ', m.group()), page.read_text())
        for link in LINK.finditer(text):
            if re.match(r'[a-z]+:', link.group(1)):
                continue
            path, _, anchor = link.group(1).partition('#')
            target = page.parent / path if path else page
            where = f'{page.relative_to(root)}:{text.count(chr(10), 0, link.start()) + 1}'
            if not target.exists():
                complaints.append(f'{where}: no such file: {link.group(1)}')
            elif anchor and (target.suffix != '.md' or anchor not in anchors(target.read_text())):
                complaints.append(f'{where}: no such heading: {link.group(1)}')
    return complaints


def self_test():
    good = {'README.md': '# A `b`: c\n\n[one](docs/one.md#two-words), [self](#a-b-c), [dir](docs), [far](https://a.b/c)\n'
                         '```\n[not](a-link.md)\n```\n',
            'docs/one.md': '## Two words\n## Two words\n[up](../README.md), [second](#two-words-1)\n'}
    planted = [('README.md', '[gone](docs/two.md)\n', 'no such file: docs/two.md'),
               ('README.md', '[gone](docs/one.md#three)\n', 'no such heading: docs/one.md#three'),
               ('docs/one.md', '[gone](#two-words-2)\n', 'no such heading: #two-words-2'),
               ('docs/one.md', '[gone](../README.md#not)\n', 'no such heading: ../README.md#not')]
    failures = []
    with tempfile.TemporaryDirectory(prefix='lot_links_') as scratch:
        root = pathlib.Path(scratch)
        (root / 'docs').mkdir()

        def write(name, text):
            (root / name).write_text(text)

        for name, text in good.items():
            write(name, text)
        failures += [f'a right tree is refused: {c}' for c in check(root)]
        for name, text, expected in planted:
            write(name, good[name] + text)
            complaints = check(root)
            write(name, good[name])
            if len(complaints) != 1 or expected not in complaints[0]:
                failures.append(f'{name} {text!r}: expected {expected!r}, got {complaints}')
    for failure in failures:
        print(failure)
    print(f'links self-test: {len(planted) + 1} cases, {len(failures)} failed')
    return 1 if failures else 0


def main():
    if sys.argv[1:] == ['--self-test']:
        return self_test()
    complaints = check(pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else
                                    pathlib.Path(__file__).parents[1]).resolve())
    for complaint in complaints:
        print(complaint)
    print(f'links: {len(complaints)} wrong')
    return 1 if complaints else 0


sys.exit(main())
