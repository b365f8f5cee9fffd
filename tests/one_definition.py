#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Checks that the model explores what the library compiles: one definition of the protocol.

    one_definition.py --build DIR [ROOT]  check the tree at ROOT (default: where this file lies)
    one_definition.py --self-test         plant mistakes in a scratch tree, see each found

DIR is a build tree of Ninja in which lot and lot_model are built. Checked are
  - what the compiler read for the objects of both: each protocol header, from src/, and no other
    file of such a name;
  - every C++ file of the tree, and what those objects read besides: nobody else defines a template
    of these names, or anything in namespace lot that a protocol header defines;
  - every #include that names a protocol header: it leads to the one in src/ or include/;
  - the library, the model and the fuzzers: none of them changes a word of a block, a hold word, a
    writer word, a participant's state or the directory's version. The class of that word does
    (Ownership, HoldWord, WriterWord, ParticipantState, DirectoryVersion). The compiler refuses it,
    too, since the atomics are private bases; this says so of text that is not compiled, and of
    test::raw();
  - tests/proof/model, and its compiler's options: no macro stands for std, atomic or a memory order.
"""

import argparse
import os
import pathlib
import re
import shlex
import subprocess
import sys
import tempfile

MODULES = ('src/lockfree_ring/*.hpp', 'src/refcount/*.hpp', 'src/recovery/*.hpp',
         'src/robust_mutex/robust_condition.hpp', 'src/robust_mutex/lock_word.hpp',
         'src/segment/granules.hpp', 'src/segment/units.hpp', 'src/waiting/waiting.hpp',
         'src/selection/bounds.hpp', 'src/selection/selector.hpp',
         'include/lot/detail/hold_word.hpp', 'include/lot/detail/changed_by.hpp')
CLASSES = ('Ring', 'Writer', 'Reader', 'Cell', 'Ownership', 'BlockWords', 'Recovery', 'Granules', 'Units',
           'RobustCondition', 'LockWord', 'HoldWord', 'ChangedBy', 'WriterWord', 'ParticipantState',
           'DirectoryVersion', 'Steps', 'Bounds', 'Selector', 'Selection')
TARGETS = ('lot', 'lot_model')
SUFFIXES = {'.hpp', '.cpp', '.h', '.cc', '.hh', '.cxx', '.hxx', '.ipp', '.inc', '.in'}

NOISE = re.compile(r'//[^\n]*|/\*.*?\*/|"(?:[^"\\\n]|\\.)*"|(?<![\w])\'(?:[^\'\\\n]|\\.)+\'', re.S)
COMMENT = re.compile(r'//[^\n]*|/\*.*?\*/', re.S)
DIRECTIVE = re.compile(r'^[ \t]*#(?:[^\n]*\\\n)*[^\n]*', re.M)
INCLUDE = re.compile(r'^[ \t]*#[ \t]*(?:include|include_next|import)[ \t]*["<]([^">]+)[">]', re.M)
STANDARD = r'(?:std|atomic(?:_\w+)?|memory_order(?:_\w+)?|(?:compare_)?exchange(?:_\w+)?|fetch_\w+)'
DEFINE = re.compile(rf'^[ \t]*#[ \t]*define[ \t]+({STANDARD})\b', re.M)
PRETENCE = re.compile(r'\b(relacy/(?:relacy_std|stdlib/))')
CHANGE = re.compile(r'\b(hold|own|life|home|home_points|writer|channel_writer|participant_state|version)(?:_?\[[^][]*\]|\([^()]*\))?\)?\s*'
                    r'(?:\.|->)\s*(?:store|exchange|fetch_\w+|compare_exchange_\w+)\s*\(')
CHANGED_IN = ('src', 'include', 'fuzz', 'tests/proof/model')
TOKEN = re.compile(r'[A-Za-z_]\w*|::|\[\[|\]\]|->|[^\s\w]')


def blank(text):
    return re.sub(r'[^\n]', ' ', text)


def definitions(text):
    """(namespace, name, line, is a class template) of each class and function that is defined
    outside of functions and classes, and of each class template wherever it is."""
    text = NOISE.sub(lambda m: blank(m.group()), text)
    text = DIRECTIVE.sub(lambda m: blank(m.group()), text)
    scopes = []  # of the open braces: a namespace's names, or None
    head = []    # tokens since the last ; { or }, with their places
    for token in TOKEN.finditer(text):
        word = token.group()
        if word == '{':
            words = [t.group() for t in head]
            namespace = namespace_of(words)
            if namespace is not None:
                scopes.append(namespace)
            elif words.count('(') > words.count(')'):  # braces among a function's arguments
                scopes.append(())
            else:
                where = [name for scope in scopes if scope for name in scope]
                outside = None not in scopes
                yield from defined(head, words, where, outside, text)
                scopes.append(None)
            head = []
        elif word == '}':
            if scopes:
                scopes.pop()
            head = []
        elif word == ';':
            head = []
        elif word == ':' and [t.group() for t in head] in (['public'], ['private'], ['protected']):
            head = []
        else:
            head.append(token)


def namespace_of(words):
    """The names that `words {` opens, or None when it opens no namespace."""
    if words[:1] == ['extern'] and len(words) == 1:
        return ()
    if words[:1] == ['inline']:
        words = words[1:]
    if words[:1] != ['namespace']:
        return None
    return tuple(w for w in words[1:] if w not in ('::', 'inline'))


def behind(words, at, opening, end):
    """Behind the bracket that closes the one at `at`."""
    depth = 0
    for i in range(at, len(words)):
        depth += (words[i] == opening) - (words[i] == end)
        if depth == 0:
            return i + 1
    return len(words)


def class_name(words, at):
    """Where the names of `class A::B {` stand in `words` from `at` on; empty: not a class."""
    for key in range(at, len(words)):
        if words[key] not in ('class', 'struct', 'union'):
            continue
        i = key + 1
        while words[i:i + 1] in (['alignas'], ['[[']):
            i = (behind(words, i + 1, '(', ')') if words[i] == 'alignas'
                 else behind(words, i, '[[', ']]'))
        names = []
        while i < len(words) and re.fullmatch(r'\w+|::', words[i]):
            if words[i] not in ('::', 'final'):
                names.append(i)
            i += 1
        if words[i:i + 1] in ([], [':'], ['<']):
            return names
    return []


def defined(head, words, where, outside, text):
    """What `words {` defines in the namespace `where`."""
    at = 0
    while words[at:at + 1] == ['template']:
        at = behind(words, at + 1, '<', '>')
    template = at > 0
    names = class_name(words, at)
    if names:
        if not outside and not template:
            return
    elif outside and '(' in words[at:] and 'enum' not in words:
        template = False
        name = words.index('(', at) - 1
        if name < at or not re.match(r'[A-Za-z_]', words[name]) or '=' in words[at:name]:
            return
        if words[name - 1:name] == ['::']:  # a member
            return
        names = [name]
    if names:
        line = text.count('\n', 0, head[names[-1]].start()) + 1
        yield '::'.join([*where, *(words[n] for n in names[:-1])]), words[names[-1]], line, template


def protocol(root):
    """The headers, and what they define: {(namespace, name): header}."""
    headers = [h for module in MODULES for h in sorted(root.glob(module))]
    names = {}
    complaints = []
    for header in headers:
        for namespace, name, line, _ in definitions(header.read_text()):
            known = names.setdefault((namespace, name), header)
            if known != header or not f'{namespace}::'.startswith('lot::'):
                complaints.append(f'{header.relative_to(root)}:{line}: {namespace}::{name} is '
                                  f'defined in {known.relative_to(root)} already')
    for name in CLASSES:
        if name not in {n for _, n in names}:
            complaints.append(f'no protocol header defines {name}')
    return headers, names, complaints


def second_definitions(shown, text, names):
    for namespace, name, line, template in definitions(text):
        if (namespace, name) in names or (template and name in CLASSES):
            yield f'{shown}:{line}: a second definition of {name}'


def wrong_includes(root, file, text, headers):
    """Includes that name a protocol header and lead elsewhere."""
    own = {h.name for h in headers}
    for include in INCLUDE.finditer(COMMENT.sub(lambda m: blank(m.group()), text)):
        name = include.group(1)
        if pathlib.PurePosixPath(name).name not in own:
            continue
        found = next((p.resolve() for p in (b / name for b in (file.parent, root / 'src', root / 'include', root))
                      if p.is_file()), None)
        if found not in headers:
            line = text.count('\n', 0, include.start(1)) + 1
            yield f'{file.relative_to(root)}:{line}: {name} is a copy of a protocol header'


def changes(root, file, text):
    """Statements that change a word of a block, or a hold word."""
    text = COMMENT.sub(lambda m: blank(m.group()), text)
    for match in CHANGE.finditer(text):
        line = text.count('\n', 0, match.start(1)) + 1
        yield f'{file.relative_to(root)}:{line}: {match.group(1)} is changed outside of the class that owns it'


def pretences(root, file, text):
    """Macros and headers that make something else of the standard's atomics."""
    text = COMMENT.sub(lambda m: blank(m.group()), text)
    for pattern, why in ((DEFINE, 'a macro named'), (PRETENCE, 'includes')):
        for match in pattern.finditer(text):
            line = text.count('\n', 0, match.start(1)) + 1
            yield f'{file.relative_to(root)}:{line}: {why} {match.group(1)}'


