#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Checks each block of code that the pages show: README.md, CONTRIBUTING.md, HACKING.md, docs/*.md and others.

    pages.py [--ros] -- COMPILER...    COMPILER: a command, its flags with the include directories
    pages.py --self-test -- COMPILER...

A block is fenced, and its fence says what it is; or it is indented by four:

    cpp                is compiled. What it takes for granted (a callback, a message type) is in CONTEXT, by
                       its first line. A block that is not there continues the one before it on its page
    c                  is compiled as C11, as the body of a function; C_CONTEXT has what it takes for granted
    python             is read by Python's parser
    sh                 is read by `bash -n`; its scripts, presets, targets, tests, verbs and options exist
    cmake              is configured, with a package lot that has the installed one's targets
    json               is parsed
    text               is no code: a picture, or what a program prints. It is counted and listed
    indented           is cpp if it includes or names lot; a transcript if it begins with "$ ", of which each
                       line with "$ " is sh, and the others are output; else sh

Blocks of lot::ros are compiled with --ros only, which checks nothing else.
"""

import argparse
import ast
import collections
import dataclasses
import functools
import json
import pathlib
import re
import subprocess
import sys
import tempfile

import page_commands

ROOT = pathlib.Path(__file__).resolve().parent.parent
PAGES = ('*.md', 'docs/*.md', 'src/README.md', 'tests/README.md', 'bench/notes/*.md')

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
    'auto tasks = ': (LOT + 'struct Task { int number; }; void work(const Task&);',
                      'void page(lot::ShmEngine& engine) {', '}'),
    'auto server = ': (LOT + 'struct Goal { double x, y; }; struct Path { lot::ShmVector<double> points; };',
                       'void page(lot::ShmEngine& engine) {', '}'),
    'struct Goal {': (LOT + 'template <class T> void drive(const T&) {} void report(const char*);',
                      'void page(lot::ShmEngine& engine) {', '}'),
    'lot::WaitSet set;': (LOT + 'struct Frame { int number; }; void show(const Frame&); void report();'
                          'struct Task { int number; }; void work(const Task&);',
                          'void page(lot::ShmPuller<Frame>& front, lot::ShmQueue<lot::ShmUniquePtr<Task>>& tasks, '
                          'const lot::StopToken& stop) {', '}'),
    'lot::RecorderOptions what;': (LOT + '#include <iostream>\n#include <lot/recorder.hpp>\n#include <lot/recording.hpp>\nvoid drive();',
                                   'void page() {', '}'),
    'struct Track {': ('', '', ''),
    'lot::ros::NodeHandle nh;': ('#include <lot/ros.hpp>' + IMAGE, 'void page() {', '}'),
    'int main(': ('', '', ''),
    'using namespace std::chrono_literals;': ('', '', ''),
}
C_CONTEXT = """
#include <stdio.h>
#include <lot/lot.h>
extern lot_type *uint32_type, *bytes_type, *frame_type;
void page(void);
void page(void) {
"""
# What the pages call the user's own.
OTHERS = {'my_msgs/Cloud.h': """
#include <sensor_msgs/PointCloud2.h>
namespace my_msgs { template <class A> using Cloud_ = sensor_msgs::PointCloud2_<A>; }
"""}


# A package `lot` with the targets of the installed one, and a compiler that need not be tried.
PACKAGE = """
foreach(name lot record ros)
  add_library(lot::${name} INTERFACE IMPORTED)
endforeach()
set(lot_record_FOUND TRUE)
set(lot_ros_FOUND TRUE)
"""
PROJECT = """
cmake_minimum_required(VERSION 3.25)
set(CMAKE_CXX_COMPILER_FORCED TRUE)
project(page LANGUAGES CXX)
"""

KINDS = {'cpp': 'cpp', 'c++': 'cpp', 'c': 'c', 'python': 'python', 'sh': 'sh', 'bash': 'sh', 'cmake': 'cmake', 'json': 'json', 'text': 'text'}


@dataclasses.dataclass(frozen=True)
class Block:
    page: str
    line: int  # of its first line of code
    kind: str  # of KINDS, or transcript; else what the fence says
    code: str

    @property
    def place(self):
        return f'{self.page}:{self.line}'

    @property
    def is_of_ros(self):
        return self.kind == 'cpp' and re.search(r'\blot(::|/)ros\b', self.code) is not None


def kind_of_indented(code):
    if re.search(r'#include <lot|\blot::\w+.*;', code):
        return 'cpp'
    return 'transcript' if code.startswith('$ ') else 'sh'


def blocks(page, text):
    """The blocks of a page."""
    found, lines, i = [], text.split('\n'), 0
    while i < len(lines):
        begin = i
        fence = re.match(r'( *)(```+|~~~+) *([^ `]*)', lines[i])
        if fence:
            margin, marks, language = fence.groups()
            i += 1
            while i < len(lines) and lines[i].strip() != marks:
                i += 1
            code = '\n'.join(line.removeprefix(margin) for line in lines[begin + 1:i])
            found.append(Block(page, begin + 2, KINDS.get(language, f'"{language}"'), code))
        elif lines[i].startswith('    ') and (i == 0 or not lines[i - 1].strip()):
            while i < len(lines) and re.match(r'    |$', lines[i]):
                i += 1
            code = '\n'.join(line[4:] for line in lines[begin:i]).rstrip()
            found.append(Block(page, begin + 1, kind_of_indented(code), code))
            continue
        i += 1
    return found


def context(block):
    """None: the block continues another one."""
    code = [line for line in block.code.split('\n') if not line.startswith('#include')]
    first = next((line for line in code if line.strip()), '')
    return next((CONTEXT[start] for start in CONTEXT if first.startswith(start)), None)


def passages(found):
    """C++ blocks, each with those that continue it; and complaints."""
    result, failures = [], []
    for block in found:
        if context(block) is not None:
            result.append([block])
        elif result and result[-1][0].page == block.page:
            result[-1].append(block)
        else:
            failures.append(f'{block.place}: tests/pages.py has no context for this code, and it continues none')
    return result, failures


def sources(all_passages):
    """Their sources: one for each passage that shows what it includes, one for all the others."""
    together, result = ['', ''], []
    for number, passage in enumerate(all_passages):
        before, opening, closing = context(passage[0])
        shown, included, body = False, '', f'namespace passage_{number} {{\n'
        for line in before.split('\n'):
            if line.startswith('#include'):
                included += line + '\n'
            else:
                body += line + '\n'
        body += opening + '\n'
        for block in passage:
            body += f'#line {block.line} "{block.page}"\n'
            for line in block.code.split('\n'):
                if line.startswith('#include'):
                    shown, included, line = True, included + line + '\n', ''
                body += line + '\n'
        body += closing + '\n}\n'
        if shown:
            result.append(included + body)
        else:
            together[0] += included
            together[1] += body
    return [*result, *([''.join(together)] if together[1] else [])]


def complaints_of_cpp(found, compiler, scratch):
    all_passages, failures = passages(found)
    source = scratch / 'page.cpp'
    for text in sources(all_passages):
        source.write_text(text)
        run = subprocess.run([*compiler, '-fsyntax-only', f'-I{scratch}', str(source)],
                             capture_output=True, text=True, cwd=ROOT)
        if run.returncode != 0:
            failures += ['this does not compile:', *run.stderr.splitlines()[:20]]
    return failures


def complaints_of_c(block, compiler, scratch):
    source = scratch / 'page.c'
    source.write_text(f'{C_CONTEXT}#line {block.line} "{block.page}"\n{block.code}\n}}\n')
    includes = [flag for flag in compiler if flag.startswith('-I')]
    run = subprocess.run([compiler[0], '-x', 'c', '-std=c11', '-pedantic', '-Wall', '-Wextra', *includes,
                          '-fsyntax-only', str(source)], capture_output=True, text=True, cwd=ROOT)
    return [line for line in run.stderr.splitlines() if re.search(r': (fatal )?(error|warning): ', line)]


def complaints_of_python(block):
    try:
        ast.parse(block.code)
    except SyntaxError as error:
        return [f'{block.page}:{block.line + (error.lineno or 1) - 1}: Python: {error.msg}']
    return []


def complaints_of_cmake(block, scratch):
    project = pathlib.Path(tempfile.mkdtemp(dir=scratch))
    (project / 'lotConfig.cmake').write_text(PACKAGE)
    (project / 'CMakeLists.txt').write_text(PROJECT + block.code + '\n')
    for name in re.findall(r'[\w/]+\.cpp', block.code):
        (project / name).parent.mkdir(parents=True, exist_ok=True)
        (project / name).touch()
    run = subprocess.run(['cmake', '-S', project, '-B', project / 'build', f'-Dlot_DIR={project}',
                          f'-DFETCHCONTENT_SOURCE_DIR_LOT={ROOT}', '-DLOT_BUILD_ROS=OFF'],
                         capture_output=True, text=True)
    if run.returncode == 0:
        return []
    return [f'{block.place}: CMake does not configure this', *run.stderr.splitlines()[:20]]


@functools.cache
def tree():
    return page_commands.Tree(ROOT)


def complaints(block, compiler, scratch):
    """What is wrong with a block that is not C++."""
    if block.kind == 'text':
        return []
    if block.kind == 'cmake':
        return complaints_of_cmake(block, scratch)
    if block.kind == 'c':
        return complaints_of_c(block, compiler, scratch)
    if block.kind == 'python':
        return complaints_of_python(block)
    if block.kind == 'json':
        try:
            json.loads(block.code)
        except ValueError as error:
            return [f'{block.place}: JSON: {error}']
        return []
    if block.kind not in ('sh', 'transcript'):
        return [f'{block.place}: a fence says cpp, c, python, sh, cmake, json or text, and not {block.kind}']
    code = block.code
    if block.kind == 'transcript':
        code = '\n'.join(line[2:] if line.startswith('$ ') else '' for line in code.split('\n'))
    return [f'{block.page}:{block.line + line}: {text}'
            for line, text in page_commands.complaints(tree(), code)]


MISTAKES = """text
    lot::no block;
words
```cpp
lot::WaitSet set;
set.run();
```

    lot::WaitSet others;
    set.walk();

    others.stop();
more

```sh
scripts/test --stage docs --stage nothing
scripts/setup test elsewhere && scripts/gone
cmake --preset relase && cmake --build --preset release --target no_such_target
ctest --preset release -R '^no_such_test$'
build/release/tests/no_such_program $(no_such_one --flag) | build/release/tests/ring_test -tc='a*'
LOT_SEGMENTS=a lot look --loud; launch; build/relase/tests/ring_test
scripts/test --stages # --list
tests/tidy.py --build build/clang src/gone.cpp
roslaunch lot relay.launch on:=/a
```
```sh
if true
```

    $ lot ls --interval 20
    lot no verb
    $ lot ls --intervall 20

```json
{"a": 1,}
```
```json
{"a": 1}
```
```cmake
find_package(lot REQUIRED COMPONENTS ros)
add_executable(app src/main.cpp)
target_link_libraries(app lot::ros)
```
```cmake
find_package(lot REQUIRED)
add_executable(app src/main.cpp)
target_link_libraries(app lot::log)
```
```text
anything
```
```
anything
```
```c
lot_engine* engine = NULL;
lot_engine_shut(engine);
```
```python
import lot
def f(:
```
"""
EXPECTED = [('page.md:10', "no member named .walk."), ('page.md:16', 'stage: nothing'),
            ('page.md:17', 'group: elsewhere'), ('page.md:17', 'file: scripts/gone'),
            ('page.md:18', 'preset: relase'), ('page.md:18', 'target: no_such_target'),
            ('page.md:19', 'test: .no_such_test'), ('page.md:20', 'program: .*no_such_program'),
            ('page.md:20', 'command: no_such_one'), ('page.md:21', 'variable: LOT_SEGMENTS'),
            ('page.md:21', 'verb: look'), ('page.md:21', 'option: --loud'), ('page.md:21', 'command: launch'),
            ('page.md:21', 'preset: relase'),
            ('page.md:22', 'option: --stages'), ('page.md:23', 'file: src/gone.cpp'),
            ('page.md:24', 'relay.launch has no argument on'), ('page.md:27', 'bash does not read'),
            ('page.md:32', 'option: --intervall'), ('page.md:35', 'JSON'),
            ('page.md:46', 'CMake does not configure'), ('page.md:54', 'a fence says'), ('page.md:58', 'lot_engine_shut'), ('page.md:62', 'Python')]


def self_test(compiler, scratch):
    failures = []
    found = blocks('page.md', MISTAKES)
    cpp = [b for b in found if b.kind == 'cpp']
    said = complaints_of_cpp(cpp, compiler, scratch)
    if not any('no member named' in line for line in said):
        failures.append(f'a wrong block compiles: {said}')
    said = [line for line in said if ' error: ' in line]
    for block in found:
        if block.kind != 'cpp':
            said += [line for line in complaints(block, compiler, scratch) if line.startswith('page.md')]
    for place, text in EXPECTED:
        if not any(re.match(f'{place}:.*{text}', line) for line in said):
            failures.append(f'{place}: not found: {text}')
    if len(said) != len(EXPECTED):
        failures.append(f'{len(said)} complaints, and not {len(EXPECTED)}:')
        failures += said
    said = complaints_of_cpp(blocks('a.md', '```cpp\nset.stop();\n```'), compiler, scratch)
    if len(said) != 1 or 'no context' not in said[0]:
        failures.append(f'a.md: a block that continues none: {said}')
    return failures


def check(of_ros, compiler, scratch):
    """Complaints, how many blocks of each kind, and the places of those that are not code."""
    found = [block for pattern in PAGES for page in sorted(ROOT.glob(pattern))
             for block in blocks(str(page.relative_to(ROOT)), page.read_text())]
    cpp = [block for block in found if block.kind == 'cpp' and block.is_of_ros == of_ros]
    others = [] if of_ros else [block for block in found if block.kind != 'cpp']
    failures = complaints_of_cpp(cpp, compiler, scratch)
    for block in others:
        failures += complaints(block, compiler, scratch)
    return (failures, collections.Counter(block.kind for block in [*cpp, *others]),
            [block.place for block in others if block.kind == 'text'])


def main():
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--ros', action='store_true', help='check the C++ of lot::ros, and nothing else')
    parser.add_argument('--self-test', action='store_true', help='plant mistakes, and see that each is found')
    parser.add_argument('compiler', nargs='+')
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix='lot_pages_') as directory:
        scratch = pathlib.Path(directory)
        for name, text in OTHERS.items():
            (scratch / name).parent.mkdir(exist_ok=True)
            (scratch / name).write_text(text)
        if options.self_test:
            failures, counts, not_code = self_test(options.compiler, scratch), {'self-test': 1}, []
        else:
            failures, counts, not_code = check(options.ros, options.compiler, scratch)
    if not counts.get('cpp') and not options.self_test:
        failures.append('no code')
    print('\n'.join(failures))
    if not_code:
        print(f'no code (text): {", ".join(not_code)}')
    summary = ', '.join(f'{count} {kind}' for kind, count in sorted(counts.items()))
    print(f'pages: {summary}: {"FAILED" if failures else "all well"}')
    return 1 if failures else 0


if __name__ == '__main__':
    sys.exit(main())
