#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Compiles the C++ that README.md and the pages of docs/ show.

    pages.py [--ros] -- COMPILER...    COMPILER: a command, its flags with the include directories
    pages.py --self-test -- COMPILER...

A block is fenced as cpp, or indented by four and names lot. What it takes for granted (a callback, a
message type) is in CONTEXT, by the block's first line. Blocks of lot::ros are compiled with --ros
only, all others without.
"""

import argparse
import dataclasses
import pathlib
import re
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parent.parent

# By a block's first line of code: what stands before the block, and around it.
LOT = """
#include <chrono>
#include <cstdint>
#include <lot/lot.hpp>
using namespace std::chrono_literals;
"""
IMAGE = """
#include <sensor_msgs/Image.h>
void callback(const lot::ShmSharedPtr<const lot::ros::Message<sensor_msgs::Image_>>&);
"""
CONTEXT = {
    'struct Frame {': (LOT + 'template <class T> void use(const T&);',
                       'void page() {', '}'),
    'lot::QueueOptions until_done;': (
        LOT + 'struct Task { int number; }; void work(const Task&);',
        'void page(lot::ShmEngine& engine) {', '}'),
    'auto tasks = ': (LOT + 'struct Task { int number; };',
                      'void page(lot::ShmEngine& engine) {', '}'),
    'lot::WaitSet set;': (LOT + 'struct Frame { int number; }; void show(const Frame&); void report();',
                          'void page(lot::ShmPuller<Frame>& front) {', '}'),
    'struct Track {': ('', '', ''),
    'lot::ros::NodeHandle nh;': ('#include <lot/ros.hpp>' + IMAGE, 'void page() {', '}'),
    'int main(': ('', '', ''),
}
# What the pages call the user's own.
OTHERS = {'my_msgs/Cloud.h': """
#include <sensor_msgs/PointCloud2.h>
namespace my_msgs { template <class A> using Cloud_ = sensor_msgs::PointCloud2_<A>; }
"""}


@dataclasses.dataclass(frozen=True)
class Block:
    place: str  # page:line
    code: str

    @property
    def is_of_ros(self):
        return re.search(r'\blot(::|/)ros\b', self.code) is not None


def blocks(page, text):
    """The C++ blocks of a page."""
    found, lines, i = [], text.split('\n'), 0
    while i < len(lines):
        begin = i
        if lines[i].startswith('```'):
            i += 1
            while i < len(lines) and lines[i] != '```':
                i += 1
            if re.match(r'```\s*(cpp|c\+\+)\b', lines[begin] + ' '):
                found.append(Block(f'{page}:{begin + 2}', '\n'.join(lines[begin + 1:i])))
        elif lines[i].startswith('    '):
            while i < len(lines) and re.match(r'    |$', lines[i]):
                i += 1
            code = '\n'.join(line[4:] for line in lines[begin:i])
            if re.search(r'#include <lot|\blot::\w+.*;', code):
                found.append(Block(f'{page}:{begin + 1}', code))
            continue
        i += 1
    return found


def translation_unit(block):
    """None: nothing is known of what the block takes for granted."""
    lines = block.code.split('\n')
    includes = [line for line in lines if line.startswith('#include')]
    code = [line for line in lines if not line.startswith('#include')]
    first = next((line for line in code if line.strip()), '')
    for start, (before, opening, closing) in CONTEXT.items():
        if first.startswith(start):
            return '\n'.join([*includes, before, opening, *code, closing, ''])
    return None


def complaints(block, compiler, scratch):
    unit = translation_unit(block)
    if unit is None:
        return [f'{block.place}: tests/pages.py has no context for this code']
    source = scratch / 'page.cpp'
    source.write_text(unit)
    run = subprocess.run([*compiler, '-fsyntax-only', f'-I{scratch}', str(source)],
                         capture_output=True, text=True)
    if run.returncode == 0:
        return []
    return [f'{block.place}: does not compile', *run.stderr.splitlines()[:20]]


def self_test(compiler, scratch):
    page = """text
    lot::no such line
    words
```cpp
lot::WaitSet set;
set.run();
```
    lot::WaitSet set;
    set.walk();

    set.stop();
more

    lot::unknown();
"""
    expected = ['page.md:5', 'page.md:8', 'page.md:14']
    failures = []
    found = blocks('page.md', page)
    if [b.place for b in found] != expected:
        failures.append(f'blocks at {[b.place for b in found]}, and not at {expected}')
    for block, text in zip(found, ['', 'walk', 'no context']):
        said = '\n'.join(complaints(block, compiler, scratch))
        if text not in said or (said and not text):
            failures.append(f'{block.place}: expected "{text}", got "{said}"')
    return failures


def main():
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--ros', action='store_true')
    parser.add_argument('--self-test', action='store_true')
    parser.add_argument('compiler', nargs='+')
    options = parser.parse_args()
    failures, count = [], 0
    with tempfile.TemporaryDirectory() as directory:
        scratch = pathlib.Path(directory)
        for name, text in OTHERS.items():
            (scratch / name).parent.mkdir(exist_ok=True)
            (scratch / name).write_text(text)
        if options.self_test:
            failures, count = self_test(options.compiler, scratch), 1
        else:
            for page in [ROOT / 'README.md', *sorted((ROOT / 'docs').glob('*.md'))]:
                for block in blocks(page.relative_to(ROOT), page.read_text()):
                    if block.is_of_ros == options.ros:
                        failures += complaints(block, options.compiler, scratch)
                        count += 1
    if count == 0:
        failures.append('no code')
    print('\n'.join(failures))
    print(f'summary: {count} blocks of code, {"FAILED" if failures else "all compile"}')
    return 1 if failures else 0


if __name__ == '__main__':
    sys.exit(main())
