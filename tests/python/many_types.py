#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""200 message types by chance, the same in each run: as structs of C++, for many.cpp, and as trees, for many_test.py.

    many_types.py HEADER      writes the header
"""

import functools
import random
import sys

COUNT = 200
NUMBERS = {'bool': ('BOOL', 1), 'char': ('CHAR', 1),
           **{f'std::int{8 * size}_t': ('INT', size) for size in (1, 2, 4, 8)},
           **{f'std::uint{8 * size}_t': ('UINT', size) for size in (1, 2, 4, 8)},
           'float': ('FLOAT', 4), 'double': ('FLOAT', 8)}


class Maker:
    """A tree: ('number', name), ('string',), ('array', tree, count), ('vector', tree), ('struct', n), ('ref', n)."""

    def __init__(self):
        self.chance = random.Random(28)
        self.structs = []  # lists of trees, one for each field
        while len(self.structs) < COUNT:
            self.structs.append([self.tree(3) for _ in range(self.chance.randint(1, 8))])

    def earlier(self, kind):
        """Messages stay small, and types do not lie in each other deeper than a description tells (docs/layout.md)."""
        known = [n for n in range(len(self.structs)) if self.weight(('struct', n)) < 60 and self.levels(('struct', n)) <= 6]
        return (kind, self.chance.choice(known)) if known else ('string',)

    @functools.cache
    def weight(self, tree):
        """How many values a message has, with two elements in each vector."""
        kind = tree[0]
        if kind in ('array', 'vector'):
            return self.weight(tree[1]) * (tree[2] if kind == 'array' else 2)
        if kind in ('struct', 'ref'):
            return sum(self.weight(field) for field in self.structs[tree[1]])
        return 1

    @functools.cache
    def levels(self, tree):
        """How deep types lie in each other."""
        if tree[0] in ('array', 'vector'):
            return 1 + self.levels(tree[1])
        if tree[0] in ('struct', 'ref'):
            return (2 if tree[0] == 'ref' else 1) + max(self.levels(field) for field in self.structs[tree[1]])
        return 1

    def tree(self, depth, may_be_bool=True):
        kind = self.chance.choice(('number', 'number', 'number', 'string', 'array', 'vector', 'vector', 'struct', 'ref') if depth
                                  else ('number', 'string'))
        if kind == 'number':
            return kind, self.chance.choice([name for name in NUMBERS if may_be_bool or name != 'bool'])
        if kind == 'array':
            return kind, self.tree(depth - 1), self.chance.randint(1, 4)
        if kind == 'vector':
            return kind, self.tree(depth - 1, may_be_bool=False)  # a vector of bool is none of bools
        return self.earlier(kind) if kind in ('struct', 'ref') else (kind,)


def spelt(tree):
    """As C++ spells it."""
    kind = tree[0]
    return {'number': lambda: tree[1], 'string': lambda: 'lot::ShmString',
            'array': lambda: f'std::array<{spelt(tree[1])}, {tree[2]}>', 'vector': lambda: f'lot::ShmVector<{spelt(tree[1])}>',
            'struct': lambda: f'T{tree[1]}', 'ref': lambda: f'lot::ShmRef<const T{tree[1]}>'}[kind]()


def header():
    maker = Maker()
    lines = ['// Made by many_types.py.', '#pragma once', '#include <array>', '#include <cstdint>', '#include <lot/lot.hpp>',
             'namespace many {']
    for number, fields in enumerate(maker.structs):
        members = ' '.join(f'{spelt(tree)} f{place}{{}};' for place, tree in enumerate(fields))
        lines.append(f'struct T{number} {{ {members} }};')
    lines += ['template <class F>', 'void each(F&& call) {',
              *(f'  call.template operator()<T{number}>();' for number in range(COUNT)), '}', '}  // namespace many', '']
    return '\n'.join(lines)


if __name__ == '__main__':
    with open(sys.argv[1], 'w') as file:
        file.write(header())
