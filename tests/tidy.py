#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Runs clang-tidy with the checks of .clang-tidy on the library, the command and the public headers.

    tidy.py --build DIR [FILE...]    DIR: a build tree of clang that is configured; it need not be built
    tidy.py --build DIR --self-test  plant a mistake in a source and in a header, see both found

Without FILE: all of src/ that the tree compiles, and include/lot/*.hpp as C++17, which users include.
What the tree compiles together is looked at together, which takes a fifth of the time. What it does not
compile is left out: lot::ros, if it was configured without it.
"""

import argparse
import concurrent.futures
import json
import os
import pathlib
import re
import shlex
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parent.parent
TIDY = 'clang-tidy-19'
A_SOURCE = ROOT / 'src/transport/pusher.cpp'  # whose flags the public headers are compiled with, too

PLANTED = """#include <string>
{}inline bool planted(std::string text) {{
  std::string other = std::move(text);
  return text.empty() && other.empty();
}}
"""


def parts(file):
    """The sources that a file compiles: itself, or those that CMake has put together in it."""
    if file.parent.name != 'Unity':
        return [file]
    return [pathlib.Path(name) for name in re.findall(r'^#include "(.*)"', file.read_text(), re.MULTILINE)]


def flags_by_file(build):
    """{file: its flags}: of the first target that compiles it, without what is made of it."""
    flags = {}
    for entry in json.loads((build / 'compile_commands.json').read_text()):
        words = shlex.split(entry['command'])[1:]
        words = words[:words.index('-o')] + words[words.index('-c') + 2:]
        flags.setdefault(pathlib.Path(entry['file']).resolve(), words)
    return flags


def flags_by_source(flags):
    """{source: its flags}"""
    return {source: words for file, words in flags.items() for source in parts(file)}


def tidy(file, flags, *options):
    """(what it has found, whether that is nothing)"""
    run = subprocess.run([TIDY, '--quiet', f'--config-file={ROOT / ".clang-tidy"}', *options, str(file), '--', *flags],
                         cwd=ROOT, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    found = run.stdout.replace(f'{ROOT}/', '')
    if run.returncode != 0 and not found:
        found = run.stderr
    return found, run.returncode == 0


def public(flags, scratch):
    """A source that includes all public headers, and its flags."""
    headers = sorted(h.relative_to(ROOT / 'include') for h in ROOT.glob('include/lot/*.hpp'))
    file = pathlib.Path(scratch) / 'public.cpp'
    file.write_text(''.join(f'#include <{h}>\n' for h in headers if h.name != 'ros.hpp'))
    return file, ['-std=c++17' if f.startswith('-std=') else f for f in flags_by_source(flags)[A_SOURCE]]


def check(flags, files):
    """Whether nothing was found. The largest first, so that no core waits for the last one."""
    with tempfile.TemporaryDirectory() as scratch:
        by_source = flags_by_source(flags)
        jobs = {file: by_source[file] for file in files}
        if not jobs:
            jobs = {file: words for file, words in flags.items() if ROOT / 'src' in parts(file)[0].parents}
            file, words = public(flags, scratch)
            jobs[file] = words
        order = sorted(jobs, key=lambda file: sum(part.stat().st_size for part in parts(file)), reverse=True)
        seen = set()
        with concurrent.futures.ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
            results = list(pool.map(lambda file: tidy(file, jobs[file]), order))
        for found, _ in results:
            if found not in seen:
                print(found, end='')
            seen.add(found)
        wrong = sum(not is_well for _, is_well in results)
    count = sum(len(parts(file)) for file in order)
    print(f'tidy: {count} files in {len(order)}, {wrong} with complaints')
    return wrong == 0


def self_test(flags):
    failures = []
    with tempfile.TemporaryDirectory() as scratch:
        bad = pathlib.Path(scratch) / 'src'
        bad.mkdir()
        (bad / 'bad.hpp').write_text(PLANTED.format('#include <utility>\n'))
        (bad / 'bad.cpp').write_text(PLANTED.format('#include <utility>\n'))
        (bad / 'includes_bad.cpp').write_text('#include "bad.hpp"\n')
        (bad / 'together.cpp').write_text('#include "good.cpp"\n#include "bad.cpp"\n')
        (bad / 'good.cpp').write_text('inline bool planted(bool text) { return !text; }\n')
        for name in 'bad.cpp', 'includes_bad.cpp', 'together.cpp', 'good.cpp':
            found, is_well = tidy(bad / name, flags_by_source(flags)[A_SOURCE])
            if name == 'good.cpp' and not is_well:
                failures.append(f'nothing is wrong with {name}, and yet: {found}')
            if name != 'good.cpp' and (is_well or 'bugprone-use-after-move' not in found):
                failures.append(f'a use after a move was not found: {name}: {found}')
    print('\n'.join(failures + [f'tidy self-test: 4 cases, {len(failures)} failed']))
    return not failures


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--build', type=pathlib.Path, required=True)
    parser.add_argument('--self-test', action='store_true')
    parser.add_argument('files', nargs='*', type=pathlib.Path)
    options = parser.parse_args()
    flags = flags_by_file(options.build)
    files = [file.resolve() for file in options.files]
    for file in files:
        if file not in flags_by_source(flags):
            parser.error(f'{options.build} does not compile {file}')
    is_well = self_test(flags) if options.self_test else check(flags, files)
    return 0 if is_well else 1


if __name__ == '__main__':
    sys.exit(main())