def check_tree(root, files, headers, names):
    for file in files:
        if file.suffix not in SUFFIXES or file in headers or not file.is_file():
            continue
        text = file.read_text(errors='replace')
        yield from second_definitions(file.relative_to(root), text, names)
        yield from wrong_includes(root, file, text, headers)
        if any(file.is_relative_to(root / folder) for folder in CHANGED_IN):
            yield from changes(root, file, text)
        if file.is_relative_to(root / 'tests' / 'proof' / 'model'):
            yield from pretences(root, file, text)


def files_of(root):
    listed = subprocess.run(
        ['git', 'ls-files', '-z', '--cached', '--others', '--exclude-standard'],
        cwd=root, check=True, capture_output=True, text=True).stdout
    return [root / name for name in sorted(set(listed.split('\0'))) if name]


# ---- what the compiler read ---------------------------------------------------------------------


def ninja(build, *arguments):
    return subprocess.run(['ninja', '-C', str(build), *arguments], check=True,
                          capture_output=True, text=True).stdout


def objects_of(build, target):
    return [o for o in ninja(build, '-t', 'inputs', target).split()
            if o.endswith('.o') and f'/{target}.dir/' in '/' + o]


def read_for(build, target):
    """The files that the compiler read for a target's objects."""
    objects = objects_of(build, target)
    if not objects:
        raise ValueError(f'{build}: {target} has no objects')
    files = set()
    known = set()
    for line in ninja(build, '-t', 'deps', *objects).splitlines():
        if line.startswith('    '):
            files.add(pathlib.Path(os.path.realpath(build / line.strip())))
        elif line.endswith('(VALID)'):
            known.add(line.partition(':')[0])
    missing = sorted(set(objects) - known)
    if missing:
        raise ValueError(f'{build}: {target} is not built: {missing[0]}')
    return files


