#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Checks the Spin models of this folder, and that they still say what the code says.

    run.py [--jobs N] [--full] [--mappings] [MODEL...]   all models, or these (sleep_wake, ...)
    run.py --one-in N                                    one of each N searches, others with each
                                                         LOT_TEST_SEED
    run.py --self-test                                   plant mistakes and see that each is found

A model says in its first comment how it is run:

    run NAME [-D...] : what            must be free of errors, and searched to the end
    full NAME [-D...] : what           the same, with --full only
    bug NAME [-D...] : what            a bug of the code: Spin must find it, until it is mended
    plant MACRO NAME : what            run NAME with -DMACRO: Spin must find an error
    pan [-m...] [-D...]                options of the search, and of its compilation

With --full the models are given -DFULL as well. An `ltl` formula is checked under weak fairness;
without one the search is for failed assertions and for ends in which somebody is stuck.

A step of a model carries its place in the code: /* @ FILE FUNCTION: a literal piece of it */. That
piece must occur in the function, whatever the white space. So that nothing is left out, each line
that names a shared word has such a place; the words are what is declared below the comment
`shared`. No place have: macros, assertions, init, the kernel's steps (what is called kernel_...,
lines that say /* kernel: ... */) and planted mistakes.

Needs spin and gcc (Debian: spin, gcc). One job takes up to 3 GB.
"""

import argparse
import concurrent.futures
import dataclasses
import os
import pathlib
import random
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time

HERE = pathlib.Path(__file__).resolve().parent
MEMORY_MB = 3000
DEPTH = '-m1000000'

LINE = re.compile(r'^ \* (run|full|bug|plant|pan)\b(.*)$', re.M)
MAPPING = re.compile(r'/\* @ (\S+) (\S+): (.+?) \*/')
BLOCK = re.compile(r'^(?:active )?(inline|proctype|init|ltl)\b\s*(\w*)')
MACRO = re.compile(r'^#\s*(ifdef|ifndef|if|elif|else|endif)\b\s*(.*)')
DECLARED = re.compile(r'^(?:bit|bool|byte|short|int|chan)\b(.*);', re.M)
BODY = re.compile(r'\s*(?:(?:const|noexcept|override)\b\s*|(?:->|:)[^;{]*)*\{')
CPP_NOISE = re.compile(r'//[^\n]*|/\*.*?\*/|("(?:[^"\\\n]|\\.)*")', re.S)
FOUND = re.compile(r'^pan:\d+: (invalid end state|assertion violated.*?|acceptance cycle|'
                   r'end state in claim reached)(?: \(at depth \d+\))?$', re.M)
CUT_SHORT = ('max search depth too small', 'Search not completed', 'reached -DMEMLIM bound',
             'out of memory', 'aborting')


@dataclasses.dataclass
class Run:
    name: str
    flags: list
    full: bool
    kind: str  # run, bug or plant
    base: str = ''  # of a plant: the run that is right without it


@dataclasses.dataclass
class Model:
    name: str
    text: str
    runs: list
    options: list
    complaints: list


def read_model(path):
    """The model and its runs. What is wrong with its header is in `complaints`."""
    model = Model(path.stem, path.read_text(), [], [DEPTH], [])
    runs = {}
    plants = {}
    for kind, rest in LINE.findall(model.text.partition('*/')[0]):
        words = rest.partition(' : ')[0].split()
        if kind == 'pan':
            model.options += words
        elif kind == 'plant' and len(words) == 2:
            plants[words[0]] = words[1]
        elif kind != 'plant' and words and all(w.startswith('-D') for w in words[1:]):
            runs[words[0]] = Run(words[0], words[1:], kind == 'full',
                                 'bug' if kind == 'bug' else 'run')
        else:
            model.complaints.append(f'{path.name}: cannot read "{kind}{rest}"')
    model.runs = list(runs.values())
    for macro, name in plants.items():
        if name in runs:
            base = runs[name]
            model.runs.append(Run(macro, [*base.flags, '-D' + macro], base.full, 'plant', name))
        else:
            model.complaints.append(f'{path.name}: plant {macro}: there is no run {name}')
    if not runs or not plants:
        model.complaints.append(f'{path.name}: names no run, or plants no mistake')
    model.complaints += unused_macros(path.name, model.text, runs.values(), plants)
    return model


def unused_macros(file, text, runs, plants):
    """A macro that the model asks for and nobody sets is a mistake that nobody looks for."""
    asked = set(re.findall(r'\b(?:ifdef\s+|ifndef\s+|defined\s*\()(\w+)', text))
    known = set(re.findall(r'^#\s*define\s+(\w+)', text, re.M)) | {'FULL'}
    known |= {flag[2:].partition('=')[0] for run in runs for flag in run.flags}
    return [f'{file}: no run sets {macro}' for macro in sorted(asked - known - set(plants))] + [
        f'{file}: {macro} is planted nowhere' for macro in sorted(set(plants) - asked)]


# ---- model and code -----------------------------------------------------------------------------


def squeeze(text):
    return re.sub(r'\s+', '', text)


def without_comments(text):
    return CPP_NOISE.sub(lambda m: m.group(1) or ' ', text)


def closing(text, at):
    """Behind the bracket that closes the one at `at`."""
    depth = 0
    for i in range(at, len(text)):
        depth += (text[i] in '({') - (text[i] in ')}')
        if depth == 0:
            return i + 1
    return len(text)


def functions(text, name):
    """Heads and bodies of the functions of that name."""
    for call in re.finditer(rf'(?<![\w~]){re.escape(name)}\s*\(', text):
        end = closing(text, call.end() - 1)
        body = BODY.match(text, end)
        if body:
            yield text[call.start():closing(text, body.end() - 1)]


def drifted(model, root):
    """Mappings whose code is no longer there."""
    sources = {}
    for number, line in enumerate(model.text.splitlines(), 1):
        if '/* @' not in line:
            continue
        at = f'{model.name}.pml:{number}'
        mapping = MAPPING.search(line)
        if not mapping:
            yield f'{at}: not of the form /* @ FILE FUNCTION: PIECE */'
            continue
        file, function, piece = mapping.groups()
        if file not in sources:
            path = root / file
            sources[file] = without_comments(path.read_text()) if path.is_file() else ''
        found = list(functions(sources[file], function))
        if not found:
            yield f'{at}: {file} has no function {function}'
        elif not any(squeeze(piece) in squeeze(text) for text in found):
            yield f'{at}: {file} {function}: no longer says: {piece}'


def shared_words(text):
    """What is declared between the comment `shared` and the next one that begins a line."""
    section = re.search(r'^/\* shared \*/\n(.*?)^/\*', text, re.M | re.S)
    words = set()
    for declared in DECLARED.findall(section.group(1) if section else ''):
        words |= set(re.findall(r'(\w+)\s*(?:\[[^\]]*\]|=[^,]*)*\s*(?:,|$)', declared))
    return words


def unmapped(model):
    """Lines that name a shared word and do not say where the code does."""
    words = shared_words(model.text)
    if not words:
        yield f'{model.name}.pml: declares no shared words'
        return
    plants = {run.name for run in model.runs if run.kind == 'plant'}
    touch = re.compile(rf'\b(?:{"|".join(words)})\b')
    branches = []  # of #if: is this the side of a planted mistake?
    block = None
    macro_goes_on = False
    for number, line in enumerate(model.text.splitlines(), 1):
        directive = MACRO.match(line)
        if directive:
            kind, macro = directive.groups()
            if kind in ('if', 'ifdef', 'ifndef'):
                branches.append([macro in plants, kind == 'ifdef'])
            elif kind == 'else':
                branches[-1][1] = not branches[-1][1]
            elif kind == 'endif':
                branches.pop()
        in_macro = macro_goes_on or line.startswith('#')
        macro_goes_on = in_macro and line.endswith('\\')
        start = BLOCK.match(line)
        if start:
            block = start.groups()
        if (block and block[0] in ('inline', 'proctype') and not block[1].startswith('kernel_')
                and not in_macro and '/* @' not in line and '/* kernel:' not in line
                and not any(planted and side for planted, side in branches)):
            code = re.sub(r'/\*.*?\*/|//.*|\bassert\s*\(.*\)', '', line)
            code = code[start.end():] if start else code
            if touch.search(code):
                yield f'{model.name}.pml:{number}: has no place in the code: {line.strip()}'
        if line.startswith('}') or (start and line.rstrip().endswith('}')):
            block = None


# ---- searching ----------------------------------------------------------------------------------


class Children:
    """The processes that we started: none outlives us."""

    def __init__(self):
        self.lock = threading.Lock()
        self.running = set()
        self.stopped = False

    def output_of(self, command, folder):
        with self.lock:
            if self.stopped:
                return 1, 'stopped'
            child = subprocess.Popen(
                ['setpriv', '--pdeathsig', 'KILL', *command], cwd=folder, text=True,
                errors='replace', stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT, process_group=0)
            self.running.add(child)
        with child.stdout:
            output = child.stdout.read()
        with self.lock:  # so that stop() never meets a number that is somebody else's by now
            child.wait()
            self.running.discard(child)
        return child.returncode, output

    def stop(self):
        with self.lock:
            self.stopped = True
            for child in self.running:
                os.killpg(child.pid, signal.SIGKILL)  # with the compiler proper behind gcc


@dataclasses.dataclass
class Outcome:
    ok: bool
    result: str
    states: str = '-'
    depth: str = '-'
    seconds: float = 0.0
    trail: str = ''


def judge(output, wrong):
    """What pan's report means for a run that must be right, or must be wrong."""
    errors = re.search(r'errors: (\d+)', output)
    found = FOUND.search(output)
    cut = next((sign for sign in CUT_SHORT if sign in output), None)
    if not errors:
        return Outcome(False, 'the search broke off: ' + (output.strip().splitlines() or ['-'])[-1])
    states = re.search(r'(\S+) states, stored(?: \((\S+) visited\))?', output)
    depth = re.search(r'depth reached (\d+)', output)
    counts = (states.group(2) or states.group(1), depth.group(1))
    if int(errors.group(1)) > 0:
        if not found:
            return Outcome(False, 'the model is broken: ' + output.splitlines()[0], *counts)
        return Outcome(wrong, ('found: ' if wrong else 'ERROR: ') + found.group(1), *counts)
    if cut:
        return Outcome(False, f'NOT SEARCHED TO THE END: {cut}', *counts)
    return Outcome(not wrong, 'NOT FOUND' if wrong else 'no error', *counts)


