#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Recordings of LOT are read by @mcap/core, and recordings of @mcap/core by LOT, with the same result.

    judge_test.py RECORDING MODULES

RECORDING is the program tests/mcap/recording.cpp; MODULES the node_modules that scripts/setup makes.
"""

import pathlib
import random
import re
import shutil
import subprocess
import sys
import tempfile

JUDGE = pathlib.Path(__file__).resolve().parent / 'judge.mjs'


class Both:
    """The two programs."""

    def __init__(self, recording, judge):
        self.recording, self.judge = recording, judge

    def ours(self, *words):
        done = subprocess.run([self.recording, *words], text=True, capture_output=True, timeout=120, check=True)
        return done.stdout, done.stderr

    def theirs(self, verb, *paths):
        """What it prints of each path."""
        done = subprocess.run(['node', self.judge, verb, *paths], text=True, capture_output=True, timeout=240, check=True)
        return re.split('^-- .*\n', done.stdout, flags=re.M)[:-1]

    def agree(self, verb, paths, damaged=False):
        """What both print of each path."""
        texts = []
        for path, theirs in zip(paths, self.theirs(verb, *paths), strict=True):
            ours, complaint = self.ours(verb, path)
            if ours != theirs or (complaint and not damaged):
                first = next((p for p in zip(ours.splitlines(), theirs.splitlines()) if p[0] != p[1]), None)
                sys.exit(f'{verb} {path.name}: not the same, {complaint or "no complaint"}\n{str(first)[:2000]}')
            texts.append(ours)
        return texts


def messages(text):
    return sorted(line for line in text.splitlines() if line.startswith('message '))


def written_by_us(both, directory):
    paths = []
    for compression in ('none', 'lz4', 'zstd'):
        for crc in ('crc', 'no'):
            paths.append(directory / f'{compression}_{crc}.mcap')
            both.ours('write', paths[-1], compression, crc)
    for text in both.agree('stream', paths):
        assert len(messages(text)) == 300 and 'end true' in text, text[:1000]
    for text in both.agree('index', paths):
        assert len(messages(text)) == 300, text[:1000]


def cut_and_recovered(both, directory):
    whole = (directory / 'zstd_crc.mcap').read_bytes()
    paths = []
    for size in sorted(random.Random(1).sample(range(500, len(whole)), 12)):
        paths.append(directory / f'cut_{size}.mcap')
        paths[-1].write_bytes(whole[:size])
    cut = both.agree('stream', paths, damaged=True)
    for path in paths:
        both.ours('recover', path)
    for before, text in zip(cut, both.agree('stream', paths)):
        assert messages(before) == messages(text) and 'end true' in text, text[:1000]
    both.agree('index', paths)


def written_by_them(both, directory):
    both.theirs('write', directory)
    indexed = [directory / f'{kind}.mcap' for kind in ('none', 'zstd', 'lz4')]
    others = [directory / f'{kind}.mcap' for kind in ('unchunked', 'unindexed', 'bare', 'no_repeats')]
    both.agree('index', indexed)
    streamed = both.agree('stream', indexed + others)
    for path, text in zip(indexed + others, streamed):
        assert len(messages(text)) == 100 and 'attachment notes' in text, text[:1000]
        # Their reader finds nothing without an index; ours makes one.
        assert messages(both.ours('index', path)[0]) == messages(text), path


def main():
    recording, modules = sys.argv[1:]
    if not (shutil.which('node') and pathlib.Path(modules, '@mcap', 'core').is_dir()):
        print('skipped: no packages of npm here (scripts/setup test)')
        return
    with tempfile.TemporaryDirectory(prefix='lot_judge_') as scratch:
        scratch = pathlib.Path(scratch)
        shutil.copy(JUDGE, scratch)
        (scratch / 'node_modules').symlink_to(pathlib.Path(modules).resolve())
        both = Both(recording, scratch / JUDGE.name)
        for part in (written_by_us, cut_and_recovered, written_by_them):
            part(both, scratch)
            print(f'{part.__name__}: ok')


if __name__ == '__main__':
    main()
