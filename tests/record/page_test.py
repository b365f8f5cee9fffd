#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Runs what docs/record-and-play.md shows of an independent reader, and compares what it prints.

    page_test.py REPLAY MODULES

REPLAY is the program examples/replay.cpp; MODULES the node_modules that scripts/setup makes.
"""

import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[2]


def shown():
    """The commands, and what the last one prints."""
    page = (ROOT / 'docs' / 'record-and-play.md').read_text()
    section = re.search(r'^## An independent reader\n(.*?)^## ', page, re.M | re.S).group(1)
    commands = [line.split('#')[0].split() for line in re.findall(r'^    (.*)', section, re.M)]
    commands = [command for command in commands if command[0] != 'npm']  # in a project of the reader
    return commands, re.search(r'^```text\n(.*?)^```', section, re.M | re.S).group(1)


def main():
    replay, modules = sys.argv[1:]
    if not (shutil.which('node') and pathlib.Path(modules, '@mcap', 'core').is_dir()):
        print('skipped: no packages of npm here (scripts/setup test)')
        return
    commands, expected = shown()
    programs = {'build/release/examples/replay': replay}
    with tempfile.TemporaryDirectory(prefix='lot_page_') as scratch:
        files = {'drive.mcap': f'{scratch}/drive.mcap'}
        output = ''
        for command in commands:
            if command[0] == 'scripts/setup':
                continue
            words = [files.get(word, programs.get(word, word)) for word in command]
            done = subprocess.run(words, cwd=ROOT, text=True, capture_output=True, timeout=100, check=False, env=os.environ)
            if done.returncode != 0:
                sys.exit(f'{" ".join(words)}: {done.returncode}\n{done.stdout}{done.stderr}')
            output = done.stdout
    if output != expected:
        sys.exit(f'docs/record-and-play.md shows\n{expected}and it is\n{output}')
    print(f'{len(commands)} commands: ok')


if __name__ == '__main__':
    main()
