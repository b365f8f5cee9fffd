#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Mutants of everything: small mistakes in src/ and include/, which the tests must catch.

    tests/proof/mutants/mutants.py --choose 400    so many, by the hash of the revision
    tests/proof/mutants/mutants.py --full          all of them: for many hours
    tests/proof/mutants/mutants.py --only REGEX    those whose key it matches
    tests/proof/mutants/mutants.py --one-file 20   so many of one file, in a build that is there (one_file.py)
    tests/proof/mutants/mutants.py --self-test     mutants of a sample: those that must be caught are

All mutants are compiled into one copy of the tree (tree.py, operators.py); each process asks at run
time which of them it has (lot_mutant.hpp). One run of the tests records which test case reaches which
mutant. Then each mutant is tried with the cases that reach it, the cheap ones first, until one
fails. A case that fails without the mutant, too, tells nothing.

What has been done stays in the folder --build, and is not done again on the same sources.
equivalent.txt has mutants that are no mistake, open.txt those that no test catches.
"""

import argparse
import array
import collections
import concurrent.futures
import hashlib
import json
import math
import multiprocessing
import os
import pathlib
import pickle
import re
import shutil
import signal
import subprocess
import sys

HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
import cases  # noqa: E402
import operators  # noqa: E402
import tree as trees  # noqa: E402

PROTOCOL = ('src/lockfree_ring/', 'src/refcount/', 'src/recovery/')
LIMITS = {'protocol': 0.95, 'around': 0.85}
DEAREST_S = 20  # a case that takes longer is left to the other parts of scripts/prove


# ---- lists --------------------------------------------------------------------------------------


def read_list(path):
    """{key: reason}: an entry is a key, and its reason in the indented lines below."""
    entries, key = {}, None
    for line in path.read_text().splitlines():
        if line.startswith('#') or not line.strip():
            continue
        if line.startswith('    ') and key:
            entries[key] = (entries[key] + ' ' + line.strip()).strip()
        else:
            key = line.strip()
            entries[key] = ''
    return entries


def check_lists(keys, lists):
    for name, entries in lists.items():
        for key, reason in entries.items():
            if key not in keys:
                yield f'{name} names no mutant: {key}'
            if not reason:
                yield f'{name} gives no reason: {key}'
    for key in set.intersection(*map(set, lists.values())):
        yield f'in both lists: {key}'


# ---- which case reaches which mutant --------------------------------------------------------------


def record(job):
    build, case = job
    reached = build / 'reached' / str(os.getpid())
    reached.parent.mkdir(exist_ok=True)
    with open(reached, 'wb') as file:
        file.truncate(trees.SLOT * trees.SLOTS)
    reached.chmod(0o666)
    how, seconds = cases.inside(build, lambda: cases.run(case, 120, reached=reached))
    found = array.array('I', (m.start() for m in re.finditer(b'\1', reached.read_bytes())))
    reached.unlink()
    return how, seconds, found


def workers(jobs):
    return concurrent.futures.ProcessPoolExecutor(jobs, multiprocessing.get_context('fork'),
                                                  cases.die_with_parent)


class Reach:
    """Of each test: its cases, how long they take, and what they reach."""

    def __init__(self, build, objects):
        self.build, self.objects = build, objects
        self.file = build / 'reach.pickle'
        self.known = pickle.loads(self.file.read_bytes()) if self.file.exists() else {}

    def key(self, test):
        """A test is another one when a file that it names is another one."""
        name, command, environment, _ = test
        files = [*command, *environment.values()]
        if name.startswith('tool_'):
            files.append(str(self.objects / 'src' / 'tool' / 'lot'))
        contents = [pathlib.Path(f).read_bytes() for f in files if os.path.isfile(f)]
        return trees.digest(name, *contents)

    def record(self, tests, jobs, again=False):
        """[(case, what it reaches)] of these tests. Cases that fail are left out."""
        keys = {t[0]: self.key(t) for t in tests}
        todo = [t for t in tests if self.known.get(t[0], ('',))[0] != keys[t[0]]]
        if todo:
            print(f'-- record what {len(todo)} of {len(tests)} tests reach', flush=True)
        with workers(jobs) as pool:
            listed = list(pool.map(cases.cases_of, *zip(*todo))) if todo else []
            jobs_of = [(t, [pool.submit(record, (self.build, c)) for c in listed_cases])
                       for t, listed_cases in zip(todo, listed)]
            for (test, futures), test_cases in zip(jobs_of, listed):
                got = []
                for case, future in zip(test_cases, futures):
                    how, case.seconds, found = future.result()
                    if how:
                        print(f'   fails without a mutant: {case.name}: {how}', flush=True)
                    elif found:
                        got.append((case, found))
                self.known[test[0]] = keys[test[0]], got
                self.file.write_bytes(pickle.dumps(self.known))
        return [entry for t in tests for entry in self.known[t[0]][1]]


# ---- trying -----------------------------------------------------------------------------------------


def attempt(job):
    """One mutant with its cases, in their order."""
    build, number, its_cases = job

    def work():
        spent, misled = 0.0, []
        for tried, case in enumerate(its_cases, 1):
            how, seconds = cases.run(case, cases.limit_of(case), number)
            spent += seconds
            if how:
                without, seconds = cases.run(case, cases.limit_of(case))
                spent += seconds
                if not without:
                    return {'by': case.name, 'how': how, 'tried': tried, 'seconds': spent}
                misled.append(case.name)
        return {'by': None, 'tried': len(its_cases), 'seconds': spent, 'misled': misled}

    return cases.inside(build, work)


class Results:
    """What has come out on these sources, one line for each mutant."""

    def __init__(self, file):
        self.file = file
        lines = file.read_text().splitlines() if file.exists() else []
        self.known = {r['key']: r for r in map(json.loads, lines)}

    def add(self, result):
        self.known[result['key']] = result
        with open(self.file, 'a') as file:
            file.write(json.dumps(result) + '\n')


class Trial:
    def __init__(self, options, reach):
        self.options = options
        self.reach = reach
        self.wins = collections.Counter()

    def order(self, mutant, reaching):
        """The cheap ones first, those of the test that bears the file's name, and those that have
        caught others in that file; not for longer than the patience allows."""
        name = pathlib.PurePath(mutant.file).stem
        order = sorted(reaching, key=lambda c: c.seconds / (
            1 + 4 * (name in c.name.partition(':')[0]) + 4 * self.wins[mutant.file, c.name]))
        total, taken = 0.0, []
        for case in order:
            total += case.seconds
            if taken and total > self.options.patience:
                break
            taken.append(case)
        return taken, len(order)

    def run(self, chosen, results):
        numbers = {m.number: m for m in chosen}
        reaching = {n: [] for n in numbers}
        for case, found in self.reach:
            if case.seconds <= DEAREST_S:
                for n in numbers.keys() & set(found):
                    reaching[n].append(case)
        todo = [m for m in chosen if m.key not in results.known]
        for mutant in todo:
            if not reaching[mutant.number]:
                results.add({'key': mutant.key, 'by': None, 'tried': 0, 'seconds': 0})
        waiting = [m for m in todo if reaching[m.number]]
        running, done = {}, len(chosen) - len(waiting)
        with workers(self.options.jobs) as pool:
            while waiting or running:
                while waiting and len(running) < self.options.jobs:
                    mutant = waiting.pop(0)
                    taken, whole = self.order(mutant, reaching[mutant.number])
                    job = self.options.build, mutant.number, taken
                    running[pool.submit(attempt, job)] = mutant, whole
                ended, _ = concurrent.futures.wait(running, return_when=concurrent.futures.FIRST_COMPLETED)
                for future in ended:
                    mutant, whole = running.pop(future)
                    result = {'key': mutant.key, 'reach': whole, **future.result()}
                    results.add(result)
                    done += 1
                    self.wins[mutant.file, result['by']] += 1
                    verdict = f'{result["by"]}: {result["how"]}' if result['by'] else 'SURVIVES'
                    print(f'{done}/{len(chosen)} {mutant.file}:{mutant.line} {mutant.operator}: {verdict}',
                          flush=True)


# ---- what is said -------------------------------------------------------------------------------------


def as_diff(mutant, text):
    """The lines that the mutant changes, as they are and as it has them."""
    begin = text.rfind('\n', 0, mutant.begin) + 1
    end = text.find('\n', mutant.end)
    before, after = text[begin:mutant.begin], text[mutant.end:end]
    lines = [f'{mutant.file}:{mutant.line} ({mutant.function}): {mutant.operator}']
    lines += ['- ' + l for l in text[begin:end].split('\n')]
    lines += ['+ ' + l for l in (before + mutant.now + after).split('\n')]
    return '\n'.join(lines)


def table(title, groups):
    width = max(len(name) for name in [title, *groups])
    print(f'\n{title:{width}}  mutants  caught  survive  not reached')
    for name in sorted(groups):
        results = groups[name]
        caught = sum(r['by'] is not None for r in results)
        idle = sum(r['by'] is None and r['tried'] == 0 for r in results)
        print(f'{name:{width}}  {len(results):7}  {caught:6}  {len(results) - caught - idle:7}  {idle:11}')


def tell(mutant, results, known_open, texts):
    why = 'no test reaches it' if not results.known[mutant.key]['tried'] else 'no test catches it'
    listed = known_open.get(mutant.key)
    print(f'\n{as_diff(mutant, texts[mutant.file])}\n  {why}; ' +
          (f'open: {listed}' if listed else f'its key: {mutant.key}'))


def judge_one_file(chosen, wanted, found, results, known_open, texts):
    """Survivors are told, and no failure: the change at hand has nothing to do with them, and tests
    that were not run may catch them. But of a whole sample one at least is caught, and of a file that
    has so many mutants some are reached: else the tests do not have them. A few that are reached may all
    lie in one function that no test of them looks at."""
    survivors = [m for m in chosen if results.known[m.key]['by'] is None]
    for mutant in survivors:
        tell(mutant, results, known_open, texts)
    print(f'\nsummary: {len(chosen)} mutants of one file, {len(chosen) - len(survivors)} caught, '
          f'{len(survivors)} survive these tests')
    if not chosen and found >= wanted:
        return [f'none of {found} mutants is reached: the tests do not have them']
    if len(survivors) == len(chosen) >= wanted:
        return ['no mutant is caught: the tests do not have them, or test nothing']
    return []


def judge(chosen, results, known_open, texts, full):
    """Prints what has come out; returns the problems."""
    survivors = [m for m in chosen if results.known[m.key]['by'] is None]
    for mutant in survivors:
        tell(mutant, results, known_open, texts)
    by_room, by_operator, by_side = (collections.defaultdict(list) for _ in range(3))
    for mutant in chosen:
        result = results.known[mutant.key]
        by_room['/'.join(mutant.file.split('/')[:-1])].append(result)
        by_operator[mutant.operator].append(result)
        by_side['protocol' if mutant.file.startswith(PROTOCOL) else 'around'].append(result)
    table('operator', by_operator)
    table('folder', by_room)
    problems = []
    for side, its_results in by_side.items():
        n, limit = len(its_results), LIMITS[side]
        caught = sum(r['by'] is not None for r in its_results)
        # A sample may be two standard deviations below what holds for all.
        slack = 0 if full else 2 * math.sqrt(n * limit * (1 - limit))
        print(f'\n{side}: {caught} of {n} are caught ({100 * caught / n:.1f} %)', end='')
        if caught + slack < limit * n:
            problems.append(f'{side}: less than {limit:.0%} are caught')
    for mutant in chosen:
        if results.known[mutant.key]['by'] and mutant.key in known_open:
            problems.append(f'open.txt says that nothing catches it: {mutant.key}')
        if full and mutant in survivors and mutant.key not in known_open:
            problems.append(f'survives, and stands in no list: {mutant.key}')
    print(f'\nsummary: {len(chosen)} mutants, {len(chosen) - len(survivors)} caught, {len(survivors)} survive')
    return problems


# ---- the program ------------------------------------------------------------------------------------


def revision(root):
    head = subprocess.run(['git', 'rev-parse', 'HEAD'], cwd=root, capture_output=True, text=True)
    return head.stdout.strip() or 'none'


def choose(mutants, options):
    if options.only:
        mutants = [m for m in mutants if re.search(options.only, m.key)]
    if options.choose:
        seed = options.revision or revision(trees.ROOT)
        print(f'chosen by revision {seed} (--revision)')
        mutants = sorted(mutants, key=lambda m: hashlib.sha256(f'{seed} {m.key}'.encode()).digest())
        mutants = mutants[:options.choose]
    return mutants


def parse(arguments):
    parser = argparse.ArgumentParser(usage=__doc__)
    parser.add_argument('--build', type=pathlib.Path, default=trees.ROOT / 'build' / 'mutants')
    parser.add_argument('--choose', type=int)
    parser.add_argument('--full', action='store_true')
    parser.add_argument('--only')
    parser.add_argument('--one-file', type=int)
    parser.add_argument('--release', type=pathlib.Path, default=trees.ROOT / 'build' / 'release',
                        help='the build for --one-file')
    parser.add_argument('--revision', help='a hash: choose as on that revision')
    parser.add_argument('--tests', default='', help='only these (a regular expression)')
    parser.add_argument('--jobs', type=int, default=2 * (os.cpu_count() or 1))
    parser.add_argument('--patience', type=float, help='seconds of test cases for one mutant')
    parser.add_argument('--list', action='store_true', help='print the keys of all mutants')
    parser.add_argument('--self-test', action='store_true')
    options = parser.parse_args(arguments)
    options.build = options.build.resolve()
    options.patience = options.patience or (600 if options.full else 10 if options.one_file else 60)
    if not (options.choose or options.full or options.only or options.one_file or options.list or
            options.self_test):
        parser.error('say --choose N, --full, --only REGEX or --one-file N')
    return options


def tests_of(tree, wanted):
    """The tests, with their programs built."""
    def listed():
        return [t for t in cases.all_tests(tree.objects) if re.search(wanted, t[0])]

    tree.configure_once()
    targets = tree.targets_of([t[0] for t in listed()])
    tree.compile(targets)
    return [t for t in listed() if t[1]]


def try_all(tree, options, choose_of):
    """The mutants that are chosen of all that the compiler takes, and what has come of each.
    choose_of(mutants, numbers of those that a case reaches)."""
    found = [m for of_file in tree.mutants.values() for m in of_file]
    tree.write()
    tests = tests_of(tree, options.tests)
    reach = Reach(options.build, tree.objects).record(tests, options.jobs)
    reached = set().union(*(found for _, found in reach))
    chosen = choose_of([m for m in found if m.key not in tree.refused], reached)
    results = Results(options.build / f'results-{tree.key(options.tests, str(options.patience))}.jsonl')
    Trial(options, reach).run(chosen, results)
    return chosen, results


def try_one_file(options):
    import one_file
    options.build = options.build / 'one_file'
    shutil.rmtree(options.build, ignore_errors=True)
    options.build.mkdir(parents=True)
    seed = options.revision or revision(trees.ROOT)
    print(f'chosen by revision {seed} (--revision)')
    tree = one_file.OneFile(options.build, os.cpu_count() or 1, options.release.resolve(), seed)
    tree.find()
    options.tests = f'^({"|".join(tree.names_of_tests)})$'
    lists = {name: read_list(HERE / name) for name in ('equivalent.txt', 'open.txt')}

    def choose_of(found, reached):
        there = [m for m in found if m.number in reached and m.key not in lists['equivalent.txt']]
        print(f'{len(there)} of {len(found)} mutants are reached by these tests')
        return sorted(there, key=lambda m: one_file.number_of(seed, m.key))[:options.one_file]

    try:
        chosen, results = try_all(tree, options, choose_of)
    except OSError as error:
        print(f'skipped: no PID namespaces here ({error})')
        return 0
    found = sum(map(len, tree.mutants.values()))
    problems = judge_one_file(chosen, options.one_file, found, results, lists['open.txt'], tree.texts)
    print(*problems, sep='\n', end='\n' * bool(problems))
    return 1 if problems else 0


def main(arguments):
    options = parse(arguments)
    if options.self_test:
        import self
        return self.main(options, try_all)
    if options.one_file:
        return try_one_file(options)
    options.build.mkdir(parents=True, exist_ok=True)
    tree = trees.Tree(options.build, os.cpu_count() or 1)
    keys = {m.key for m in tree.find()}
    if options.list:
        print('\n'.join(sorted(keys)))
        return 0
    lists = {name: read_list(HERE / name) for name in ('equivalent.txt', 'open.txt')}
    problems = list(check_lists(keys, lists))

    def choose_of(found, _):
        return [m for m in choose(found, options) if m.key not in lists['equivalent.txt']]

    try:
        chosen, results = try_all(tree, options, choose_of)
    except OSError as error:
        print(f'skipped: no PID namespaces here ({error})')
        return 1 if options.full else 0
    problems += judge(chosen, results, lists['open.txt'], tree.texts, options.full)
    for problem in problems:
        print(problem)
    return 1 if problems else 0


if __name__ == '__main__':
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    sys.exit(main(sys.argv[1:]))
