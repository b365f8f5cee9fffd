# SPDX-License-Identifier: Apache-2.0
"""Mutants of one file, which the revision's hash chooses: as many as scripts/test can afford.

Only objects that include the file are compiled anew, with its mutants in them, from the commands of a
build that is there. Programs are linked again, and lie over the others where the cases run. So the
build stays as it is. A header may be in more objects than there is time for: then some of the library
are chosen, and only what they reach is tried.
"""

import collections
import hashlib
import json
import math
import os
import pathlib
import re
import shlex
import subprocess

import cases
import tree as trees

LIBRARY = 6  # so many objects of the library at most
BUDGET_S = 60  # of a core, for the tests
LINK_S, COMPILE_S = 1.5, 8  # what a program costs
UNKNOWN_S = 5  # a test that has not been run in this build
# What tests run, by the first word of their names.
COMMANDS = {'tool': 'src/tool/lot', 'gateway': 'src/gateway/lot_gateway'}


def number_of(seed, *what):
    """Of the hash, between 0 and 1."""
    digest = hashlib.sha256(' '.join((seed, *what)).encode()).digest()
    return (1 + int.from_bytes(digest[:8], 'big')) / (2 ** 64 + 1)


def in_order(seed, texts):
    """The files, each as likely to be the first as it is long."""
    return sorted(texts, key=lambda n: math.log(number_of(seed, n)) / max(len(texts[n]), 1), reverse=True)


def is_of_tests(compiled):
    return '/tests/' in f'/{compiled}'


class Build:
    """What a build of Ninja says of itself. All paths are relative to its folder."""

    def __init__(self, folder):
        self.folder = folder
        commands = json.loads((folder / 'compile_commands.json').read_text())
        self.compiled = {c['command'].split(' -o ')[1].split()[0]: c for c in commands}
        self.linked = {}
        for line in self.ninja('commands').splitlines():
            words = line.split()
            if found := re.search(r' qc (\S+) ', line) or ('-c' not in words and re.search(r' -o (\S+) ', line)):
                self.linked[found.group(1)] = words

    def ninja(self, tool):
        return subprocess.run(['ninja', '-C', self.folder, '-t', tool], check=True, capture_output=True,
                              text=True).stdout.replace(f"ninja: Entering directory `{self.folder}'\n", '')

    def including(self):
        """{file: the objects that include it, also by headers that are compiled ahead}."""
        named, current = collections.defaultdict(set), None
        for line in self.ninja('deps').splitlines():
            if not line.startswith(' '):
                current = line.partition(':')[0]
            elif line.strip():
                named[current].add(os.path.normpath(self.folder / line.strip()))
        found = collections.defaultdict(set)
        for name, command in self.compiled.items():
            ahead = re.findall(r'-include (\S+cmake_pch\.hxx)', command['command'])
            for one in (name, *(os.path.relpath(h, self.folder) + '.gch' for h in ahead)):
                for file in named[one]:
                    found[file].add(name)
        return found

    def parts(self, name):
        """The objects of a program or an archive, with those of its archives and shared objects."""
        found, todo = set(), [name]
        while todo:
            words = set(self.linked.get(one := todo.pop(), ())) - {one}
            found |= words & self.compiled.keys()
            todo += words & self.linked.keys()
        return found

    def seconds(self):
        """How long each test took when it was run last."""
        file = self.folder / 'Testing' / 'Temporary' / 'CTestCostData.txt'
        lines = file.read_text().splitlines() if file.exists() else []
        return {w[0]: float(w[2]) for w in map(str.split, lines) if len(w) == 3}


