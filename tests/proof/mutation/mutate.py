#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Spoils the protocol on purpose and shows which check notices.

    mutate.py [options] --build BUILD

  orders      every memory_order argument of the headers, one step weaker
  re-checks   every second look (rechecks.txt), left out
  recovery    mistakes in the steps of recovery and sleep (recovery.py), planted in a copy of the
              headers

A mutant that no check notices must be in survivors.txt, with the reason why it is right to keep the
stronger order. Where a mutant was caught the last time is kept in caught.txt and tried first.

    --build DIR       where the lot_model of this source tree is built (default: build/release)
    --compiler PATH   builds the recovery mutants (default: g++)
    --one-in N        one of each N mutants, chosen by the seed
    --quick           one of each 32, and nothing that must be built
    --seed N          what chooses (default: LOT_TEST_SEED, or a new one)
    --only TEXT       only mutants whose key contains TEXT
    --survivors       tries the justified survivors, too
    --update          writes caught.txt anew
    --jobs N          (default: 2)
    --self-test       checks the parser against code in this file, and that the sources have a
                      place for each mistake that is planted

Exit status: 0 every mutant was caught or is justified, 1 not so, 2 wrong usage.
"""

import argparse
import concurrent.futures
import os
import pathlib
import random
import re
import signal
import subprocess
import sys
import tempfile

import mutants
import recovery
import sites

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parents[2]
FAILED = re.compile(r'^(\S+) +FAIL +(\d+) executions +[\d.]+ s  (.+)$', re.M)
# What is tried until one search notices: quick ones first. `weak` is lot_weak (../weak), the others
# are lot_model.
SEARCHES = (('random', 20000), ('bounded', 0), ('weak', 20000))
LONG = 300000  # schedules of one scenario: some seconds
QUICK_ONE_IN = 32
PATIENCE_S = 1800  # a watchdog, not a limit that is ever near


class Caught:
    """caught.txt: 'KEY | SCENARIO SEARCH EXECUTIONS', what caught a mutant the last time."""

    def __init__(self, path):
        self.path = path
        self.known = {}
        for line in path.read_text().splitlines() if path.exists() else ():
            key, _, how = line.partition(' | ')
            if how:
                scenario, search, executions = how.split()
                self.known[key] = scenario, search, int(executions)

    def write(self, results):
        lines = [f'{key} | {how[0]} {how[1]} {how[2]}' for key, how in sorted(results.items())]
        self.path.write_text('\n'.join(lines) + '\n')


def read_survivors(path):
    """{key: reason}: 'KEY | reason', longer reasons on indented lines that follow."""
    known, key = {}, None
    for line in path.read_text().splitlines():
        if line.startswith('#') or not line.strip():
            continue
        if line[0] == ' ':
            known[key] += ' ' + line.strip()
            continue
        key, _, reason = line.partition(' | ')
        known[key] = reason.strip()
    return known


def search(model, weaken, kind, count, scenarios=()):
    """The first scenario that fails, as (scenario, search, executions, what), or None."""
    program = model.parents[1] / 'weak' / 'lot_weak' if kind == 'weak' else model
    if not program.exists():  # a mutant that was compiled is one of lot_model only
        return None
    command = [program, '--stop', *weaken]
    command += ['--bounded'] if kind == 'bounded' else ['--random', str(count)]
    run = subprocess.run(command + list(scenarios), capture_output=True, text=True,
                         timeout=PATIENCE_S)
    failed = FAILED.search(run.stdout)
    if failed:
        return failed.group(1), kind, int(failed.group(2)), failed.group(3).strip().lower()
    if run.returncode not in (0, 2) or run.returncode == 2 and scenarios == ():
        raise RuntimeError(f'{" ".join(command)}: {run.stdout[-500:]}{run.stderr[-500:]}')
    return None


def try_out(model, weaken, hint):
    """Looks where it was caught the last time, then everywhere. A change of a scenario, or of the
    code, makes other schedules of the same random numbers."""
    if hint:
        scenario, kind, executions = hint
        found = search(model, weaken, kind, max(executions, LONG), (scenario,))
        if found:
            return found
    for kind, count in SEARCHES:
        found = search(model, weaken, kind, count)
        if found:
            return found
    return None


def show(site, written, instead, verdict):
    print(f'{site:<62} {written:>8} {instead:<13} {verdict}', flush=True)


def self_test():
    with tempfile.TemporaryDirectory(prefix='lot_mutant_') as scratch:
        failures = sites.self_test(pathlib.Path(scratch)) + recovery.misplaced(ROOT)
    for failure in failures:
        print(failure)
    print(f'summary: self-test, {len(failures)} failed')
    return 1 if failures else 0


def parse(arguments):
    parser = argparse.ArgumentParser(usage=__doc__, add_help=True)
    parser.add_argument('--build', type=pathlib.Path, default=ROOT / 'build' / 'release')
    parser.add_argument('--compiler', default='g++')
    parser.add_argument('--one-in', type=int, default=1)
    parser.add_argument('--quick', action='store_true')
    parser.add_argument('--seed', type=int)
    parser.add_argument('--only', default='')
    parser.add_argument('--survivors', action='store_true')
    parser.add_argument('--update', action='store_true')
    parser.add_argument('--jobs', type=int, default=2)
    parser.add_argument('--self-test', action='store_true')
    options = parser.parse_args(arguments)
    if options.one_in < 1:
        parser.error('--one-in takes a number from 1')
    if options.quick:
        options.one_in = QUICK_ONE_IN
    options.model = options.build.resolve() / 'tests' / 'proof' / 'model' / 'lot_model'
    if not options.self_test and not options.model.exists():
        parser.error(f'there is no {options.model}: build it, or say --build')
    return options


def offset_of(options):
    """Which of each options.one_in mutants are chosen."""
    if options.one_in == 1:
        return 0
    seed = options.seed if options.seed is not None else os.environ.get('LOT_TEST_SEED')
    if seed is None:
        seed = random.randrange(10**6)
    print(f'seed: --seed {seed}')
    return random.Random(int(seed)).randrange(options.one_in)


def main(arguments):
    options = parse(arguments)
    if options.self_test:
        return self_test()
    found = mutants.all_sites(ROOT)
    at = mutants.places(options.model, found)
    survivors = read_survivors(HERE / 'survivors.txt')
    caught = Caught(HERE / 'caught.txt')
    orders = mutants.of_orders(found)
    rechecks = mutants.of_rechecks(found, HERE / 'rechecks.txt')
    chosen = [m for m in orders + rechecks if options.only in m.key]
    problems = [f'not reached by the model: {s.key} (line {s.begin[0]})'
                for s in found if s.key not in at]
    problems += [f'survivors.txt names no mutant: {key}'
                 for key in survivors if key not in {m.key for m in orders + rechecks}]
    offset = offset_of(options)
    chosen = chosen[offset::options.one_in]

    results, kept = {}, []
    show('site', 'written', 'instead', 'caught by')

    def attempt(mutant):
        if mutant.key in survivors and not options.survivors or mutant.site.key not in at:
            return None
        return try_out(options.model, ['--weaken', f'{at[mutant.site.key]}={mutant.instead}'],
                       caught.known.get(mutant.key))

    with concurrent.futures.ThreadPoolExecutor(options.jobs) as pool:
        for mutant, how in zip(chosen, pool.map(attempt, chosen)):
            if how:
                results[mutant.key] = how
                verdict = f'{how[0]}, {how[1]} {how[2]}: {how[3]}'
                if mutant.key in survivors:
                    problems.append(f'survivors.txt says that nothing catches it: {mutant.key}')
            elif mutant.key in survivors:
                kept.append(mutant.key)
                verdict = 'kept: ' + survivors[mutant.key]
            else:
                verdict = 'NOT CAUGHT'
                if mutant.site.key in at:
                    problems.append(f'not caught: {mutant.key}')
            show(mutant.site.key, mutant.written, mutant.instead, verdict)
        planted = []
        if not options.quick:
            planted = [m for m in recovery.MISTAKES if options.only in m.name][offset::options.one_in]
            builds = recovery.Builds(ROOT, options.compiler, options.model.parent)
            for mutant, how in zip(planted, pool.map(
                    lambda m: builds.try_out(m, caught.known.get(m.name), try_out), planted)):
                if how:
                    results[mutant.name] = how
                    verdict = f'{how[0]}, {how[1]} {how[2]}: {how[3]}'
                else:
                    verdict = 'NOT CAUGHT'
                    problems.append(f'not caught: {mutant.name}')
                show(mutant.name, 'planted', pathlib.PurePath(mutant.file).name, verdict)

    if options.update:
        if options.one_in > 1 or options.only:
            problems.append('--update is for a whole run: caught.txt stays as it is')
        else:
            caught.write(results)
    for problem in problems:
        print(problem)
    print(f'summary: {len(found)} atomic sites, {len(chosen)} weakened or left out and '
          f'{len(planted)} planted: {len(results)} caught, {len(kept)} kept for a reason, '
          f'{len(problems)} problems')
    return 1 if problems else 0


if __name__ == '__main__':
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    sys.exit(main(sys.argv[1:]))