def search(model, run, more, children):
    """Generates, compiles and runs one search in a folder of its own."""
    begin = time.monotonic()
    flags = [*run.flags, *more]
    file = model.name + '.pml'
    with tempfile.TemporaryDirectory(prefix='lot_spin_') as folder:
        pathlib.Path(folder, file).write_text(model.text)
        status, output = children.output_of(['spin', *flags, '-a', file], folder)
        # Spin ends with 0 in spite of some of its complaints.
        if status != 0 or re.search(r'^spin: .*(?:error|[Ee]rror:)', output, re.M):
            return Outcome(False, 'spin: ' + (output.strip().splitlines() or ['-'])[0])
        fair = re.search(r'^ltl \w+:', output, re.M)
        compile_flags = [o for o in model.options if o.startswith('-D')]
        # A mistake is found sooner than gcc has optimised.
        optimise = '-O2' if run.kind == 'run' else '-O0'
        status, output = children.output_of(
            ['gcc', optimise, '-w', f'-DMEMLIM={MEMORY_MB}', *([] if fair else ['-DSAFETY']),
             *compile_flags, '-o', 'pan', 'pan.c'], folder)
        if status != 0:
            return Outcome(False, 'gcc: ' + (output.strip().splitlines() or ['-'])[0])
        options = [o for o in model.options if not o.startswith('-D')]
        _, output = children.output_of(
            ['./pan', '-n', *options, *(['-a', '-f'] if fair else [])], folder)
        outcome = judge(output, run.kind != 'run')
        if outcome.result.startswith('ERROR'):
            _, trail = children.output_of(['spin', *flags, '-p', '-t', file], folder)
            outcome.trail = '\n'.join(trail.splitlines()[-60:])
    outcome.seconds = time.monotonic() - begin
    return outcome


