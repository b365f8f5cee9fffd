# SPDX-License-Identifier: Apache-2.0
"""Each operator finds what it should in sample.cpp, and a trial tells the caught from the surviving."""

import pathlib
import re
import subprocess
import tempfile

import cases
import operators
import tree as trees

HERE = pathlib.Path(__file__).resolve().parent


def expected_survivors(text):
    """{(line, operator)} of the lines that say so."""
    found = set()
    for row, line in enumerate(text.splitlines(), 1):
        if match := re.search(r'// survives: (.*)', line):
            found |= {(row, operator) for operator in match.group(1).split(', ')}
    return found


def mutated(scratch):
    """The sample's mutants, and the program that has them."""
    from clang.cindex import Index
    source = HERE / 'sample.cpp'
    flags = ['-std=c++20', f'-I{HERE}']
    unit = Index.create().parse(str(source), flags)
    text = trees.read(source)
    found = operators.Finder('sample.cpp', text).all(unit, str(source))
    found = [m for m in found if m.function != 'main']
    for number, mutant in enumerate(found, 1):
        mutant.number = number
    (scratch / 'sample.cpp').write_text(operators.write(text, found)[0])
    subprocess.run([trees.CLANG, *flags, '-w', '-o', scratch / 'sample', scratch / 'sample.cpp'], check=True)
    return text, found


def main():
    failures = []
    with tempfile.TemporaryDirectory(prefix='lot_mutants_', dir=pathlib.Path.cwd()) as folder:
        scratch = pathlib.Path(folder)
        text, found = mutated(scratch)
        case = cases.Case('sample', [str(scratch / 'sample')], {}, folder, 0.1)

        def work():
            return [cases.run(case, 5, number)[0] for number in range(len(found) + 1)]

        try:
            how = cases.inside(scratch, work)
        except OSError:
            print('skipped: no PID namespaces here')
            return 0
        if how[0]:
            failures.append(f'the sample fails without a mutant: {how[0]}')
        for missing in set(operators.ABOUT) - {m.operator for m in found}:
            failures.append(f'no mutant of this operator: {missing}')
        expected = expected_survivors(text)
        survivors = {(m.line, m.operator) for m in found if not how[m.number]}
        failures += [f'survives, and should not: line {l}, {o}' for l, o in sorted(survivors - expected)]
        failures += [f'is caught, and should not: line {l}, {o}' for l, o in sorted(expected - survivors)]
        for mutant in found:
            if mutant.written.startswith('static_assert') or '<int, 3>' in text[mutant.begin - 1:mutant.end + 1]:
                failures.append(f'mutated what only the compiler evaluates: line {mutant.line}')
    for failure in failures:
        print(failure)
    print(f'summary: self-test, {len(found)} mutants of the sample, {len(survivors)} survive, '
          f'{len(failures)} failed')
    return 1 if failures else 0