def check_read(root, headers, names, read):
    """`read`: {target: files}."""
    own = {h.name for h in headers}
    for target, files in read.items():
        for header in sorted(set(headers) - files):
            yield f'{target} does not compile {header.relative_to(root)}'
        for file in sorted(files - set(headers)):
            ours = file.is_relative_to(root)
            if file.name in own and (ours or f'{file.parent.name}/{file.name}' in
                                     {f'{h.parent.name}/{h.name}' for h in headers}):
                yield f'{target} compiles {file}, a copy of a protocol header'
            if not file.is_relative_to('/usr') and file.is_file():
                yield from second_definitions(f'{target} compiles {file}',
                                              file.read_text(errors='replace'), names)


def check_options(build, objects):
    """Macros on the compiler's command line."""
    for line in ninja(build, '-t', 'commands', *objects).splitlines():
        for word in shlex.split(line):
            if re.fullmatch(rf'-D{STANDARD}(?:[=(].*)?', word):
                yield f'lot_model is compiled with {word}'


def check(root, build, files):
    headers, names, complaints = protocol(root)
    complaints += check_tree(root, files, headers, names)
    if not complaints:
        complaints += check_read(root, headers, names, {t: read_for(build, t) for t in TARGETS})
        complaints += check_options(build, objects_of(build, 'lot_model'))
    return complaints