ROW = '{:18} {:30} {:>12} {:>8} {:>8}  {}'


def check(folder, root, arguments):
    """Prints the table. Returns the summary and whether all is well."""
    paths = sorted(folder.glob('*.pml'))
    unknown = set(arguments.model) - {path.stem for path in paths}
    if unknown or not paths:
        return f'no such model: {", ".join(sorted(unknown)) or folder}', False
    models = [read_model(p) for p in paths if not arguments.model or p.stem in arguments.model]
    complaints = [c for m in models for c in (*m.complaints, *drifted(m, root), *unmapped(m))]
    mapped = sum(len(MAPPING.findall(m.text)) for m in models)
    print(*complaints, sep='\n', end='\n' if complaints else '')
    drift = f'{len(models)} models, {mapped} mapped lines, {len(complaints)} complaints'
    if arguments.mappings:
        return drift, not complaints

    jobs = [(m, r) for m in models for r in m.runs if arguments.full or not r.full]
    if arguments.one_in > 1:
        seed = int(os.environ.get('LOT_TEST_SEED') or random.SystemRandom().getrandbits(32))
        print(f'seed: LOT_TEST_SEED={seed}')
        jobs = jobs[seed % arguments.one_in::arguments.one_in]
    more = ['-DFULL'] if arguments.full else []
    children = Children()
    outcomes = []
    right = {}
    print(ROW.format('model', 'variant', 'states', 'depth', 'seconds', 'result'), flush=True)
    with concurrent.futures.ThreadPoolExecutor(arguments.jobs) as pool:
        try:
            pending = [pool.submit(search, m, r, more, children) for m, r in jobs]
            for (model, run), future in zip(jobs, pending):
                outcome = future.result()
                outcomes.append(outcome)
                right[model.name, run.name] = outcome.ok
                if not right.get((model.name, run.base), True):
                    outcome.ok, outcome.result = False, f'proves nothing: {run.base} is wrong'
                print(ROW.format(model.name, run.name, outcome.states, outcome.depth,
                                 f'{outcome.seconds:.1f}', outcome.result), flush=True)
        except BaseException:
            children.stop()
            pool.shutdown(cancel_futures=True)
            raise
    for (model, run), outcome in zip(jobs, outcomes):
        if outcome.trail:
            print(f'\n---- {model.name} {run.name}: how it ends\n{outcome.trail}')

    def count(kind):
        of_kind = [o.ok for (_, run), o in zip(jobs, outcomes) if run.kind == kind]
        return f'{sum(of_kind)} of {len(of_kind)}'

    return (f"{drift}; {count('run')} runs without an error, {count('plant')} planted mistakes "
            f"found, {count('bug')} known bugs still there",
            not complaints and all(o.ok for o in outcomes))


