#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Builds the library and a program that uses all of it in each way that docs/building.md names, and runs them.

    builds.py --build DIR [--jobs N]   DIR: a build tree of g++ that has liblot.a
    builds.py --build DIR --self-test  plant mistakes and see that each is found

LOT_TEST_ONE_IN=N: one of each N libraries, programs and compilers, others with each LOT_TEST_SEED, which is printed.
Of PAIRS only those run whose programs are both in the share: some need all. A program without such a pair talks to
17-g++-12, both ways.

consumer.cpp is compiled by each compiler in C++17, 20 and 23, and run in C++17; by g++ 12 and clang 19 it is run in all
three, and without RTTI and without exceptions. The library is built as a shared one, with libc++, and with link-time
optimisation by both compilers. Programs of different builds then talk to each other.
"""

import argparse
import concurrent.futures
import os
import pathlib
import re
import secrets
import signal
import subprocess
import sys
import tempfile

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parent.parent
COMPILERS = ('g++-11', 'g++-12', 'clang++-14', 'clang++-16', 'clang++-19')
STANDARDS = {'17': 'c++17', '20': 'c++20', '23': 'c++2b'}
WARNINGS = ['-Wall', '-Wextra', '-Wpedantic', '-Werror']
NEVER_UNLOADED = ['-Wl,-z,nodelete', '-Wl,-Bsymbolic-functions']
LIBCXX = '-stdlib=libc++'
# name: (compiler, flags of library and program, options of CMake)
LIBRARIES = {
    'shared': ('g++-12', [], ['-DBUILD_SHARED_LIBS=ON']),
    'libc++': ('clang++-19', [LIBCXX], []),
    'lto-g++': ('g++-12', [], ['-DCMAKE_INTERPROCEDURAL_OPTIMIZATION=ON']),
    'lto-clang': ('clang++-19', [], ['-DCMAKE_INTERPROCEDURAL_OPTIMIZATION=ON']),
}
# name: (compiler, flags), C++17 if these do not say else, and with the library of g++
PROGRAMS = {
    **{f'17-{compiler}': (compiler, []) for compiler in COMPILERS},
    **{f'{short}-{compiler}': (compiler, [f'-std={STANDARDS[short]}'])
       for compiler in ('g++-12', 'clang++-19') for short in ('20', '23')},
    **{f'{short}-{compiler}': (compiler, flags)
       for compiler in ('g++-12', 'clang++-19')
       for short, flags in (('no-rtti', ['-fno-rtti']), ('no-exceptions', ['-fno-exceptions']),
                            ('neither', ['-fno-rtti', '-fno-exceptions']))},
}
REFERENCE = '17-g++-12'  # in every share
# which publisher, which reader
PAIRS = (('no-rtti-g++-12', '17-clang++-19'), ('20-g++-12', '23-clang++-19'), ('17-g++-11', 'neither-clang++-19'), ('neither-g++-12', 'no-rtti-clang++-19'),
         ('shared', '17-g++-12'), ('17-clang++-14', 'shared'), ('libc++', 'libc++'), ('lto-g++', 'lto-clang'),
         ('lto-clang', '17-g++-12'))
WRONG_TYPE = 'lot: /wrong: the topic carries example/Named'


class Wrong(Exception):
    """What is not as it should be."""


PATIENCE = 1800  # seconds; a watchdog: this may run at the lowest priority, beside other builds


def run(command, seconds=PATIENCE, **more):
    """Its output, or Wrong."""
    done = subprocess.run([str(word) for word in command], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                          stderr=subprocess.STDOUT, text=True, errors='replace', timeout=seconds, check=False, **more)
    if done.returncode != 0:
        raise Wrong(f'status {done.returncode}: {" ".join(map(str, command))}\n{done.stdout}')
    return done.stdout


def segment(name):
    """The environment of a program that has a segment of its own."""
    prefix = os.environ.get('LOT_SEGMENT', 'lot_builds')
    return {**os.environ, 'LOT_SEGMENT': f'{prefix}_{os.getpid()}_{re.sub("[^a-z0-9]", "_", name)}'}


class Builds:
    """The programs and libraries of one run, in a scratch folder."""

    def __init__(self, scratch, archive):
        self.scratch = scratch
        self.archive = archive

    # ---- building ----

    def compile(self, compiler, flags, source=HERE / 'consumer.cpp'):
        """Only looks whether the compiler takes it."""
        run([compiler, *flags, *WARNINGS, f'-I{ROOT}/include', '-fsyntax-only', source])

    def program(self, name, compiler, flags, libraries=None):
        """Compiles and links the consumer; the library is the given flags, or the archive of g++."""
        libraries = libraries or [self.archive, '-pthread', '-lrt', *NEVER_UNLOADED]
        run([compiler, '-std=c++17', *WARNINGS, *flags, f'-I{ROOT}/include', HERE / 'consumer.cpp', *libraries,
             '-o', self.scratch / name])

    def make_library(self, name):
        """Builds and installs the library, and links the consumer with what its lot.pc says."""
        compiler, flags, options = LIBRARIES[name]
        tree, prefix = self.scratch / f'{name}.tree', self.scratch / f'{name}.prefix'
        run(['cmake', '-S', ROOT, '-B', tree, '-G', 'Ninja', '-DCMAKE_BUILD_TYPE=Release', '-DCMAKE_CXX_FLAGS_RELEASE=-O1',
             f'-DCMAKE_CXX_COMPILER={compiler}', f'-DCMAKE_CXX_FLAGS={" ".join(flags)}', '-DCMAKE_UNITY_BUILD=ON',
             '-DLOT_BUILD_TESTS=OFF', '-DLOT_BUILD_BENCH=OFF', '-DLOT_BUILD_EXAMPLES=OFF', '-DLOT_BUILD_TOOL=OFF',
             '-DLOT_BUILD_ROS=OFF', '-DLOT_LIBRARY_UNITY=ON', *options])
        run(['cmake', '--build', tree])
        run(['cmake', '--install', tree, '--prefix', prefix])
        pc = next(prefix.rglob('lot.pc'))
        libraries = run(['pkg-config', '--libs', 'lot'], env={**os.environ, 'PKG_CONFIG_PATH': str(pc.parent)}).split()
        if 'INTERPROCEDURAL' in ''.join(options):
            if compiler.startswith('clang'):
                flags = [*flags, '-O1', '-flto=thin', '-fuse-ld=lld-19']
            else:  # it warns of libstdc++ when it looks at the whole program
                flags = [*flags, '-O1', '-flto=auto', '-Wno-error']
        if name == 'shared':
            self.check_shared(pc.parent.parent / 'liblot.so')
            libraries.append(f'-Wl,-rpath,{pc.parent.parent}')
        self.program(name, compiler, flags, libraries)

    # ---- looking ----

    def check_shared(self, library):
        """Its name, what it exports, and that it is not unloaded."""
        dynamic = run(['readelf', '-dW', library])
        for words in ('Library soname: [liblot.so.0.1]', 'NODELETE'):
            if words not in dynamic:
                raise Wrong(f'{library} does not say {words}')
        complain_of_exports(run(['nm', '-DC', '--defined-only', library]))

    def refused(self, compiler, flags, text):
        """The compiler refuses cast.cpp, with that text."""
        try:
            self.compile(compiler, ['-std=c++17', *flags], HERE / 'cast.cpp')
        except Wrong as wrong:
            if text in str(wrong):
                return
            raise
        raise Wrong(f'{compiler} {flags} has accepted cast.cpp')

    def everything(self, name):
        """All of the interface, in one process."""
        if run([self.scratch / name], 120, env=segment(name)) != 'ok\n':
            raise Wrong(f'{name} has not said ok')

    def names(self, name, expected):
        """What the program calls its types is what the others call them."""
        found = run([self.scratch / name, 'names'])
        if found != expected:
            raise Wrong(f'{name} calls its types\n{found}and others call them\n{expected}')

    def dies(self, name, role='wrong'):
        """An error that is not caught ends the process, and its text is on stderr."""
        done = subprocess.run([self.scratch / name, role], env=segment(f'{name}_{role}'), capture_output=True, text=True,
                              timeout=60, check=False)
        if done.returncode != -signal.SIGABRT or WRONG_TYPE not in done.stderr:
            raise Wrong(f'{name} {role}: status {done.returncode}, stderr: {done.stderr}')

    def pair(self, publisher, reader, role='subscribe', publishes='publish'):
        """What one program publishes the other reads."""
        environment = segment(f'{publisher}_{reader}')
        with subprocess.Popen([self.scratch / publisher, publishes], env=environment, stdout=subprocess.PIPE,
                              text=True) as sender:
            try:
                if sender.stdout.readline() != 'ready\n':
                    raise Wrong(f'{publisher} has not begun to publish')
                run([self.scratch / reader, role], 120, env=environment)
                if sender.wait(60) != 0:
                    raise Wrong(f'{publisher}: status {sender.returncode} as the publisher for {reader}')
            finally:
                sender.kill()

    def strangers(self, publisher, reader):
        """A plain message of another standard library is read, one with containers is refused."""
        self.pair(publisher, reader, 'subscribe_plain', 'publish_plain')
        try:
            self.pair(publisher, reader)
        except Wrong as wrong:
            if 'lot: /pair: the topic carries consumer::Frame' in str(wrong):
                return
            raise
        raise Wrong(f'{reader} reads what {publisher} has laid out otherwise')


def complain_of_exports(symbols):
    """Wrong, where a shared library exports what is not of its interface."""
    lines = symbols.splitlines()
    ours = re.compile(r'(typeinfo (name )?for |vtable for |(non-)?virtual thunk to )?lot::([A-Z]|detail::|to_string|end_cleanly|stop_on_signals)|lot_\w+@@|LIBLOT_')
    wrong = [line for line in lines if not ours.match(line[19:])]
    if wrong or len(lines) < 50:
        raise Wrong(f'{len(lines)} symbols are exported, among them\n' + '\n'.join(wrong))


def in_parallel(jobs, steps):
    """Runs (name, function) pairs, and returns what went wrong."""
    complaints = []
    with concurrent.futures.ThreadPoolExecutor(jobs) as pool:
        running = {pool.submit(step): name for name, step in steps}
        for done in concurrent.futures.as_completed(running):
            try:
                done.result()
            except (Wrong, subprocess.TimeoutExpired) as wrong:
                complaints.append(f'{running[done]}: {wrong}')
    return complaints


class Share:
    """One of each `shares` things, by the seed."""

    def __init__(self, shares, seed):
        self.shares = shares
        self.seed = seed

    def of(self, things):
        things = list(things)
        return [thing for i, thing in enumerate(things) if i % self.shares == self.seed % min(self.shares, len(things))]


def share_of_environment():
    shares = int(os.environ.get('LOT_TEST_ONE_IN', 1))
    seed = int(os.environ.get('LOT_TEST_SEED', secrets.randbelow(1 << 32)))
    print(f'seed: LOT_TEST_SEED={seed}')
    return Share(shares, seed)


def matrix(builds, jobs, share):
    """Builds a share of all, then runs what was built."""
    libraries = share.of(LIBRARIES)
    programs = [name for name in PROGRAMS if name == REFERENCE or name in share.of(PROGRAMS)]
    build = [(f'library {name}', lambda n=name: builds.make_library(n)) for name in libraries]
    build += [(f'program {name}', lambda n=name: builds.program(n, *PROGRAMS[n])) for name in programs]
    looks = [(f'{compiler} C++{short}', lambda c=compiler, s=standard: builds.compile(c, [f'-std={s}']))
              for compiler in COMPILERS for short, standard in STANDARDS.items() if f'{short}-{compiler}' not in PROGRAMS]
    looks += [(f'clang++-19 libc++ C++{short}', lambda s=standard: builds.compile('clang++-19', [LIBCXX, f'-std={s}']))
              for short, standard in STANDARDS.items() if short != '17']
    looks += [(f'{compiler} cast', lambda c=compiler: builds.refused(c, ['-fno-rtti'], 'dynamic_pointer_cast needs RTTI'))
              for compiler in COMPILERS]
    build += share.of(looks)
    complaints = in_parallel(jobs, build)
    if complaints:
        return complaints, len(build)
    built = [*programs, *libraries]
    expected = run([builds.scratch / REFERENCE, 'names'])
    work = [(f'{name}: everything', lambda n=name: builds.everything(n)) for name in built]
    work += [(f'{name}: names', lambda n=name: builds.names(n, expected))
             for name in built if name != 'libc++']
    work += [(f'{name}: wrong', lambda n=name: builds.dies(n))
             for name in built if not name.startswith(('17', 'no-rtti'))]
    pairs = [pair for pair in PAIRS if set(pair) <= set(built)]
    pairs += [pair for name in built if name not in (REFERENCE, 'libc++') and not any(name in pair for pair in pairs)
              for pair in ((name, REFERENCE), (REFERENCE, name))]
    work += [(f'{publisher} to {reader}', lambda p=publisher, r=reader: builds.pair(p, r)) for publisher, reader in pairs]
    if 'libc++' in built:
        work += [(f'{REFERENCE} to libc++', lambda: builds.strangers(REFERENCE, 'libc++'))]
    return in_parallel(jobs, work), len(build) + len(work)


def self_test(builds):
    """Each check complains of a mistake."""
    planted = builds.scratch / 'planted.cpp'
    planted.write_text('#include <lot/lot.hpp>\nint main() { int unused; }\n')
    builds.program('good', 'g++-12', [])
    builds.program('other', 'g++-12', ['-DHidden=Seen'])
    expected = run([builds.scratch / 'good', 'names'])
    exports = '0000000000012340 T lot::detail::name()@@LIBLOT_0.1\n' * 60
    complain_of_exports(exports)
    complain_of_exports(exports + '0000000000012340 T lot_engine_open@@LIBLOT_0.1\n')
    mistakes = {
        'a warning': lambda: builds.compile('g++-12', ['-std=c++17'], planted),
        'a cast that is accepted': lambda: builds.refused('g++-12', [], 'needs RTTI'),
        'a cast that is refused for another reason': lambda: builds.refused('g++-12', ['-fno-rtti'], 'no such text'),
        'a program that fails': lambda: builds.everything('no-such-program'),
        'another name of a type': lambda: builds.names('other', expected),
        'an error that does not end the process': lambda: builds.dies('good', 'everything'),
        'a reader that fails': lambda: builds.pair('good', 'good', 'nonsense'),
        'a reader of another type': lambda: builds.pair('good', 'other'),
        'strangers that meet': lambda: builds.strangers('good', 'good'),
        'a static library for a shared one': lambda: builds.check_shared(builds.archive),
        'a symbol that is not of the interface': lambda: complain_of_exports(exports + '0000000000012340 T helper()\n'),
        'no symbols': lambda: complain_of_exports(''),
    }
    failures = []
    for name, step in mistakes.items():
        try:
            step()
            failures.append(f'not found: {name}')
        except (Wrong, OSError):
            pass
    for shares in 1, 4, len(PROGRAMS) + 1:
        for things in LIBRARIES, PROGRAMS:
            seen = [Share(shares, seed).of(things) for seed in range(min(shares, len(things)))]
            if sorted(name for share in seen for name in share) != sorted(things):
                failures.append(f'{shares} shares have not each of {", ".join(things)} once')
    return failures, len(mistakes)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--build', type=pathlib.Path, required=True)
    parser.add_argument('--jobs', type=int, default=os.cpu_count())
    parser.add_argument('--self-test', action='store_true')
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix='lot_builds.') as scratch:
        builds = Builds(pathlib.Path(scratch), options.build.resolve() / 'liblot.a')
        try:
            complaints, count = self_test(builds) if options.self_test else matrix(builds, options.jobs, share_of_environment())
        finally:
            own = segment('')['LOT_SEGMENT']
            for file in pathlib.Path('/dev/shm').glob(f'{own}*'):  # of programs that have died
                file.unlink()
    print('\n'.join([*complaints, f'builds{" self-test" if options.self_test else ""}: {count} steps, '
                                  f'{len(complaints)} failed']))
    return 1 if complaints else 0


if __name__ == '__main__':
    sys.exit(main())
