#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""C++ and Python meet on 200 types by chance, both ways: equal hashes, and messages that come back as they went.

    many_test.py PACKAGES MANY [unittest's arguments]    MANY: many.cpp's program
"""

import os
import pathlib
import random
import subprocess
import sys
import types
import unittest

sys.path[:0] = [sys.argv.pop(1), str(pathlib.Path(__file__).resolve().parent)]
MANY = sys.argv.pop(1)
os.environ.pop('LD_PRELOAD', None)  # of a sanitizer: the program in C++ has its own

import lot  # noqa: E402
import many_types  # noqa: E402
import numpy as np  # noqa: E402


def made(maker):
    """The types of Python, by number."""
    known = []

    def of(tree):
        kind = tree[0]
        if kind == 'number':
            name, size = many_types.NUMBERS[tree[1]]
            return lot.Type.number(getattr(lot.Kind, name), size)
        if kind == 'string':
            return lot.string
        if kind == 'array':
            return lot.array[of(tree[1]), tree[2]]
        if kind == 'vector':
            return lot.vector[of(tree[1])]
        return known[tree[1]] if kind == 'struct' else lot.ref[known[tree[1]]]
    for number, fields in enumerate(maker.structs):
        known.append(lot.Type.structure(f'many::T{number}', [(f'f{place}', of(tree)) for place, tree in enumerate(fields)]))
    return known


class Filler:
    """Fills messages by chance."""

    def __init__(self, engine, maker, known, chance):
        self.engine, self.maker, self.known, self.chance = engine, maker, known, chance

    def number(self, name):
        kind, size = many_types.NUMBERS[name]
        if kind == 'BOOL':
            return self.chance.random() < 0.5
        if kind == 'CHAR':
            return chr(self.chance.randint(32, 126))
        if kind == 'FLOAT':
            return self.chance.randint(-1000, 1000) / 8
        bits = 8 * size
        return self.chance.randint(0, 2**bits - 1) - (2**(bits - 1) if kind == 'INT' else 0)

    def fill(self, part, number):
        for place, tree in enumerate(self.maker.structs[number]):
            self.put(part, f'f{place}', tree)

    def put(self, part, key, tree):
        kind = tree[0]
        if kind == 'number':
            part[key] = self.number(tree[1])
        elif kind == 'string':
            part[key] = ''.join(self.chance.choices('ab\u00e9 ', k=self.chance.choice((0, 3, 60))))
        elif kind == 'struct':
            self.fill(part[key], tree[1])
        elif kind == 'ref':
            if self.chance.random() < 0.8:
                target = self.engine.make(self.known[tree[1]])
                self.fill(target, tree[1])
                part[key] = lot.share(target)
        else:
            items = part[key]
            if kind == 'vector':
                items.resize(self.chance.randint(0, 2))
            for place in range(len(items)):
                self.put(items, place, tree[1])


def same(one, other):
    if isinstance(one, types.SimpleNamespace):
        return vars(one).keys() == vars(other).keys() and all(same(its, vars(other)[name]) for name, its in vars(one).items())
    if isinstance(one, list):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and np.array_equal(one, other)
    return one == other


class Many(unittest.TestCase):
    def test_types_are_those_of_cpp(self):
        lines = subprocess.run([MANY, 'types'], check=True, capture_output=True, text=True).stdout.splitlines()
        for line, its in zip(lines, made(many_types.Maker()), strict=True):
            name, *numbers = line.split()
            self.assertEqual([its.size, its.alignment, its.layout_hash, its.names_hash], [int(number) for number in numbers], name)
            self.assertEqual(its.name, name)

    def test_messages_come_back_as_they_went(self):
        seed = random.SystemRandom().getrandbits(32)
        engine, maker = lot.Engine(), many_types.Maker()
        known = made(maker)
        filler = Filler(engine, maker, known, random.Random(seed))
        with subprocess.Popen([MANY, 'echo']) as echo:
            self.addCleanup(echo.kill)
            try:
                for number, its in enumerate(known):
                    self.send(engine, filler, number, its, f'seed {seed}, type {number}')
            except BaseException:
                echo.kill()  # it would wait for the next one
                raise
        self.assertEqual(echo.returncode, 0)

    def send(self, engine, filler, number, its, name):
        back, pub = engine.subscribe(f'/out/{number}', its), engine.advertise(f'/in/{number}', its)
        message = pub.loan()
        filler.fill(message, number)
        sent = message.copy()
        self.assertTrue(pub.wait_for_readers(1, 60), name)
        self.assertTrue(pub.push(message), name)
        came = back.pull(60)
        self.assertIsNotNone(came, name)
        self.assertTrue(same(sent, came.copy()), f'{name}: {sent} {came}')


if __name__ == '__main__':
    unittest.main()