# ---- self-test ----------------------------------------------------------------------------------

CODE = '''
bool Lock::try_lock(int k) const {
  // word.exchange(3)
  return word.exchange(k,
                       acquire) == 0;
}
void Lock::unlock() { word.store(0); }
'''
GOOD = '''/* One word, two processes.
 *
 * run two : nobody waits for ever
 * plant NO_UNLOCK two : the lock is kept
 * plant TWO_STEPS two : a look, then a store
 * run served -DSERVED : all are served
 * plant LAZY served : nobody is
 * bug kept -DKEPT : the lock is never given back
 */
/* shared */
byte word;
/* ghost */
byte inside, after;

inline leave() {
#if !defined(NO_UNLOCK) && !defined(KEPT)
  word = 0 /* @ src/lock.cpp unlock: word.store(0) */
#else
  skip
#endif
}
active [2] proctype p() {
#ifdef LAZY
end:
  false;
#endif
#ifdef TWO_STEPS
  word == 0;
  word = 1;
#else
  atomic { word == 0 -> word = 1 }; /* @ src/lock.cpp try_lock: word.exchange(k, acquire) == 0 */
#endif
  inside++;
  assert(inside == 1);
  inside--;
  leave();
  after++
}
#ifdef SERVED
ltl served { <> (after == 2) }
#endif
'''
DRIFTED = [  # what to replace in the model, by what, and what must be said without a search
    ('word.store(0)', 'word.store(1)', 'no longer says: word.store(1)'),
    ('word.exchange(k, acquire) == 0', 'word.exchange(3)', 'no longer says'),
    ('unlock: word.store', 'try_lock: word.store', 'no longer says'),
    ('cpp unlock:', 'cpp release:', 'has no function release'),
    ('src/lock.cpp', 'src/gone.cpp', 'src/gone.cpp has no function'),
    (' unlock: ', ' unlock ', 'not of the form'),
    (' /* @ src/lock.cpp unlock: word.store(0) */', '', 'm.pml:17: has no place in the code'),
    ('/* shared */', '/* words */', 'declares no shared words'),
    (' * plant NO_UNLOCK two : the lock is kept\n', '', 'no run sets NO_UNLOCK'),
    ('plant NO_UNLOCK two', 'plant NO_UNLOCK three', 'there is no run three'),
    ('#ifdef LAZY', '#ifdef SERVED', 'LAZY is planted nowhere'),
    (' * run two :', ' * run two three :', 'cannot read "run two three'),
]
WRONG = [  # the same, and what the searches must say
    ('#ifdef TWO_STEPS\n', '#ifndef SERVED\n', 'ERROR: assertion violated'),
    ('!defined(NO_UNLOCK)', 'defined(NO_UNLOCK)', 'ERROR: invalid end state'),
    ('!defined(NO_UNLOCK)', 'defined(NO_UNLOCK)', 'proves nothing: two is wrong'),
    ('#ifdef LAZY', '#ifndef LAZY', 'ERROR: acceptance cycle'),
    ('assert(inside == 1)', 'skip', ' NOT FOUND'),
    ('-DKEPT', '-DFULL', ' NOT FOUND'),
    (' */', ' * pan -m5\n */', 'max search depth too small'),
    ('inside++', 'inside+', 'spin: '),
    (' */', ' * pan -DMEMLIM=x\n */', 'gcc: '),
]


