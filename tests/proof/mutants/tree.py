# SPDX-License-Identifier: Apache-2.0
"""A copy of the source tree with all mutants in it, and its build.

What has been found in a file, and which mutants a compiler has refused, is remembered under build/:
a second run on the same sources finds all of it there, and one on others does what has changed.
"""

import bisect
import concurrent.futures
import hashlib
import json
import os
import pathlib
import pickle
import re
import shlex
import shutil
import subprocess
import zlib

import operators

ROOT = pathlib.Path(__file__).resolve().parents[3]
HERE = pathlib.Path(__file__).resolve().parent
CODE = re.compile(r'(src|include)/.*\.[hc]pp')
SLOT, SLOTS = 1024, 2048  # numbers of one file: whole slots; SLOT * SLOTS is kReachable of lot_mutant.hpp
CLANG = 'clang++-19'
# Every optimisation costs more time here than it saves. A refusal must be an error with its place.
FLAGS = ('-w -Wno-error -Wno-narrowing -Wno-invalid-constexpr -ferror-limit=0 '
         '-fno-caret-diagnostics -fno-color-diagnostics')
SETTINGS = {
    'CMAKE_CXX_COMPILER': CLANG, 'CMAKE_BUILD_TYPE': 'Release', 'LOT_BUILD_BENCH': 'OFF',
    'LOT_BUILD_MODEL': 'OFF', 'LOT_BUILD_EXAMPLES': 'OFF',
    'LOT_RELAY_PACKAGES': 'std_msgs;sensor_msgs;nav_msgs;visualization_msgs;tf2_msgs',
    'LOT_WERROR': 'OFF', 'CMAKE_CXX_FLAGS': FLAGS, 'CMAKE_CXX_FLAGS_RELEASE': '-O0 -DNDEBUG',
    'LOT_LIBRARY_OPTIONS': '-O1', 'LOT_TEST_OPTIONS': '', 'LOT_BUSY_TEST_OPTIONS': '-O1',
    'LOT_LIBRARY_UNITY': 'ON', 'CMAKE_UNITY_BUILD': 'ON'}
# What tests need beside the program of their name, by the first word of that.
NEEDED = {
    'tool': {'lot_cli'},
    'ros': {'lot_cli', 'src/lot_ros/all', 'tests/lot_ros/all'},
    'gateway': {'src/gateway/all', 'tests/gateway/all'},
    'outside': {'tests/proof/outside/all'},
    'codec': {'tests/codec/all'},
    'python': {'src/python/all', 'tests/python/all'},
    'crash': {'crash_node'}}
ERROR = re.compile(r'^(?:In file included from )?([^\s:][^:\n]*):(\d+):(\d+): (?:fatal )?(error|note): (.*)$', re.M)


def digest(*texts):
    total = hashlib.sha256()
    for text in texts:
        total.update(text if isinstance(text, bytes) else text.encode('latin-1', 'replace'))
        total.update(b'\0')
    return total.hexdigest()[:20]


def write_if_other(path, data):
    if not path.exists() or path.read_bytes() != data:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)


def tracked(root):
    """All files of the sources, by name."""
    if (root / '.git').exists():
        found = subprocess.run(['git', 'ls-files', '-z', '--cached', '--others', '--exclude-standard'],
                               cwd=root, capture_output=True, text=True, check=True).stdout.split('\0')
    else:
        found = files_below(root)
    return sorted(n for n in found if n and not n.startswith('build/') and (root / n).is_file())


def arguments(command):
    """What libclang needs of a compiler's command."""
    kept, words = [], iter(shlex.split(command)[1:])
    for word in words:
        if word == '-o':
            next(words)
        elif word != '-c' and not word.startswith('-O') and (
                not word.startswith('-W') or word.startswith('-Wno-')):
            kept.append(word)
    return kept[:-1]


def read(path):
    """Latin-1: each byte is a character, so that the compiler's offsets are Python's."""
    return path.read_bytes().decode('latin-1')


def analyse(job):
    """The mutants of the files of one translation unit that are wanted: {file: [Mutant]}."""
    from clang.cindex import Index
    root, source, flags, wanted = job
    unit = Index.create().parse(str(source), flags)
    errors = [str(d) for d in unit.diagnostics if d.severity > 2]
    if errors:
        raise RuntimeError(f'{source}: libclang: {errors[0]}')
    included = {i.include.name for i in unit.get_includes()} | {str(source)}
    found = {}
    for name in wanted:
        path = str(root / name)
        spelled = next((i for i in included if os.path.realpath(i) == path), None)
        if spelled:
            found[name] = operators.Finder(name, read(root / name)).all(unit, spelled)
    return found


