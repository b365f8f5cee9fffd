#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Runs what docs/two-hosts.md shows, between two hosts, and compares what it prints of ROS 2.

    page_test.py BUILD MODULES

BUILD is the tree that has the programs; MODULES the node_modules that scripts/setup makes. The hosts are network
namespaces with a cable between them; the node of ROS 2 runs on host B.
"""

import pathlib
import re
import shlex
import shutil
import sys
import time

import hosts

ROOT = pathlib.Path(__file__).resolve().parents[2]
PAGE = (ROOT / 'docs' / 'two-hosts.md').read_text(encoding='utf-8')
BUILD, MODULES = sys.argv[1:]


def section(title):
    return re.search(rf'^## {title}\n(.*?)^## ', PAGE, re.M | re.S).group(1)


def commands(title):
    """Those of a section, here: pairs of words, and whether it goes on beside the next one."""
    plain = re.sub(r'^```.*?^```', '', section(title), flags=re.M | re.S)
    for line in re.findall(r'^    (\S.*)', plain, re.M):
        words = shlex.split(line, comments=True)
        if words[0].startswith('scripts/setup'):
            continue
        goes_on = words[-1] == '&'
        words = words[:-1] if goes_on else words
        words = [hosts.CABLE if word == 'eth0' else word for word in words]
        words = [str(ROOT / word) if word.startswith('examples/') else word for word in words]
        yield [re.sub('^build/release/', BUILD + '/', word) for word in words], goes_on


def run(both, host, title):
    """Runs them, and returns what the last one says."""
    said = ''
    for words, goes_on in commands(title):
        program = both.run(host, *words)
        if not goes_on:
            program.finish()
            said = program.said()
    return said


def main():
    try:
        both = hosts.Hosts()
    except hosts.Refused:
        print(hosts.skipped())
        return
    with both:
        run(both, 0, 'Host A')
        seen = run(both, 1, 'Host B')
        if len(re.findall(r'^\d+$', seen, re.M)) != 2:
            sys.exit(f'Host B sees {seen!r}')
        if not (shutil.which('node') and pathlib.Path(MODULES, '@foxglove', 'ros2').is_dir()):
            print('skipped: no packages of npm here (scripts/setup test)')
            return
        expected = re.search(r'^```text\n(.*?)^```', section('ROS 2'), re.M | re.S).group(1)
        until = time.monotonic() + hosts.PATIENCE_S
        listed = ''
        while listed != expected and time.monotonic() < until:
            listed = run(both, 1, 'ROS 2')
        if listed != expected:
            sys.exit(f'docs/two-hosts.md shows\n{expected}and it is\n{listed}')
    print('docs/two-hosts.md: ok')


if __name__ == '__main__':
    main()