def self_test():
    """Runs this program on a small model, then on the same with each mistake."""
    failures = []
    with tempfile.TemporaryDirectory(prefix='lot_spin_') as scratch:
        root = pathlib.Path(scratch)
        (root / 'src').mkdir()
        (root / 'src' / 'lock.cpp').write_text(CODE)

        def check_that(text, status, expected, *options):
            (root / 'm.pml').write_text(text)
            child = subprocess.run(
                [sys.executable, __file__, '--folder', scratch, '--root', scratch, *options],
                env={**os.environ, 'TMPDIR': scratch}, capture_output=True, text=True, check=False)
            if child.returncode != status or expected not in child.stdout:
                failures.append(f'expected {expected!r}, got {child.stdout}{child.stderr}')

        check_that(GOOD, 0, '2 of 2 runs without an error, 3 of 3 planted mistakes found, 1 of 1')
        for old, new, expected in DRIFTED:
            check_that(GOOD.replace(old, new, 1), 1, expected, '--mappings')
        for old, new, expected in WRONG:
            check_that(GOOD.replace(old, new, 1), 1, expected)
    return failures, 1 + len(DRIFTED) + len(WRONG)


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('model', nargs='*', help='names of models; default: all')
    parser.add_argument('--jobs', type=int, default=1, choices=(1, 2), help='searches at once')
    parser.add_argument('--full', action='store_true', help='the larger runs as well')
    parser.add_argument('--one-in', type=int, default=1, metavar='N',
                        help='one of each N searches, others with each LOT_TEST_SEED')
    parser.add_argument('--mappings', action='store_true', help='compare with the code only')
    parser.add_argument('--folder', type=pathlib.Path, default=HERE, help='where the models lie')
    parser.add_argument('--root', type=pathlib.Path, default=HERE.parents[2],
                        help='where their mappings begin')
    parser.add_argument('--self-test', action='store_true')
    arguments = parser.parse_args()
    # The folders and the children of a search go away as on Ctrl-C.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    if arguments.self_test:
        failures, cases = self_test()
        print(*failures, sep='\n', end='\n' if failures else '')
        summary, ok = f'self-test: {cases} cases, {len(failures)} failed', not failures
    else:
        summary, ok = check(arguments.folder, arguments.root, arguments)
    print(f'summary: {summary}')
    return 0 if ok else 1


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        print('summary: interrupted')
        sys.exit(130)