# ---- self-test ----------------------------------------------------------------------------------

GOOD = {
    'src/lockfree_ring/ring.hpp': '''
namespace lot::ring {
template <class P> struct alignas(P::kLine) Cell { int position; };
template <class P> struct Ring { Cell<P>* cells; };
template <class P> class Writer { public: template <class T> struct A {}; int f() { return 1; } };
template <class P> class Reader {};
template <class P> class WriterWord {}; template <class P> class DirectoryVersion {};
template <class R> bool announce(R& r) { return r.go([] { return 1; }); }
inline int make(int a) { return a; }
}
''',
    'src/refcount/ownership.hpp': '''#include "lockfree_ring/ring.hpp"
#include "lot/detail/changed_by.hpp"
#include "lot/detail/hold_word.hpp"
namespace lot { namespace refcount {
template <class P> struct BlockWords {}; template <class P> struct Ownership {};
template <class P> class ParticipantState {};
} }
''',
    'src/recovery/recovery.hpp': '''#include "refcount/ownership.hpp"
#include "robust_mutex/lock_word.hpp"
#include "robust_mutex/robust_condition.hpp"
#include "segment/units.hpp"
#include "waiting/waiting.hpp"
#include "selection/selector.hpp"
namespace lot::recovery { template <class P, class World> class Recovery {}; }
''',
    'src/robust_mutex/robust_condition.hpp': '''
namespace lot { template <class W = int> class RobustCondition {}; }
''',
    'src/robust_mutex/lock_word.hpp': '''
namespace lot::lock { template <class P> class LockWord {}; }
''',
    'src/segment/granules.hpp': '''
namespace lot::segment { template <class P> class Granules {}; }
''',
    'src/segment/units.hpp': '''#include "segment/granules.hpp"
namespace lot::segment { template <class P> class Units {}; }
''',
    'include/lot/detail/hold_word.hpp': '''
namespace lot::refcount { template <class P> struct Ownership; }
namespace lot::detail { template <class A> class HoldWord {}; }
''',
    'include/lot/detail/changed_by.hpp': '''
namespace lot::detail { template <class A, class O> class ChangedBy {}; }
''',
    'src/waiting/waiting.hpp': '''
namespace lot::waiting { template <class Waiter> struct Steps {}; }
''',
    'src/selection/bounds.hpp': '''
namespace lot::selection { template <class P> struct Bounds {}; }
''',
    'src/selection/selector.hpp': '''#include "selection/bounds.hpp"
namespace lot::selection { template <class P> class Selector {}; template <class P> class Selection {}; }
''',
    'src/lot.cpp': '''#include "recovery/recovery.hpp"
namespace lot { template <class P> class Forward; }
namespace lot::ring { template <class P> class Reader; int ready() { return make(2); } }
''',
    'tests/proof/model/relacy.hpp': '#undef memory_order_relaxed\n',
    'tests/proof/model/model.cpp': '''#include "relacy.hpp"
#include "recovery/recovery.hpp"
namespace lot::model {
using Ring = lot::ring::Ring<int>;
// template <class P> class Writer {};
class Test { struct Ring { int n; }; Ring r{1}; };
struct Reader {};
template <class Writer> int take(Writer) { return 0; }
int announce() { return 0; }
}
int main() {}
''',
}
PLANTED = [  # file, its text, what must be complained about
    ('tests/proof/model/bad.hpp', 'namespace lot::ring {\ntemplate <class P>\nclass Writer {};\n}\n',
     'tests/proof/model/bad.hpp:3: a second definition of Writer'),
    ('tests/bad.cpp', 'namespace lot::test { namespace { template <class P> struct Ring {}; } }\n',
     'second definition of Ring'),
    ('tests/bad.cpp', 'namespace lot {\nnamespace ring { struct Reader { int a; }; } }\n',
     'tests/bad.cpp:2: a second definition of Reader'),
    ('fuzz/bad.hpp', 'template <> class lot::segment::Granules<int> final : Base {};\n',
     'second definition of Granules'),
    ('fuzz/bad.hpp', 'struct A { template <class P> struct alignas(64) Cell {}; };\n',
     'second definition of Cell'),
    ('src/bad.hpp',
     'namespace lot::x { template <class P> requires (A<P>) struct BlockWords : B {}; }\n',
     'second definition of BlockWords'),
    ('src/bad.hpp', 'namespace lot::transport { template <class A> struct HoldWord {}; }\n',
     'second definition of HoldWord'),
    ('src/bad.hpp', 'namespace lot::ring { template <class R> bool announce(R&) { return 0; } }\n',
     'second definition of announce'),
    ('src/recovery/bad.hpp', 'namespace lot::ring { inline int make(int) { return 1; } }\n',
     'make is defined in src/lockfree_ring/ring.hpp already'),
    ('tests/proof/model/bad.cpp', '#include "copy/recovery.hpp"\n', 'bad.cpp:1: copy/recovery.hpp'),
    ('tests/proof/model/bad.cpp', '\n#  include <ring.hpp>\n', 'bad.cpp:2: ring.hpp is a copy'),
    ('src/bad.cpp', 'void f(Cell& c) {\n  c.hold.fetch_sub(1, std::memory_order_acq_rel);\n}\n',
     'src/bad.cpp:2: hold is changed outside of the class that owns it'),
    ('src/bad.cpp', 'void f(W& w) { w.own[0].fetch_and(~1); }\n', 'own is changed outside'),
    ('src/bad.cpp', 'void f(W* w) { w->life .store (1); }\n', 'life is changed outside'),
    ('include/lot/bad.hpp', 'inline void f(W& w) { w.home.compare_exchange_strong(a, b); }\n',
     'home is changed outside'),
    ('tests/proof/model/bad.cpp', 'void f() { hold(b).fetch_add(1); }\n', 'hold is changed outside'),
    ('tests/proof/model/bad.cpp', 'void f() { raw(home_hold); hold_(b); raw(x.hold).store(1); }\n',
     'hold is changed outside'),
    ('fuzz/bad.cpp', 'void f(W& w) { w.home_points.exchange(1); }\n', 'home_points is changed'),
    ('src/bad.cpp', 'void f(Entry& e) { e.writer.store(0); }\n', 'writer is changed outside'),
    ('tests/proof/model/bad.cpp', 'void f() { raw(participant_state(k)).exchange(1); }\n',
     'participant_state is changed outside'),
    ('tests/proof/model/bad.hpp', '#define std rl\n', 'tests/proof/model/bad.hpp:1: a macro named std'),
    ('tests/proof/model/bad.hpp', '\n# define memory_order_acquire 0\n',
     'bad.hpp:2: a macro named memory_order_acquire'),
    ('tests/proof/model/bad.hpp', '#define atomic(x) rl::atomic<x>\n', 'a macro named atomic'),
    ('tests/proof/model/bad.hpp', '#include <relacy/relacy_std.hpp>\n', 'includes relacy/relacy_std'),
]
BUILD = '''
rule cc
  command = g++ -std=c++20 -Isrc -Iinclude $flags -MD -MF $out.d -c $in -o $out
  deps = gcc
  depfile = $out.d
rule link
  command = cp $in $out
build CMakeFiles/lot.dir/src/lot.o: cc {lot}
build liblot.a: link CMakeFiles/lot.dir/src/lot.o
build lot: phony liblot.a
build tests/CMakeFiles/lot_model.dir/model.o: cc {model}
  flags = {flags}
build lot_model: link tests/CMakeFiles/lot_model.dir/model.o
'''
BUILDS = [  # sources and flags of the model, what is built, what must be complained about
    ('tests/proof/model/model.cpp', '', ['lot', 'lot_model'], None),
    ('tests/proof/model/model.cpp', '', ['lot'], 'lot_model is not built'),
    ('other.cpp', '', ['lot', 'lot_model'], 'does not compile src/lockfree_ring/ring.hpp'),
    ('tests/proof/model/model.cpp', '-Iout', ['lot', 'lot_model'], 'a copy of a protocol header'),
    ('tests/proof/model/model.cpp', '-include out/same.hpp', ['lot', 'lot_model'],
     'second definition of Ring'),
    ('tests/proof/model/model.cpp', '-Dmemory_order_acquire=0', ['lot', 'lot_model'],
     'with -Dmemory_order'),
]