class Tree:
    def __init__(self, build, jobs, root=ROOT):
        self.root, self.build, self.jobs = root, build, jobs
        self.tree, self.objects = build / 'tree', build / 'objects'
        self.refused_file = build / 'refused.json'
        self.refused = set(json.loads(self.refused_file.read_text())) if self.refused_file.exists() else set()
        self.names = tracked(root)
        self.code = [n for n in self.names if CODE.fullmatch(n)]
        self.texts = {n: read(root / n) for n in self.code}
        self.places = {}
        self.mutants = {}

    def log(self, text):
        print(f'-- {text}', flush=True)

    # ---- finding ------------------------------------------------------------------------------

    def commands(self):
        """The compiler's command of each file, from a build that is configured only."""
        flags = self.build / 'flags'
        inputs = [n for n in self.names if n.endswith(('CMakeLists.txt', '.cmake'))]
        key = digest(*self.names, *[(self.root / n).read_bytes() for n in inputs])
        stamp = flags / f'configured-{key}'
        if not stamp.exists():
            self.log('configure, for the flags of each file')
            shutil.rmtree(flags, ignore_errors=True)
            settings = {**SETTINGS, 'LOT_LIBRARY_UNITY': 'OFF', 'CMAKE_UNITY_BUILD': 'OFF',
                        'LOT_BUILD_EXAMPLES': 'ON', 'CMAKE_EXPORT_COMPILE_COMMANDS': 'ON',
                        'CMAKE_DISABLE_PRECOMPILE_HEADERS': 'ON'}
            self.configure(self.root, flags, settings)
            stamp.touch()
        commands = json.loads((flags / 'compile_commands.json').read_text())
        found = {}
        for entry in commands:
            found.setdefault(os.path.relpath(entry['file'], self.root), arguments(entry['command']))
        return found

    def configure(self, source, build, settings):
        run = subprocess.run(['cmake', '-S', source, '-B', build, '-G', 'Ninja',
                              *[f'-D{k}={v}' for k, v in settings.items()]],
                             capture_output=True, text=True)
        if run.returncode != 0:
            raise RuntimeError(f'cmake: {run.stdout[-3000:]}{run.stderr[-3000:]}')

    def find(self):
        """All mutants of src/ and include/, numbered."""
        cache = self.build / 'found'
        cache.mkdir(parents=True, exist_ok=True)
        about = digest((HERE / 'operators.py').read_bytes())
        kept = {n: cache / digest(about, n, self.texts[n]) for n in self.code}
        missing = {n for n in self.code if not kept[n].exists()}
        if missing:
            commands = self.commands()
            self.log(f'look for mutants in {len(missing)} of {len(self.code)} files')
            self.look(missing, commands, kept)
        used = {p.name for p in kept.values()}
        for old in cache.iterdir():
            if old.name not in used:
                old.unlink()
        for name in self.code:
            self.mutants[name] = pickle.loads(kept[name].read_bytes())
        self.number()
        return [m for n in self.code for m in self.mutants[n]]

    def look(self, missing, commands, kept):
        sources = [n for n in commands if n.endswith('.cpp')]
        needed = self.closure(sources)
        order = sorted(sources, key=lambda n: (not n.startswith('src/'), n))
        with concurrent.futures.ProcessPoolExecutor(self.jobs) as pool:
            waiting = set(missing)
            while waiting:
                # One unit for each worker at a time, so that no header is looked at twice.
                jobs, taken = [], set()
                for source in order:
                    wanted = (needed[source] & waiting) - taken
                    if wanted and len(jobs) < 4 * self.jobs:
                        taken |= wanted
                        jobs.append((self.root, self.root / source, commands[source], sorted(wanted)))
                if not jobs:  # headers that only users include
                    name = sorted(waiting)[0]
                    flags = commands['src/lot_ros/inlet.cpp' if '/ros' in name else 'src/transport/pool.cpp']
                    jobs = [(self.root, self.root / name, ['-x', 'c++', *flags], [name])]
                    taken = {name}
                for found in pool.map(analyse, jobs):
                    for name, mutants in found.items():
                        kept[name].write_bytes(pickle.dumps(mutants))
                        waiting.discard(name)
                        taken.discard(name)
                for name in taken:  # a unit that does not include it after all
                    for files in needed.values():
                        files.discard(name)

    def closure(self, sources):
        """The files of src/ and include/ that each source includes, as its text says."""
        own = {}

        def includes(name):
            if name not in own:
                own[name] = set()
                text = self.texts[name] if name in self.texts else read(self.root / name)
                for what in re.findall(r'^#\s*include\s+["<]([^">]+)[">]', text, re.M):
                    for place in ('src/', 'include/', os.path.dirname(name) + '/'):
                        path = os.path.normpath(place + what)
                        if path in self.texts:
                            own[name].add(path)
            return own[name]

        def all_of(name):
            found, todo = set(), [name]
            while todo:
                one = todo.pop()
                if one not in found:
                    found.add(one)
                    todo += includes(one)
            return found & set(self.texts)

        return {s: all_of(s) for s in sources}

    def number(self):
        """Numbers that stay when another file changes."""
        taken = {0}
        for name in self.code:
            slots = -(-len(self.mutants[name]) // SLOT) or 1
            at = zlib.crc32(name.encode()) % SLOTS
            while any((at + i) % SLOTS in taken or at + i >= SLOTS for i in range(slots)):
                at = (at + 1) % SLOTS
            taken |= {at + i for i in range(slots)}
            for i, mutant in enumerate(self.mutants[name]):
                mutant.number = at * SLOT + i

    # ---- writing and building -----------------------------------------------------------------

    def write(self):
        """The tree; only what is other than before is written."""
        ours = set(self.names) | {'include/lot_mutant.hpp'}
        for old in files_below(self.tree):
            if old not in ours:
                (self.tree / old).unlink()
        for name in self.names:
            if name not in self.texts:
                write_if_other(self.tree / name, (self.root / name).read_bytes())
                if os.access(self.root / name, os.X_OK):
                    (self.tree / name).chmod(0o755)
        write_if_other(self.tree / 'include' / 'lot_mutant.hpp', (HERE / 'lot_mutant.hpp').read_bytes())
        for name in self.code:
            self.write_one(name)

    def write_one(self, name):
        kept = [m for m in self.mutants[name] if m.key not in self.refused]
        text, self.places[name] = operators.write(self.texts[name], kept)
        first, _, rest = text.partition('\n')
        if not first.startswith('// SPDX'):
            raise RuntimeError(f'{name}: the first line is no comment')
        if kept:
            self.places[name] = [(b - len(first), e - len(first), m) for b, e, m in self.places[name]]
            text, first = '\n'.join(('#include <lot_mutant.hpp>', rest)), '#include <lot_mutant.hpp>'
            self.places[name] = [(b + len(first), e + len(first), m) for b, e, m in self.places[name]]
        write_if_other(self.tree / name, text.encode('latin-1'))

    def key(self, *more):
        """Of all that a result depends on."""
        names = [n for n in self.names if n.startswith(('src/', 'include/', 'tests/', 'cmake/', 'CMakeLists'))]
        return digest(*more, *[n + digest((self.root / n).read_bytes()) for n in names])

    def configure_once(self):
        if not (self.objects / 'build.ninja').exists():
            self.log('configure the mutated tree')
            self.configure(self.tree, self.objects, SETTINGS)
        else:  # again, if a test has come since
            subprocess.run(['ninja', '-C', self.objects, 'build.ninja'], stdout=subprocess.DEVNULL, check=True)

    def targets_of(self, tests):
        """What must be built for these tests."""
        known = set(re.findall(r'^([\w/]+): ', subprocess.run(
            ['ninja', '-C', self.objects, '-t', 'targets', 'all'], capture_output=True, text=True).stdout, re.M))
        targets = {name.removesuffix('_mutex') for name in tests}
        for name in tests:
            targets |= NEEDED.get(name.partition('_')[0], set())
        return sorted(targets & known)

    def build_once(self, targets):
        """Builds the targets; what the compiler says, if it refuses."""
        run = subprocess.run(['cmake', '--build', self.objects, '-j', str(self.jobs), '--target', *targets,
                              '--', '-k', '0'], capture_output=True, text=True)
        return '' if run.returncode == 0 else run.stdout + run.stderr

    def compile(self, targets):
        """Builds the targets; what the compiler refuses is taken out, and remembered."""
        self.log('build the mutated tree')
        for _ in range(40):
            said = self.build_once(targets)
            (self.build / 'build.log').write_text(said)
            if not said:
                return
            refused = self.blame(said)
            if not refused:
                raise RuntimeError(f'the mutated tree does not build:\n{said[-3000:]}')
            self.log(f'the compiler refuses {len(refused)} mutants')
            self.refused |= {m.key for m in refused}
            self.refused_file.write_text(json.dumps(sorted(self.refused), indent=0))
            for name in {m.file for m in refused}:
                self.write_one(name)
        raise RuntimeError('the compiler refuses mutants for ever')

    def blame(self, output):
        """The mutants at which the errors stand. An error in lot_mutant.hpp has notes that say where it
        comes from; what should be a constant expression, one that says where the value is declared."""
        errors = []
        for path, line, column, kind, text in ERROR.findall(output):
            place = os.path.relpath(os.path.join(self.objects, path), self.tree), int(line), int(column)
            if kind == 'error':
                errors.append([place])
            elif errors:
                errors[-1].insert(0 if text == 'declared here' else len(errors[-1]), place)
        return [m for places in errors
                for m in next(filter(None, (self.around(*place) for place in places)), [])]

    def around(self, name, line, column):
        """The innermost mutants around a place of the mutated file; else all of its line."""
        if name not in self.places:
            return []
        text = (self.tree / name).read_bytes().decode('latin-1')
        starts = [0] + [m.end() for m in re.finditer('\n', text)]
        if line > len(starts):
            return []
        offset = starts[line - 1] + column - 1
        holding = [(e - b, m) for b, e, m in self.places[name] if b <= offset < e]
        if holding:
            least = min(size for size, _ in holding)
            return [m for size, m in holding if size == least]
        end = starts[line] if line < len(starts) else len(text)
        return [m for b, e, m in self.places[name] if starts[line - 1] <= b < end]


def files_below(tree):
    if not tree.exists():
        return []
    return [str(p.relative_to(tree)) for p in tree.rglob('*') if p.is_file()]
