#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Which branches of src/ and include/ the tests take, by llvm-cov.

    tests/proof/coverage/coverage.py --build build/coverage    after its tests have run
    tests/proof/coverage/coverage.py --missing REGEX           and print what is not taken in these files
    tests/proof/coverage/coverage.py --self-test

A profile is a file that is mapped, shared (continuous mode): what a process has counted stays when
it is killed, and children count into the same. A branch is one outcome of one condition, at its place
in the file; it is taken when any instance of a template, in any program, has taken it.
not_covered.txt names what is not taken, and why. An entry that fits nothing is an error, and so is one
that fits more branches than it says.
"""

import argparse
import collections
import json
import pathlib
import re
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[3]
HERE = pathlib.Path(__file__).resolve().parent
LEAST = 0.85
FLAGS = ['-fprofile-instr-generate', '-fcoverage-mapping', '-mllvm', '-runtime-counter-relocation']
ELF = b'\x7fELF'


def read_reasons(path):
    """[(regular expression, reason)]: an entry is an expression, and its reason in the indented lines."""
    entries = []
    for line in path.read_text().splitlines():
        if line.startswith('#') or not line.strip():
            continue
        if line.startswith('    ') and entries:
            entries[-1][1] += ' ' + line.strip()
        else:
            entries.append([line.strip(), ''])
    return [(re.compile(what), why.strip()) for what, why in entries]


def objects_of(build):
    """Programs and shared libraries that have counters."""
    found = []
    for path in sorted(p for p in build.rglob('*') if p.is_file() and not p.is_symlink()):
        if path.suffix in ('.o', '.a', '.gch', '.pch') or 'CMakeFiles' in path.parts:
            continue
        with open(path, 'rb') as file:
            if file.read(4) == ELF and b'__llvm_covmap' in path.read_bytes():
                found.append(path)
    return found


def branches(objects, profiles, scratch, sources):
    """{(file, line, column, outcome): how often} of the files below `sources`."""
    merged = scratch / 'merged.profdata'
    subprocess.run(['llvm-profdata-19', 'merge', '-sparse', '-o', merged, *profiles], check=True)
    first, *others = objects
    export = subprocess.run(['llvm-cov-19', 'export', '-skip-functions', '-skip-expansions',
                             f'-instr-profile={merged}', first, *[f'-object={o}' for o in others],
                             *map(str, sources)], check=True, capture_output=True)
    counts = collections.Counter()
    for data in json.loads(export.stdout)['data']:
        for file in data['files']:
            for line, column, _, _, taken, not_taken, *_ in file.get('branches', []):
                counts[file['filename'], line, column, 'true'] += taken
                counts[file['filename'], line, column, 'false'] += not_taken
    return counts


def report(counts, root, reasons, missing):
    """Prints the shares; returns the problems."""
    by_room, used, unnamed = collections.defaultdict(list), collections.Counter(), []
    texts = {}
    for (name, line, column, outcome), n in sorted(counts.items()):
        file = str(pathlib.Path(name).relative_to(root))
        by_room[file.rpartition('/')[0]].append(n > 0)
        if n:
            continue
        lines = texts.setdefault(file, pathlib.Path(name).read_text().splitlines())
        place = f'{file}: {lines[line - 1].strip()}'
        fitting = [what for what, _ in reasons if what.search(place)]
        used.update(fitting)
        if not fitting:
            unnamed.append(f'{file}:{line}: never {outcome}: {lines[line - 1].strip()}')
        if missing and re.search(missing, file):
            print(f'{file}:{line}:{column}: never {outcome}: {lines[line - 1].strip()}')
    width = max(len(r) for r in by_room)
    for room, taken in sorted(by_room.items()):
        print(f'{room:{width}}  {len(taken):6}  {sum(taken):6}  {sum(taken) / len(taken):6.1%}')
    total = sum(map(len, by_room.values()))
    taken = sum(sum(t) for t in by_room.values())
    problems = [f'not_covered.txt has an entry that fits nothing: {what.pattern}'
                for what, _ in reasons if not used[what]]
    problems += [f'not_covered.txt gives no reason: {what.pattern}' for what, why in reasons if not why]
    for what, why in reasons:
        most = re.match(r'At most (\d+)\. ', why)
        if not most or used[what] > int(most[1]):
            problems.append(f'not_covered.txt has another reason for {used[what]} branches: {what.pattern}')
    if taken < LEAST * total:
        problems.append(f'less than {LEAST:.0%} of the branches are taken')
    print(f'summary: {total} branches, {taken / total:.1%} taken; '
          f'{total - taken - len(unnamed)} of the others have a reason, {len(unnamed)} have none')
    return problems


SAMPLE = """
#include <csignal>
int larger(int a, int b) {
  if (a > b) return a;
  return b;
}
int main(int argc, char**) {
  const int most = larger(argc, 5);
  std::raise(SIGKILL);
  return most;
}
"""


def self_test():
    """A killed process's branches are there, and one that is not taken is told."""
    with tempfile.TemporaryDirectory(prefix='lot_coverage_') as folder:
        scratch = pathlib.Path(folder)
        (scratch / 'sample.cpp').write_text(SAMPLE)
        subprocess.run(['clang++-19', *FLAGS, '-o', scratch / 'sample', scratch / 'sample.cpp'], check=True)
        subprocess.run([scratch / 'sample'], env={'LLVM_PROFILE_FILE': f'{scratch}/%m%c.profraw'})
        counts = branches(objects_of(scratch), list(scratch.glob('*.profraw')), scratch, [scratch])
        seen = {(line, outcome): n for (_, line, _, outcome), n in counts.items()}
    wrong = seen != {(4, 'true'): 0, (4, 'false'): 1}
    if wrong:
        print(f'these branches were seen: {seen}')
    print(f'summary: self-test, {int(wrong)} failed')
    return int(wrong)


def main(arguments):
    parser = argparse.ArgumentParser(usage=__doc__)
    parser.add_argument('--build', type=pathlib.Path, default=ROOT / 'build' / 'coverage')
    parser.add_argument('--missing', help='print what is not taken in files that match')
    parser.add_argument('--self-test', action='store_true')
    options = parser.parse_args(arguments)
    if options.self_test:
        return self_test()
    profiles = sorted((options.build / 'profiles').glob('*.profraw'))
    if not profiles:
        parser.error(f'no profiles in {options.build}/profiles: run its tests')
    with tempfile.TemporaryDirectory(prefix='lot_coverage_') as scratch:
        counts = branches(objects_of(options.build), profiles, pathlib.Path(scratch),
                          [ROOT / 'src', ROOT / 'include'])
    problems = report(counts, ROOT, read_reasons(HERE / 'not_covered.txt'), options.missing)
    for problem in problems:
        print(problem)
    return 1 if problems else 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