class OneFile(trees.Tree):
    def __init__(self, build, jobs, release, seed, root=trees.ROOT):
        super().__init__(build, jobs, root)
        self.objects, self.seed = release, seed
        self.release = Build(release)
        self.chosen, self.made, self.over = [], {}, []

    # ---- choosing -------------------------------------------------------------------------------

    def find(self):
        """The mutants of the first file that has any, in the order of the seed."""
        including = self.release.including()
        for name in in_order(self.seed, self.texts):
            objects = including.get(str(self.root / name))
            if objects and self.find_in(name, sorted(objects)):
                self.code = [name]
                self.choose(name, objects)
                return self.mutants[name]
        raise RuntimeError(f'no object of {self.objects} includes a file of src/ or include/')

    def find_in(self, name, objects):
        command = self.release.compiled[min(objects, key=lambda o: (is_of_tests(o), o))]
        flags = for_clang(trees.arguments(command['command']))
        found = trees.analyse((self.root, command['file'], flags, [name])).get(name, [])
        for number, mutant in enumerate(found, 1):
            mutant.number = number
        self.mutants = {name: found}
        return found

    def choose(self, name, objects):
        """Which objects are compiled anew, and which tests are run."""
        own = {t[0]: self.programs_of(t) for t in cases.all_tests(self.objects)
               if 'ros' in pathlib.PurePath(name).parent.name or not t[0].startswith('ros_')}
        parts_of = {t: set().union(*map(self.release.parts, own[t])) for t in own}
        library = sorted((o for o in objects & set().union(*parts_of.values()) if not is_of_tests(o)),
                         key=lambda o: number_of(self.seed, o))
        self.chosen = library[:LIBRARY]
        seconds, costs, compiled = self.release.seconds(), {}, {}
        for test in sorted(own, key=lambda t: (self.distance(name, t, own[t]), number_of(self.seed, t))):
            compiled[test] = sorted(o for o in parts_of[test] & objects if is_of_tests(o))
            if parts_of[test] & {*compiled[test], *self.chosen}:
                costs[test] = LINK_S + COMPILE_S * len(compiled[test]) + 2 * seconds.get(test, UNKNOWN_S)
        spent, self.names_of_tests = 0.0, []
        for test, cost in costs.items():
            if spent + cost <= BUDGET_S or min(costs.values()) == cost > BUDGET_S:
                spent += cost
                self.names_of_tests.append(test)
        for test in self.names_of_tests:
            self.chosen += [o for o in compiled[test] if o not in self.chosen]
            self.over += [p for p in own[test] if p not in self.over]
        print(f'{name}: {len(self.mutants[name])} mutants, compiled into {len(self.chosen)} of {len(objects)} '
              f'objects, for {" ".join(self.names_of_tests)}', flush=True)

    def programs_of(self, test):
        name, command, *_ = test
        words = [os.path.relpath(w, self.objects) for w in command or () if os.path.isabs(w)]
        return [w for w in [*words, COMMANDS.get(name.partition('_')[0])] if w in self.release.linked]

    def distance(self, name, test, programs):
        """0: a test that bears the file's name; 1: one of its room; 2: another one."""
        path = pathlib.PurePath(name)
        if path.stem in test:
            return 0
        room = path.parts[1] if len(path.parts) > 2 else 'transport'
        return 1 if any(f'/{room}/' in o for p in programs for o in self.release.linked[p]) else 2

    # ---- compiling ------------------------------------------------------------------------------

    def write(self):
        for name in self.code:
            self.write_one(name)
        overlay = {'version': 0, 'case-sensitive': 'true', 'roots': [
            {'type': 'file', 'name': str(self.root / n), 'external-contents': str(self.tree / n)} for n in self.code]}
        (self.build / 'overlay.json').write_text(json.dumps(overlay))

    def configure_once(self):
        pass

    def targets_of(self, tests):
        return self.chosen

    def build_once(self, targets):
        """Compiles what has not been compiled yet; what the compiler says, if it refuses."""
        said, running = '', []
        todo = [t for t in targets if t not in self.made]
        while todo or running:
            while todo and len(running) < self.jobs:
                running.append((todo[0], self.start(todo.pop(0))))
            target, process = running.pop(0)
            output = process.communicate()[0]
            if process.returncode == 0:
                self.made[target] = str(self.place(target))
            else:
                said += output
        if not said:
            for program in filter(self.is_other, self.over):
                self.remake(program)
            cases.OVER[:] = [(new, str(self.objects / name)) for name, new in self.made.items()
                             if name in self.release.linked and not name.endswith('.a')]
        return said

    def place(self, name):
        place = self.build / 'made' / name
        place.parent.mkdir(parents=True, exist_ok=True)
        return place

    def start(self, target):
        command = self.release.compiled[target]
        words = for_clang(trees.arguments(command['command']))
        return subprocess.Popen(
            [trees.CLANG, *words, *trees.FLAGS.split(), '-O0', '-I', trees.HERE, '-ivfsoverlay',
             self.build / 'overlay.json', '-c', command['file'], '-o', self.place(target)],
            cwd=command['directory'], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)

    def remake(self, name):
        """A program or an archive with the objects that were compiled anew; where it lies."""
        words = self.release.linked[name]
        now = {w: self.made[w] if w in self.made else self.remake(w)
               for w in words if w != name and (w in self.made or self.is_other(w))}
        now[name] = self.made[name] = str(self.place(name))
        subprocess.run(' '.join(now.get(w, w) for w in words), shell=True, cwd=self.objects, check=True,
                       capture_output=True)
        return self.made[name]

    def is_other(self, word):
        return word in self.release.linked and bool(self.release.parts(word) & set(self.chosen))


def for_clang(words):
    """Without what only g++ knows. Headers that it has compiled ahead have no mutants, too."""
    kept = []
    for word in words:
        if word.endswith('cmake_pch.hxx') and kept[-1:] == ['-include']:
            kept.pop()
        elif word not in ('-Winvalid-pch', '-fno-gnu-unique'):
            kept.append(word)
    return kept
