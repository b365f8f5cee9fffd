#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Checks that `lot_gateway --help` and its man page name the same options, and that mandoc likes the page.

    words_test.py GATEWAY               check the page of this tree against the program GATEWAY
    words_test.py GATEWAY --self-test   take each option away from the page, and see that this is found
"""

import pathlib
import re
import subprocess
import sys

PAGE = pathlib.Path(__file__).resolve().parents[2] / 'docs/man/lot_gateway.1'


def options_of(program):
    text = subprocess.run([program, '--help'], capture_output=True, text=True, check=True, timeout=60).stdout
    return set(re.findall(r'^ +(?:-\w,)?(--[\w-]+)', text, re.M))


def complaints(options, page):
    section = page.partition('.Sh OPTIONS')[2].partition('.Sh ')[0]
    explained = {f'--{name}' for name in re.findall(r'^\.It (?:Fl \w , )?Fl Fl ([\w-]+)', section, re.M)}
    yield from (f'{name} is missing' for name in sorted(options - explained))
    yield from (f'{name} is none' for name in sorted(explained - options))
    lint = subprocess.run(['mandoc', '-T', 'lint', '-W', 'warning'], input=page, capture_output=True, text=True,
                          check=False, timeout=60)
    yield from lint.stdout.splitlines()


def main(program, *mode):
    options, page = options_of(program), PAGE.read_text()
    if mode:
        missed = [name for name in sorted(options)
                  if not list(complaints(options, re.sub(rf'(\.It .*Fl Fl) {name[2:]}\b', r'\1 other', page)))]
        print(f'{len(options)} options taken away, not found: {missed}')
        return bool(missed) or len(options) < 8
    found = list(complaints(options, page))
    print('\n'.join([f'lot_gateway.1: {line}' for line in found] or [f'{len(options)} options, all explained']))
    return bool(found)


if __name__ == '__main__':
    sys.exit(main(*sys.argv[1:]))