def self_test():
    """Each planted mistake must be found, and alone."""
    failures = []
    with tempfile.TemporaryDirectory(prefix='lot_one_definition_') as scratch:
        root = pathlib.Path(scratch).resolve()

        def write(name, text):
            (root / name).parent.mkdir(parents=True, exist_ok=True)
            (root / name).write_text(text)

        def complaints_about_the_tree():
            headers, names, complaints = protocol(root)
            files = [f for f in sorted(root.rglob('*')) if f.is_file()]
            return complaints + list(check_tree(root, files, headers, names))

        for name, text in GOOD.items():
            write(name, text)
        failures += [f'a right tree is refused: {c}' for c in complaints_about_the_tree()]
        for name, text, expected in PLANTED:
            write(name, text)
            complaints = complaints_about_the_tree()
            (root / name).unlink()
            if len(complaints) != 1 or expected not in complaints[0]:
                failures.append(f'{name} {text!r}: expected {expected!r}, got {complaints}')
        for name in CLASSES:
            header = next(n for n in GOOD if re.search(rf'\b{name}\b {{', GOOD[n]))
            write(header, re.sub(rf'\b{name}\b {{', 'Gone {', GOOD[header]))
            if complaints_about_the_tree() != [f'no protocol header defines {name}']:
                failures.append(f'{name} may vanish: {complaints_about_the_tree()}')
            write(header, GOOD[header])

        # Copies that the tree's files do not show: only the compiler's list does.
        write('other.cpp', 'int main() {}\n')
        write('out/recovery/recovery.hpp', '#include "../src/recovery/recovery.hpp"\n')
        write('out/same.hpp', 'namespace lot::x { template <class P> struct Ring {}; }\n')
        tree = [root / name for name in GOOD]
        for model, flags, built, expected in BUILDS:
            for name in ('.ninja_deps', '.ninja_log'):
                (root / name).unlink(missing_ok=True)
            write('build.ninja', BUILD.format(lot='src/lot.cpp', model=model, flags=flags)
                  .replace('-Isrc -Iinclude $flags', '$flags -Isrc -Iinclude'))
            ninja(root, *built)
            try:
                complaints = check(root, root, tree)
            except ValueError as error:
                complaints = [str(error)]
            if (complaints != [] if expected is None else
                    not any(expected in complaint for complaint in complaints)):
                failures.append(f'{model} {flags}: expected {expected!r}, got {complaints}')
    return failures, 1 + len(PLANTED) + len(CLASSES) + len(BUILDS)


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('root', nargs='?', type=pathlib.Path,
                        default=pathlib.Path(__file__).parent.parent)
    parser.add_argument('--build', type=pathlib.Path)
    parser.add_argument('--self-test', action='store_true')
    arguments = parser.parse_args()
    if arguments.self_test:
        failures, count = self_test()
        summary = f'one definition self-test: {count} cases, {len(failures)} failed'
        print(*failures, f'summary: {summary}', sep='\n')
        return 1 if failures else 0
    if not arguments.build:
        parser.error('--build is missing')
    root = arguments.root.resolve()
    try:
        complaints = check(root, arguments.build.resolve(), files_of(root))
    except (OSError, ValueError, subprocess.CalledProcessError) as error:
        complaints = [str(error)]
    print(*complaints, f'summary: one definition: {len(complaints)} wrong', sep='\n')
    return 1 if complaints else 0


if __name__ == '__main__':
    sys.exit(main())
