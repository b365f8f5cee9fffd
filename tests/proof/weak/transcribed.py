#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Holds private_model.cpp and the code whose steps it has against each other.

    transcribed.py              checks the tree in which this file lies
    transcribed.py --self-test  plants mistakes, and sees that each is found

A function of private_model.cpp that has the steps of another one says so: /// @ FILE FUNCTION. Both
must have the same atomic steps, with the same orders, one behind the other.
"""

import pathlib
import re
import sys

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parents[2]
MODEL = HERE / 'private_model.cpp'

sys.path.insert(0, str(HERE.parent / 'spin'))
from run import closing, functions, squeeze, without_comments  # noqa: E402

COPIED = re.compile(r'/// @ (\S+) (\w+)\n')
STEP = re.compile(r'(\w+)\s*(?:\.|->)\s*((?:load|store|exchange|fetch_\w+|compare_exchange_\w+)\s*\()')
BARRIER = re.compile(r'\bProcessBarrier::pass\s*\(')
# How the copy says what it has no name for.
SPELLINGS = (('nullptr_', 'nullptr'), ('Build::', ''))


def steps(text):
    """The atomic steps of a function, in order: which word, and what is done to it."""
    found = [(m.start(), m.group(1) + '.' + text[m.start(2):closing(text, m.end() - 1)])
             for m in STEP.finditer(text)]
    found += [(m.start(), 'barrier') for m in BARRIER.finditer(text)]
    for _, step in sorted(found):
        step = squeeze(step)
        for copy, code in SPELLINGS:
            step = step.replace(copy, code)
        yield step


def complaints(model, read):
    """`read(file)`: the text of a file of the tree, or None."""
    places = list(COPIED.finditer(model))
    if not places:
        yield 'private_model.cpp copies nothing'
    for place in places:
        file, name = place.groups()
        body = model[place.end():closing(model, model.index('{', place.end()))]
        copy = list(steps(without_comments(body)))
        code = read(file)
        if code is None:
            yield f'{file}: there is no such file'
            continue
        bodies = [list(steps(text)) for text in functions(without_comments(code), name)]
        if not bodies:
            yield f'{file} has no function {name}'
        elif copy not in bodies:
            yield f'{file} {name}: its steps are {bodies}, those of the copy {copy}'


def read_tree(file):
    path = ROOT / file
    return path.read_text() if path.is_file() else None


def self_test():
    model = MODEL.read_text()
    good = list(complaints(model, read_tree))
    failures = [f'a right tree is refused: {c}' for c in good]
    planted = [  # in a file of the code: what, by what
        ('src/transport/biased_lock.hpp', 'busy_.store(true, std::memory_order_relaxed);', ''),
        ('src/transport/biased_lock.cpp', 'ProcessBarrier::pass();', ''),
        ('src/transport/biased_lock.cpp', 'shared_.store(true, std::memory_order_seq_cst)',
         'shared_.store(true, std::memory_order_release)'),
        ('src/transport/rouser.cpp', 'place.exchange(nullptr', 'place.exchange(word'),
        ('include/lot/detail/arena.hpp', 'void own_spare()', 'void own()'),
    ]
    for file, old, new in planted:
        text = read_tree(file)
        if old not in text:
            failures.append(f'{file} does not say {old}')
            continue
        spoilt = text.replace(old, new, 1)
        found = list(complaints(model, lambda f, s=spoilt, p=file: s if f == p else read_tree(f)))
        if not any(file in c for c in found):
            failures.append(f'{file}: {old!r} is not missed')
    print(*failures, f'summary: transcribed self-test: {len(planted)} mistakes, {len(failures)} failed',
          sep='\n')
    return 1 if failures else 0


def main():
    if sys.argv[1:] == ['--self-test']:
        return self_test()
    if sys.argv[1:]:
        print(__doc__, file=sys.stderr)
        return 2
    wrong = list(complaints(MODEL.read_text(), read_tree))
    print(*wrong, f'summary: transcribed: {len(COPIED.findall(MODEL.read_text()))} functions, {len(wrong)} wrong',
          sep='\n')
    return 1 if wrong else 0


if __name__ == '__main__':
    sys.exit(main())
