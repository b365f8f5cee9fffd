# SPDX-License-Identifier: Apache-2.0
"""The whole way of the mutants of a small project (sample/): each operator finds what it should, and
what is caught, survives or is refused by the compiler is told."""

import os
import pathlib
import re
import shutil
import subprocess
import tempfile

import cases
import one_file
import operators
import tree as trees

HERE = pathlib.Path(__file__).resolve().parent


def expected(text, what):
    """{(line, operator)} of the lines that say so."""
    found = set()
    for row, line in enumerate(text.splitlines(), 1):
        if match := re.search(f'// {what}: (.*)', line):
            found |= {(row, operator) for operator in match.group(1).split(', ')}
    return found


def compare(what, got, wanted):
    for line, operator in sorted(got ^ wanted):
        yield f'line {line}, {operator}: ' + (f'is not {what}' if (line, operator) in wanted else f'is {what}')


def of_one_file(options, scratch, root, try_all):
    """What survives in the same project, where its only file is compiled into a build that is there."""
    release = scratch / 'release'
    subprocess.run(['cmake', '-S', root, '-B', release, '-G', 'Ninja', f'-DCMAKE_CXX_COMPILER={trees.CLANG}',
                    '-DCMAKE_EXPORT_COMPILE_COMMANDS=ON'], check=True, capture_output=True)
    subprocess.run(['ninja', '-C', release], check=True, capture_output=True)
    options.build = scratch / 'one_file'
    options.build.mkdir()
    tree = one_file.OneFile(options.build, os.cpu_count() or 1, release, 'any', root)
    tree.find()
    chosen, results = try_all(tree, options, lambda found, reached: [m for m in found if m.number in reached])
    cases.OVER.clear()
    return {(m.line, m.operator) for m in chosen if results.known[m.key]['by'] is None}


def main(options, try_all):
    """try_all(tree, options, choose): (chosen, results), as mutants.py does it."""
    with tempfile.TemporaryDirectory(prefix='lot_mutants_', dir=pathlib.Path.cwd()) as folder:
        scratch = pathlib.Path(folder)
        root = scratch / 'root'
        shutil.copytree(HERE / 'sample', root)
        options.build = scratch / 'build'
        options.build.mkdir()
        tree = trees.Tree(options.build, 1, root)
        found = tree.find()
        text = tree.texts['src/sample.hpp']
        try:
            chosen, results = try_all(tree, options, lambda all_of_them, _: all_of_them)
        except OSError as error:
            print(f'skipped: no PID namespaces here ({error})')
            return 0
        tried = {(m.line, m.operator) for m in chosen if results.known[m.key]['tried']}
        of_one = of_one_file(options, scratch, root, try_all)
    failures = [f'no mutant of this operator: {o}' for o in set(operators.ABOUT) - {m.operator for m in found}]
    survivors = {(m.line, m.operator) for m in chosen if results.known[m.key]['by'] is None}
    failures += compare('surviving, in one file', of_one, survivors & tried)
    refused = {(m.line, m.operator) for m in found if m.key in tree.refused}
    failures += compare('surviving', survivors, expected(text, 'survives'))
    failures += compare('refused', refused, expected(text, 'refused'))
    failures += [f'line {m.line}: only the compiler evaluates this' for m in found
                 if m.written.startswith('static_assert') or text[m.end:].startswith('>{}')]
    for failure in failures:
        print(failure)
    print(f'summary: self-test, {len(found)} mutants of the sample, {len(survivors)} lines with survivors, '
          f'{len(failures)} failed')
    return 1 if failures else 0
