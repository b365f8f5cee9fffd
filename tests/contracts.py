#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Checks that the comments of the public headers are contracts.

    contracts.py [ROOT]       check include/lot of the tree at ROOT (default: this file's tree)
    contracts.py --self-test  plant mistakes in a scratch tree and see that each is found

doxygen reads the headers, with the settings of docs/Doxyfile, and this reads its XML. Namespaces
`detail`, and all that is private or protected, do not count.

1. Every public class, member, function, alias, constant, enum and enumerator has a comment.
   Needs none: a destructor; what is defaulted or deleted; a copy or move constructor or assignment;
   a comparison; an alias or type in lower case inside a class, whose name and meaning are the
   standard library's (`value_type`); a member of a specialisation, which its template prescribes.
2. A function that is not noexcept says what it throws: `Throws ...`, or a line `Errors: ...`.
3. A class has the four words, each at the begin of a line, in this order, with text behind it:
   Threads, Errors, Memory, Crash.
   Needs none: a struct of data alone (options); a trait, which has no data and only static
   functions; an exception, whose base is one of std's; a specialisation.
"""

import collections
import pathlib
import re
import subprocess
import sys
import tempfile
import xml.etree.ElementTree

DOXYFILE = pathlib.Path(__file__).resolve().parent.parent / 'docs' / 'Doxyfile'
WORDS = ('Threads', 'Errors', 'Memory', 'Crash')
COMPARISON = re.compile(r'operator\s*(==|!=|<|>|<=|>=|<=>)$')
SAYS_WHAT_IT_THROWS = re.compile(r'\b[Tt]hrows?\b|\bErrors:\s*\S')
STD_EXCEPTION = re.compile(r'std::(\w*_error|exception|bad_\w+)$')
OF_CLASSES = {'class', 'struct', 'union'}
KINDS = {'function': 'function', 'variable': 'member', 'typedef': 'alias', 'enum': 'enum',
         'friend': 'function', 'define': 'macro'}

Found = collections.namedtuple('Found', 'classes members complaints')


def text_of(element):
    """All of an element's comment, as one line."""
    parts = (element.find(part) for part in
             ('briefdescription', 'detaileddescription', 'inbodydescription'))
    return ' '.join(' '.join(part.itertext()) for part in parts if part is not None).strip()


def is_specialisation(name):
    return name.endswith('>')


def last_name(name):
    """'Loan' of 'lot::ros::Loan< M >'."""
    return re.sub(r'<.*', '', name).strip().split('::')[-1]


def is_internal(name):
    return 'detail' in re.sub(r'<.*', '', name).split('::')


def in_lower_case(name):
    return name == name.lower()


def is_copy_or_move(member, class_name):
    """A constructor or assignment from the class itself."""
    if member.findtext('name') not in (last_name(class_name), 'operator='):
        return False
    if member.find('templateparamlist') is not None:
        return False
    types = [''.join(p.find('type').itertext()) for p in member.findall('param')
             if p.find('type') is not None]
    own = last_name(class_name)
    return len(types) == 1 and re.sub(r'\bconst\b|&|\s', '', types[0]) == own and '&' in types[0]


def is_trivial(member, class_name):
    """Rule 1's exceptions."""
    name, arguments = member.findtext('name'), member.findtext('argsstring') or ''
    kind = member.get('kind')
    if class_name and is_specialisation(class_name):
        return True
    if kind == 'friend' and '(' not in arguments:
        return True
    if kind == 'typedef':
        return bool(class_name) and in_lower_case(name)
    if kind not in ('function', 'friend'):
        return False
    return (name.startswith('~') or bool(re.search(r'=\s*(default|delete)$', arguments))
            or bool(COMPARISON.match(name)) or (bool(class_name) and is_copy_or_move(member, class_name)))


def wants_words(compound):
    """Rule 3's exceptions."""
    name = compound.findtext('compoundname')
    if is_specialisation(name) or ('::' in name and in_lower_case(last_name(name))):
        return False
    if any(STD_EXCEPTION.search(base.text or '') for base in compound.findall('basecompoundref')):
        return False
    members = [m for m in compound.iter('memberdef') if m.get('kind') != 'friend']
    functions = [m for m in members if m.get('kind') == 'function' and m.get('static') != 'yes']
    if functions:
        return True
    data = [m for m in members if m.get('kind') == 'variable' and m.get('static') != 'yes']
    return bool(compound.findall('basecompoundref') and not in_lower_case(last_name(name))) or any(
        m.get('prot') != 'public' for m in data)


def comment_above(lines, line):
    """The lines of the comment above a declaration, without its slashes."""
    at = line - 2  # the line above
    while at >= 0 and not lines[at].lstrip().startswith('///') and re.match(r'\s*[\w<,]', lines[at]) \
            and not lines[at].rstrip().endswith((';', '}')):
        at -= 1  # template <...>
    end = at + 1
    while at >= 0 and lines[at].lstrip().startswith('///'):
        at -= 1
    return [text.strip()[3:].strip() for text in lines[at + 1:end]]


def missing_words(comment):
    """The words that a class lacks, or that are out of order, begin no line or have no text."""
    missing = []
    at = 0
    for word in WORDS:
        found = next((n for n in range(at, len(comment)) if re.match(rf'{word}:\s+\S', comment[n])), None)
        if found is None:
            missing.append(word)
        else:
            at = found + 1
    return missing


def place(element, root):
    """'include/lot/pusher.hpp:12'"""
    location = element.find('location')
    file = pathlib.Path(location.get('file'))
    if file.is_absolute() and root in file.parents:
        file = file.relative_to(root)
    return f'{file}:{location.get("line")}'


def check_member(member, class_name, scope):
    """Yields what is wrong with a public member."""
    if is_trivial(member, class_name):
        return
    text = text_of(member)
    name = f'{scope}::{member.findtext("name")}' if scope else member.findtext('name')
    kind = member.get('kind')
    if not text:
        yield member, f'{KINDS.get(kind, kind)} {name}{signature(member)} has no comment'
    elif kind in ('function', 'friend') and not is_noexcept(member) and not SAYS_WHAT_IT_THROWS.search(text):
        yield member, f'{name}{signature(member)} does not say what it throws'
    for value in member.findall('enumvalue'):
        if not text_of(value):
            yield member, f'{name}::{value.findtext("name")} has no comment'


def signature(member):
    return member.findtext('argsstring') or '' if member.get('kind') in ('function', 'friend') else ''


def is_noexcept(member):
    return member.get('noexcept') == 'yes' or 'noexcept' in (member.findtext('argsstring') or '')


def doxygen(root, out):
    """The compounds that doxygen finds in include/lot."""
    settings = DOXYFILE.read_text() + f'''
INPUT = include/lot
OUTPUT_DIRECTORY = "{out}"
GENERATE_HTML = NO
GENERATE_XML = YES
XML_PROGRAMLISTING = NO
WARNINGS = NO
WARN_AS_ERROR = NO
'''
    subprocess.run(['doxygen', '-'], input=settings, text=True, cwd=root, check=True,
                   stdout=subprocess.DEVNULL)
    for file in sorted((out / 'xml').glob('*.xml')):
        yield from xml.etree.ElementTree.parse(file).getroot().findall('compounddef')


def check(root):
    """What is there, and all complaints about it, as lines 'file:line: what'."""
    root = root.resolve()
    wrong = set()
    seen = set()
    classes = 0
    with tempfile.TemporaryDirectory() as scratch:
        compounds = list(doxygen(root, pathlib.Path(scratch)))
    hidden = {re.sub(r'<.*', '', c.findtext('compoundname')) for c in compounds
              if c.get('kind') in OF_CLASSES and c.get('prot') not in (None, 'public')}

    def is_hidden(name):
        parts = re.sub(r'<.*', '', name).split('::')
        return any('::'.join(parts[:n]) in hidden for n in range(1, len(parts) + 1))

    for compound in compounds:
        kind, name = compound.get('kind'), compound.findtext('compoundname')
        if kind not in OF_CLASSES | {'namespace', 'file'} or (kind != 'file' and is_internal(name)):
            continue
        is_class = kind in OF_CLASSES
        if is_class:
            if is_hidden(name):
                continue
            classes += 1
            text = text_of(compound)
            is_standard = '::' in name and in_lower_case(last_name(name)) and not is_specialisation(name)
            is_nested = any(name.startswith(other.findtext('compoundname') + '::')
                            for other in compounds if other.get('kind') in OF_CLASSES)
            if not text and not (is_standard and is_nested):
                wrong.add((place(compound, root), f'{kind} {name} has no comment'))
            elif wants_words(compound):
                location = compound.find('location')
                lines = (root / location.get('file')).read_text().splitlines()
                missing = missing_words(comment_above(lines, int(location.get('line'))))
                if missing:
                    wrong.add((place(compound, root),
                               f'{kind} {name} does not say {", ".join(missing)}'))
        for member in compound.iter('memberdef'):
            if member.get('prot') != 'public' or member.get('id') in seen:
                continue
            seen.add(member.get('id'))
            scope = '' if kind == 'file' else name
            for element, what in check_member(member, name if is_class else '', scope):
                wrong.add((place(element, root), what))
    order = sorted(wrong, key=lambda w: (w[0].rsplit(':', 1)[0], int(w[0].rsplit(':', 1)[1]), w[1]))
    return Found(classes, len(seen), [f'{at}: {what}' for at, what in order])


GOOD = '''
#pragma once
namespace lot {
/// An end.
enum class Status {
  Ok,   ///< it went well
  Full  ///< it did not
};
/// Failed.
class Broken : public std::runtime_error {
 public:
  /// With an errno. Throws std::bad_alloc.
  explicit Broken(int error);
};
/// What one may choose.
struct Options {
  int depth = 1;  ///< how many
  /// No limit.
  static constexpr int kAll = 0;
};
/// Specialise it.
template <class T>
struct Identity {
  /// Of the type. Throws std::bad_alloc.
  static const char* name();
};
/// That of a number.
template <>
struct Identity<int> {
  static const char* name();
};
/// Sends.
///
/// Threads: one at a time.
/// Errors:  lot::Broken.
/// Memory:  one page.
/// Crash:   nothing stays.
template <class T>
class Pusher {
  int hidden_here();

 public:
  using value_type = T;
  using pointer = T*;
  template <class U>
  struct rebind {
    using other = Pusher<U>;
  };
  Pusher() = default;
  Pusher(const Pusher& other);
  Pusher(Pusher&& other) noexcept;
  Pusher& operator=(const Pusher& other);
  ~Pusher();
  /// Sends it. Throws lot::Broken.
  Status push(const T& message);
  /// How many have been sent.
  int count() const noexcept;
  friend bool operator==(const Pusher& a, const Pusher& b);

 private:
  struct Inner {
    int one();
  };
  int two();
  int three_;
};
/// The same. Throws nothing.
int same(int a);
namespace detail {
struct Own {
  int member;
  int function();
};
int inner();
}  // namespace detail
}  // namespace lot
'''
HEAD = 'namespace lot {\n'
FOUR = '/// Threads: a.\n/// Errors: b.\n/// Memory: c.\n/// Crash: d.\n'
PLANTED = [  # its text, what must be complained about
    ('int f() noexcept;', 'function lot::f() noexcept has no comment'),
    ('/// Does it.\nint f();', 'lot::f() does not say what it throws'),
    ('/// Does it.\nint f() noexcept;\nint f(int) noexcept;', 'lot::f(int) noexcept has no comment'),
    ('// Not one of doxygen.\nint f() noexcept;', 'has no comment'),
    ('using Int = int;', 'alias lot::Int has no comment'),
    ('template <class T> using Same = T;', 'alias lot::Same has no comment'),
    ('template <class T> inline constexpr bool is_it = false;', 'member lot::is_it has no comment'),
    ('enum class E { A /**< a */ };', 'enum lot::E has no comment'),
    ('/// An E.\nenum class E { A, B /**< b */ };', 'lot::E::A has no comment'),
    ('struct S { int i; /**< an i */ };', 'struct lot::S has no comment'),
    ('/// An S.\nstruct S { int i; };', 'member lot::S::i has no comment'),
    ('/// An S.\nstruct S { static constexpr int kI = 1; };', 'member lot::S::kI has no comment'),
    ('/// A class.\nclass C { int i_; };', 'class lot::C does not say Threads, Errors, Memory, Crash'),
    ('/// A class.\nclass C : public std::vector<int> {};', 'does not say Threads'),
    ('/// A struct.\nstruct C {\n/// Does it. Throws nothing.\nint f(); };', 'does not say Threads'),
    ('/// A class.\n///\n' + FOUR.replace('Crash', 'Crush') + 'class C { int i_; };',
     'class lot::C does not say Crash'),
    ('/// A class.\n///\n' + FOUR.replace(': b.', ':') + 'class C { int i_; };',
     'class lot::C does not say Errors'),
    ('/// A class.\n///\n' + FOUR.replace('b.\n/// Memory', 'b. Memory') + 'class C { int i_; };',
     'class lot::C does not say Memory'),
    ('/// A class.\n///\n/// Crash: d.\n' + FOUR.replace('/// Crash: d.\n', '') + 'class C { int i_; };',
     'class lot::C does not say Crash'),
    (FOUR + 'class C { public:\nint f() noexcept; };', 'function lot::C::f() noexcept has no comment'),
    (FOUR + 'class C { public:\n/// Does it.\nint f(); };', 'lot::C::f() does not say what it throws'),
    (FOUR + 'class C { public:\nexplicit C(int) noexcept; };',
     'function lot::C::C(int) noexcept has no comment'),
    (FOUR + 'class C { public:\nC(int, const C&) noexcept; };', 'has no comment'),
    (FOUR + 'class C { public:\ntemplate <class U> C(const C<U>&) noexcept; };', 'has no comment'),
    (FOUR + 'class C { public:\nusing Int = int; };', 'alias lot::C::Int has no comment'),
    (FOUR + 'class C { public:\nstruct Inner { int i; /**< an i */ }; };',
     'struct lot::C::Inner has no comment'),
    (FOUR + 'class C { public:\nfriend int operator+(const C&, int) noexcept; };', 'has no comment'),
    ('}\nnamespace std {\ntemplate <>\nstruct hash<lot::Options> {};', 'has no comment'),
    ('}\nint f() noexcept;\nnamespace lot {', 'function f() noexcept has no comment'),
    ('}\n#define LOT_MACRO 1\nnamespace lot {', 'macro LOT_MACRO has no comment'),
]


def self_test():
    """Each planted mistake must be found, and alone; in a header of its own."""
    failures = []
    with tempfile.TemporaryDirectory() as scratch:
        root = pathlib.Path(scratch)
        (root / 'include/lot/ros').mkdir(parents=True)
        (root / 'include/lot/detail').mkdir()
        (root / 'include/lot/good.hpp').write_text(GOOD)
        (root / 'include/lot/detail/own.hpp').write_text('namespace lot::detail {\nint f();\n}\n')
        found = check(root)
        failures += [f'what is right is refused: {c}' for c in found.complaints]
        if found.classes != 6 or found.members == 0:
            failures.append(f'expected 6 classes, found {found.classes}, and {found.members} members')
        # All of them at once, in a namespace each: doxygen takes its time to start.
        for n, (text, _) in enumerate(PLANTED):
            (root / f'include/lot/ros/bad{n}.hpp').write_text(
                '#pragma once\n' + HEAD + text.replace('lot::', f'lot{n}::') + '\n}  // namespace lot\n')
            bad = root / f'include/lot/ros/bad{n}.hpp'
            bad.write_text(bad.read_text().replace('namespace lot {', f'namespace lot{n} {{'))
        complaints = check(root).complaints
        for n, (text, expected) in enumerate(PLANTED):
            mine = [c for c in complaints if f'/bad{n}.hpp:' in c]
            if len(mine) != 1 or expected not in mine[0].replace(f'lot{n}::', 'lot::'):
                failures.append(f'{text!r}: expected {expected!r}, got {mine}')
    return failures, 1 + len(PLANTED)


def main(arguments):
    if arguments == ['--self-test']:
        failures, count = self_test()
        print('\n'.join(failures + [f'contracts self-test: {count} cases, {len(failures)} failed']))
        return 1 if failures else 0
    root = pathlib.Path(arguments[0]) if arguments else pathlib.Path(__file__).parent.parent
    try:
        found = check(root)
    except (OSError, subprocess.CalledProcessError, xml.etree.ElementTree.ParseError) as error:
        print(f'contracts: {error}')
        return 1
    complaints = found.complaints
    if found.classes == 0:
        complaints = [f'{root}/include/lot: no public class found']
    print('\n'.join(complaints + [f'contracts: {found.classes} classes, {found.members} members, '
                                  f'{len(complaints)} wrong']))
    return 1 if complaints else 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
