#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Checks that every memory order has its reason, and docs/edges.md against the code.

    edges.py [ROOT]       check src/ and include/ of the tree at ROOT (default: this file's tree)
    edges.py --self-test  plant mistakes in a scratch tree and see that each is found

1. Each atomic step with a memory order cites an edge, or has a reason: two words or more on the
   lines of its statement, or a comment above that names the order and says why. Above is directly
   above the statement, or, for a reason, with code between and no empty line; or in the same way
   above a block or function that the step is in. "As above" refers to any comment of the function before it.
2. No atomic step goes without an order, which would be seq_cst: x.load(), ++x, x = 1, if (x).
   (For the operators the names count that the file, or its header, declares as atomics.)
3. A label that a comment cites stands in docs/edges.md, once.
4. An edge of docs/edges.md is cited on both sides, each time at a step with the order that its row
   says, in a file that the row or its section names. A row that says none means release or stronger
   on the left, acquire or stronger on the right. Where a cell names a function (`A::f`, `f()`, or
   "in `f`"), the edge is cited in that function. A side of the kernel's is left out.

A label is a letter and a number, or a word; a word is cited as `edge "state"`. I1, A1 and so on are
no edges, but invariants that a file lists in its first comment.
"""

import bisect
import dataclasses
import pathlib
import re
import sys
import tempfile

sys.path.insert(0, str(pathlib.Path(__file__).parent / 'proof' / 'mutation'))
import sites  # noqa: E402

STRING = re.compile(r'"(?:[^"\\\n]|\\.)*"|\'(?:[^\'\\\n]|\\.)\'')
COMMENT = re.compile(r'//[^\n]*|/\*.*?\*/', re.S)
DIRECTIVE = re.compile(r'^[ \t]*#[^\n]*', re.M)
TYPE = re.compile(r'\s*(?:template\s*<.*>\s*)?(?:inline\s+)?(?:namespace|class|struct|union|enum)\b', re.S)
METHOD = re.compile(r'(?:\.|->)\s*(load|store|exchange|test_and_set|fetch_\w+|compare_exchange_\w+)\s*\(')
FENCE = re.compile(r'\batomic_(?:thread|signal)_fence\s*\(')
ORDER = re.compile(r'\bmemory_order(?:_|::)(\w+)')
DECLARED = re.compile(r'\b(?:std::atomic|Atomic)\s*<[^;{}()<>]*(?:<[^<>]*>)?[^;{}()<>]*>\s+(\w+)\s*(?:[;{=\[,]|$)',
                      re.M)
PLAIN = re.compile(r'^(?![^\n]*[aA]tomic)(?![ \t]*(?:return|throw|delete|using|else)\b)[ \t]*(?:const |mutable |static |inline )*[\w:]+(?:<[^;()]*>)?[*&]* (\w+)(?:;|\{| =)', re.M)
LABEL = re.compile(r'(?<![\w.+-])([B-HJ-Z]\d{1,2})(?![\w.+-]*\w)')
NAMED = re.compile(r'\b[Ee]dges? "(\w+)"(?:(?:,| and) "(\w+)")?')
ROW = re.compile(r'^\| *([A-Z]\d{1,2}|[a-z]+)( sc)? *\|(.*)\|(.*)\|(.*)\|$')
HEADING = re.compile(r'^## (.*)$')
REFERENCE = re.compile(r'\b(?:as|see) above\b', re.I)
SAYS = {  # what names an order in a comment
    'relaxed': r'relaxed',
    'consume': r'consume',
    'acquire': r'acqui',
    'release': r'releas',
    'acq_rel': r'acq_rel|acqui|releas',
    'seq_cst': r'seq_cst|sequentially',
}
STRENGTH = {  # what a side of an edge may be, by the word in its cell
    'relaxed': {'relaxed', 'acquire', 'release', 'acq_rel', 'seq_cst'},
    'release': {'release', 'acq_rel', 'seq_cst'},
    'acquire': {'acquire', 'acq_rel', 'seq_cst'},
    'acq_rel': {'acq_rel', 'seq_cst'},
    'sc': {'seq_cst'},
}


@dataclasses.dataclass
class Step:
    """An atomic step: the line where it begins, its orders, and what its comments say."""
    line: int
    orders: tuple
    function: str
    beside: str  # comments on the lines of its statement
    above: str  # comments above it, and above the blocks that it is in
    before: str  # comments of its function, up to the step

    def labels(self):
        return labels_in(self.beside) | labels_in(self.above)


@dataclasses.dataclass
class Edge:
    line: int
    sides: tuple  # (text of the cell, allowed orders) of the left and the right side
    files: tuple


def labels_in(text):
    return set(LABEL.findall(text)) | {n for m in NAMED.finditer(text) for n in m.groups() if n}


def blanked(text, pattern):
    return pattern.sub(lambda m: re.sub(r'[^\n]', ' ', m.group()), text)


class Source:
    """One file: its text without comments and strings, and the comments of each line."""

    def __init__(self, path, name):
        self.name = name
        text = path.read_text()
        # Strings first: one may have // in it. A comment may have one apostrophe, so it is kept.
        without_strings = re.sub(
            r'//[^\n]*|/\*.*?\*/|' + STRING.pattern,
            lambda m: m.group() if m.group().startswith('/') else '"' + ' ' * (len(m.group()) - 2) + '"',
            text, flags=re.S)
        self.code = blanked(blanked(without_strings, COMMENT), DIRECTIVE)
        self.starts = [0] + [m.end() for m in re.finditer('\n', text)]
        self.lines = self.code.split('\n')
        self.comments = [''] * (len(self.lines) + 1)
        for comment in COMMENT.finditer(without_strings):
            begin = self.line_of(comment.start())
            for n, part in enumerate(comment.group().split('\n')):
                self.comments[begin - 1 + n] += re.sub(r'^[\s/*<]+|\*/', ' ', part)
        self.bodies = sites.functions(self.code)
        self.blocks = self.pairs()

    def line_of(self, offset):
        return bisect.bisect_right(self.starts, offset)

    def pairs(self):
        """(begin, end) of each pair of braces."""
        found, stack = [], []
        for i, c in enumerate(self.code):
            if c == '{':
                stack.append(i)
            elif c == '}' and stack:
                found.append((stack.pop(), i))
        return found

    def statement(self, begin, end):
        """First and last line of the statement around code[begin:end]."""
        start = max(self.code.rfind(c, 0, begin) for c in ';{}') + 1
        while start < begin and self.code[start].isspace():
            start += 1
        stop = min((i for c in ';{}' if (i := self.code.find(c, end)) != -1), default=end)
        return self.line_of(start), self.line_of(stop)

    def above(self, line):
        """The comment above a line: directly, or with code between and no empty line."""
        text, is_direct = [], True
        at = line - 1
        while at > 0 and self.lines[at - 1].strip():
            code = self.lines[at - 1].strip()
            if code.endswith(('{', '}')) or code.startswith('}'):
                return ''  # another block
            is_direct = False
            at -= 1
        while at > 0 and not self.lines[at - 1].strip() and self.comments[at - 1]:
            text.insert(0, self.comments[at - 1])
            at -= 1
        # With code between, a label is of the statement that follows it.
        return ' '.join(text) if is_direct else NAMED.sub('', LABEL.sub('', ' '.join(text)))

    def step(self, begin, end, orders):
        first, last = self.statement(begin, end)
        beside = ' '.join(self.comments[first - 1:last])
        above = self.above(first)
        for opening, closing in self.blocks:
            if not opening < begin < closing:
                continue
            head, foot = self.statement(opening, opening)
            if TYPE.match(self.code, self.starts[head - 1], opening):
                continue  # its comment is about more than this step
            above += ' ' + ' '.join(self.comments[head - 1:foot]) + ' ' + self.above(head)
        inside = [b for b in self.bodies if b[0] < begin < b[1]]
        if not inside:
            return Step(self.line_of(begin), orders, '-', beside, above, '')
        body = max(inside)
        before = ' '.join(self.comments[self.line_of(body[0]) - 1:first - 1])
        return Step(self.line_of(begin), orders, body[2], beside, above, before)

    def steps(self):
        """Steps with an order, and (line, what is wrong) of orders that belong to none."""
        found, covered, wrong = [], set(), []
        for call in list(METHOD.finditer(self.code)) + list(FENCE.finditer(self.code)):
            opening = call.end() - 1
            end = sites.closing(self.code, opening)
            parts = sites.arguments(self.code[opening + 1:end])
            orders = [(p, m) for p in parts if (m := re.fullmatch(r'(?:std::)?' + ORDER.pattern, p))]
            if not orders:
                continue
            covered.update(opening + 1 + m.start() for m in ORDER.finditer(self.code[opening + 1:end]))
            begin = sites.receiver(self.code, call.start()) if call.re is METHOD else call.start()
            found.append(self.step(begin, end, tuple(m.group(1) for _, m in orders)))
        for order in ORDER.finditer(self.code):
            if order.start() not in covered:
                wrong.append((self.line_of(order.start()), 'an order of no atomic step'))
        return found, wrong

    def implicit(self, names):
        """(line, text) of steps without an order. `names`: of atomics."""
        found = []
        for call in METHOD.finditer(self.code):
            opening = call.end() - 1
            inside = self.code[opening + 1:sites.closing(self.code, opening)]
            if 'memory_order' in inside or re.search(r'\border\b|\bmo_\w+|\bsuccess\b', inside):
                continue
            receiver = self.code[sites.receiver(self.code, call.start()):call.start()]
            last = re.findall(r'\w+', re.sub(r'\[[^\]]*\]|\([^)]*\)', '', receiver))
            method = call.group(1)
            if method == 'load' and inside.strip() or not (last and last[-1] in names):
                continue
            found.append((self.line_of(call.start()), f'{receiver.strip()}.{method}()'))
        if names:
            # A name without an underscore may be a local variable, too.
            name = r'(?<![\w.>&])(?:(?:\w+(?:\.|->))+(?:NAMES)|(?:MEMBERS))\b'.replace(
                'NAMES', '|'.join(sorted(names))).replace(
                'MEMBERS', '|'.join(sorted(n for n in names if n.endswith('_'))) or '(?!)')
            for pattern in (rf'(?:^|[;{{}})(])\s*({name})\s*(?:=(?!=)|[-+|&^]=)', rf'(?:\+\+|--)\s*({name})',
                            rf'({name})\s*(?:\+\+|--)', rf'\b(?:if|while)\s*\(!?\s*({name})\s*(?:\)|&&|\|\|)',
                            rf'\breturn\s+!?({name})\s*;', rf'({name})\s*(?:==|!=|<(?!<)|>(?!>|\())',
                            rf'=\s*({name})\s*;', rf'(?:&&|\|\||!)\s*({name})(?!\s*(?:\.|->|\[|\())',
                            rf'({name})\s*(?:&&|\|\|)'):
                for use in re.finditer(pattern, self.code, re.M):
                    found.append((self.line_of(use.start(1)), use.group(1)))
        return found


def says_why(step, labels):
    """True when a comment gives the step's order its reason."""
    if any(label in labels for label in step.labels()):
        return True
    if len(re.findall(r'\w+', REFERENCE.sub('', step.beside))) > 1:
        return True
    above = step.above + (' ' + step.before if REFERENCE.search(step.beside) else '')
    named = re.search(SAYS[step.orders[0]], above, re.I)
    return named is not None and len(re.findall(r'\w+', above)) > 2


def read_edges(page):
    """{label: Edge}, and complaints."""
    edges, complaints, files = {}, [], ()
    for n, line in enumerate(page.read_text().splitlines(), 1):
        heading = HEADING.match(line)
        if heading:
            files = tuple(re.findall(r'`((?:src|include)/[^`]+)`', heading.group(1)))
        row = ROW.match(line)
        if not row or row.group(1) == 'edge':
            continue
        label, sc, *cells = row.groups()
        if label in edges:
            complaints.append((n, f'{label} is defined twice, here and in line {edges[label].line}'))
            continue
        sides = []
        for cell, usual in zip(cells, ('release', 'acquire')):
            words = {w for bracket in re.findall(r'\(([^()]*)\)', cell)
                     for w in re.findall(r'relaxed|release|acquire|acq_rel|\bsc\b', bracket)}
            if not words:
                words = {'sc'} if sc else {usual}
            sides.append((cell, set().union(*(STRENGTH[w] for w in words))))
        own = tuple(re.findall(r'`((?:src|include)/[^`]+)`', ' '.join(cells)))
        edges[label] = Edge(n, tuple(sides), own or files)
    return edges, complaints


def functions_named(cell):
    """The functions that a cell of a row names."""
    lists = re.findall(r'\bin (?:the reaper\'s )?(`[^`]+`(?:(?:,| and|, and) `[^`]+`)*)', cell)
    names = re.findall(r'`([^`]*(?:::|\(\))[^`]*)`', cell) + re.findall(r'`([^`]+)`', ' '.join(lists))
    return {m.group(1) for n in names if (m := re.fullmatch(r'(?:\w+::)*(~?\w+)(?:\(\))?', n))}


def check_edge(label, edge, steps):
    """What is wrong with one edge. `steps`: [(file, Step)] that cite it."""
    complaints = []
    for (cell, allowed), side in zip(edge.sides, ('left', 'right')):
        if 'the kernel' in cell:
            continue
        fitting = [(f, s) for f, s in steps if any(o in allowed for o in s.orders)
                   and (not edge.files or f.startswith(edge.files))]
        if not fitting:
            where = ' or '.join(edge.files) or 'the code'
            complaints.append(f'{label}: no step in {where} cites it on its {side} side')
            continue
        for name in functions_named(cell):
            if not any(s.function == name for _, s in steps):
                complaints.append(f'{label}: no step in {name}() cites it')
    crosswise = all(allowed == STRENGTH['sc'] for _, allowed in edge.sides)
    if crosswise and sum('seq_cst' in s.orders for _, s in steps) == 1:
        complaints.append(f'{label}: only one step is seq_cst')
    return complaints


def check(root):
    """Complaints as lines 'file:line: why', and the numbers of steps and edges."""
    complaints, cited, count = [], {}, 0
    page = root / 'docs' / 'edges.md'
    edges, wrong = read_edges(page)
    complaints += [f'docs/edges.md:{n}: {why}' for n, why in wrong]
    sources = [Source(file, str(file.relative_to(root)))
               for top in ('src', 'include') for file in sorted((root / top).rglob('*'))
               if file.suffix in ('.hpp', '.cpp')]
    declared = {s.name: set(DECLARED.findall(s.code)) - set(PLAIN.findall(s.code)) for s in sources}
    for source in sources:
        steps, wrong = source.steps()
        count += len(steps)
        complaints += [f'{source.name}:{n}: {why}' for n, why in wrong]
        for step in steps:
            for label in step.labels():
                cited.setdefault(label, []).append((source.name, step))
            if not says_why(step, edges):
                complaints.append(f'{source.name}:{step.line}: {" ".join(step.orders)} without a reason')
        for n, text in enumerate(source.comments, 1):
            complaints += [f'{source.name}:{n}: {label} does not stand in docs/edges.md'
                           for label in sorted(labels_in(text) - set(edges))]
        own = declared[source.name] | declared.get(re.sub(r'\.cpp$', '.hpp', source.name), set())
        complaints += [f'{source.name}:{n}: {what} has no memory order'
                       for n, what in sorted(set(source.implicit(own)))]
    for label, edge in edges.items():
        complaints += [f'docs/edges.md:{edge.line}: {why}'
                       for why in check_edge(label, edge, cited.get(label, []))]
    return complaints, count, len(edges)


GOOD = {
    'docs/edges.md': '''# Pairs

## The bell (`src/bell/bell.hpp`)

| edge | from | to | carries |
|---|---|---|---|
| B1 | `word` bump in `Bell::ring` (release) | load in `Bell::heard` (acquire) | the message |
| B2 sc | `asleep` store in `doze` | `word` load in `doze` | one of the two sees the other |
| B3 | the kernel | `asleep` load in `Bell::wake` (relaxed) | nothing |

## Names

| edge | from | to | carries |
|---|---|---|---|
| state | a state store (release; `src/`) | its look (acquire) | who is there |
''',
    'src/bell/bell.hpp': '''// Edges
//   B1  word bump (release) -> load in heard() (acquire)
//   I1  an invariant, and no edge
#include <atomic>
namespace lot {
/// B1 of the class says nothing about its steps.
template <class P>
class Bell {
 public:
  void ring() { word_.fetch_add(1, std::memory_order_release); }  // B1
  bool heard() const {
    // B1
    return word_.load(std::memory_order_acquire) != 0;
  }
  void doze() {
    // B2: "no; store(x) here" is a string's business.
    asleep_.store(true, std::memory_order_seq_cst);
    log("; word_.load()", '"');
    if (word_.load(std::memory_order_seq_cst) == 0) return;  // B2
    // Relaxed, here and below: only this thread stores it.
    asleep_.store(false, std::memory_order_relaxed);

    asleep_.store(false, std::memory_order_relaxed);  // as above
  }
  /// Relaxed: B3.
  bool wake() { return asleep_.load(std::memory_order_relaxed); }
  void fence() {
    std::atomic_signal_fence(std::memory_order_seq_cst);  // for the compiler only
  }
  void set(int word) { plain_ = word; ++plain_; if (plain_ == 1) heard(); }

 private:
  std::atomic<std::uint32_t> word_{0};
  std::atomic<bool> asleep_{false};
  std::vector<std::atomic<bool>> all_{};
  int plain_ = 0;
};
}
''',
    'src/bell/who.cpp': '''#include "bell/bell.hpp"
void say(Entry& entry) {
  entry.state.store(1, std::memory_order_release);  // edge "state"
  // Acquire: edge "state".
  if (entry.state.load(std::memory_order_acquire) == 0) return;
  // The look is relaxed: a hint.
  for (int i = 0; i < entry.n.load(std::memory_order_relaxed); ++i) {
  }
}
''',
}
PLANTED = [  # file, a piece of it, what stands there instead, what must be complained about
    ('src/bell/bell.hpp', 'release); }  // B1', 'release); }', 'bell.hpp:10: release without a reason'),
    ('src/bell/bell.hpp', 'release); }  // B1', 'release); }  // as above', 'bell.hpp:10: release without'),
    ('src/bell/bell.hpp', 'release); }  // B1', 'release); }  // B9', 'bell.hpp:10: B9 does not stand'),
    ('src/bell/bell.hpp', '_release); }  // B1', '_relaxed); }  // B1', 'B1: no step in src/bell/bell.hpp cites it on its left'),
    ('src/bell/bell.hpp', '    // B1\n', '', 'bell.hpp:12: acquire without a reason'),
    ('src/bell/bell.hpp', '    // B1\n', '    // B1\n\n', 'bell.hpp:14: acquire without a reason'),
    ('src/bell/bell.hpp', 'heard() const', 'listen() const', 'B1: no step in heard() cites it'),
    ('src/bell/bell.hpp', 'store(true, std::memory_order_seq_cst)', 'store(true, std::memory_order_release)',
     'B2: only one step is seq_cst'),
    ('src/bell/bell.hpp', '0) return;', '0) { asleep_.store(true); return; }', 'asleep_.store() has no memory order'),
    ('src/bell/bell.hpp', '0) return;', '0) asleep_ = true;', 'asleep_ has no memory order'),
    ('src/bell/bell.hpp', '0) return;', '0) ++word_;', 'word_ has no memory order'),
    ('src/bell/bell.hpp', '0) return;', '0 && !asleep_) return;', 'asleep_ has no memory order'),
    ('src/bell/bell.hpp', '0) return;', '0) while (word_ == 0) {}', 'word_ has no memory order'),
    ('src/bell/bell.hpp', 'Relaxed, here and below: only', 'Only', 'relaxed without a reason'),
    ('src/bell/bell.hpp', '  // for the compiler only', '', 'bell.hpp:28: seq_cst without a reason'),
    ('src/bell/bell.hpp', '  void fence() {', '  void fence(int o = std::memory_order_relaxed) {', 'an order of no atomic step'),
    ('src/bell/who.cpp', '// edge "state"', '// state', 'who.cpp:3: release without a reason'),
    ('src/bell/who.cpp', '// edge "state"', '// edge "gone"', 'gone does not stand in docs/edges.md'),
    ('src/bell/who.cpp', '  // The look is relaxed: a hint.\n', '', 'who.cpp:6: relaxed without a reason'),
    ('docs/edges.md', '| B3 | the kernel', '| B1 | the kernel', 'edges.md:9: B1 is defined twice'),
    ('docs/edges.md', 'src/bell/bell.hpp', 'src/bell/who.cpp', 'B1: no step in src/bell/who.cpp cites it'),
    ('docs/edges.md', '`src/`', '`src/other/`', 'state: no step in src/other/ cites it on its left'),
    ('docs/edges.md', '## Names', '| B4 | a (release) | b (acquire) | c |\n\n## Names', 'B4: no step in src/bell'),
]


def self_test():
    """Each planted mistake must be found. Returns the failures, and the number of cases."""
    failures = []
    with tempfile.TemporaryDirectory() as scratch:
        root = pathlib.Path(scratch)
        for name, text in GOOD.items():
            (root / name).parent.mkdir(parents=True, exist_ok=True)
            (root / name).write_text(text)
        failures += [f'a right tree is refused: {c}' for c in check(root)[0]]
        for name, piece, instead, expected in PLANTED:
            if piece not in GOOD[name]:
                failures.append(f'{name} has no {piece!r}')
                continue
            (root / name).write_text(GOOD[name].replace(piece, instead, 1))
            complaints = check(root)[0]
            (root / name).write_text(GOOD[name])
            if not any(expected in c for c in complaints):
                failures.append(f'{name}: {instead!r}: expected {expected!r}, got {complaints}')
    return failures, 1 + len(PLANTED)


def main(arguments):
    if arguments == ['--self-test']:
        failures, count = self_test()
        print('\n'.join(failures + [f'edges self-test: {count} cases, {len(failures)} failed']))
        return 1 if failures else 0
    root = pathlib.Path(arguments[0] if arguments else pathlib.Path(__file__).parent.parent).resolve()
    try:
        complaints, count, edges = check(root)
    except (OSError, ValueError) as error:
        complaints, count, edges = [str(error)], 0, 0
    print('\n'.join(complaints + [f'edges: {count} steps, {edges} edges, {len(complaints)} wrong']))
    return 1 if complaints else 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
