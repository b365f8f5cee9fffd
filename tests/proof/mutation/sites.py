# SPDX-License-Identifier: Apache-2.0
"""Finds every atomic step of a header, and every memory_order argument of it.

A site has two names: its place (line and column, as the compiler reports them to the model), and a
key that survives when lines move: function, expression, occurrence.
"""

import bisect
import dataclasses
import re

METHODS = ('load', 'store', 'exchange', 'fetch_add', 'fetch_sub', 'fetch_or', 'fetch_and',
           'compare_exchange_strong', 'compare_exchange_weak')
CALL = re.compile(r'(?:\.|->)(' + '|'.join(METHODS) + r')\s*\(')
ORDER = re.compile(r'^(?:std::)?memory_order(?:_|::)(\w+)$')
COMMENT = re.compile(r'//[^\n]*|/\*.*?\*/', re.S)
FUNCTION = re.compile(r'(~?\w+)\s*\((?:[^()]|\([^()]*\))*\)\s*(?:const|noexcept|override|\s)*'
                      r'(?:->\s*[\w:&*<> ]+)?$', re.S)
NOT_FUNCTIONS = {'if', 'for', 'while', 'switch', 'catch', 'return'}


@dataclasses.dataclass(frozen=True)
class Site:
    file: str       # name of the header
    function: str
    expression: str  # what is called, without its arguments: ring_.slots[i].load
    occurrence: int  # of this expression in this function, from 1
    method: str
    orders: tuple   # as written: one, or success and failure
    begin: tuple    # (line, column) of the expression
    end: tuple      # (line, column) of the closing parenthesis

    @property
    def key(self):
        return f'{self.file} {self.function} {self.expression}#{self.occurrence}'

    @property
    def kind(self):
        if self.method in ('load', 'store'):
            return self.method
        return 'compare_exchange' if self.method.startswith('compare') else 'rmw'

    def holds(self, line, column):
        return self.begin <= (line, column) <= self.end

    def size(self):
        return self.end[0] - self.begin[0], self.end[1] - self.begin[1]


def blank_comments(text):
    """The text with comments replaced by blanks: all places stay."""
    return COMMENT.sub(lambda c: re.sub(r'[^\n]', ' ', c.group()), text)


def closing(text, opening):
    """Index of the parenthesis or bracket that closes the one at `opening`."""
    depth = 0
    for i in range(opening, len(text)):
        depth += text[i] in '([{'
        depth -= text[i] in ')]}'
        if depth == 0:
            return i
    raise ValueError('unbalanced parentheses')


def receiver(text, dot):
    """Index where the expression before `dot` begins."""
    i = dot
    while i > 0:
        c = text[i - 1]
        if c in ')]':
            depth = 0
            while True:
                i -= 1
                depth += text[i] in ')]'
                depth -= text[i] in '(['
                if depth == 0:
                    break
        elif c.isalnum() or c in '_.' or text[i - 2:i] in ('->', '::'):
            i -= 2 if text[i - 2:i] in ('->', '::') else 1
        elif c.isspace() and text[i] in '.-':  # the expression goes on in the next line
            i = len(text[:i].rstrip())
        else:
            break
    return i


def arguments(text):
    """Splits at the commas that are not inside of parentheses."""
    parts, depth, start = [], 0, 0
    for i, c in enumerate(text):
        depth += c in '([{'
        depth -= c in ')]}'
        if c == ',' and depth == 0:
            parts.append(text[start:i].strip())
            start = i + 1
    return parts + [text[start:].strip()]


def functions(text):
    """(begin, end, name) of each function body; lambdas belong to the function around them."""
    found, stack, since = [], [], 0
    for i, c in enumerate(text):
        if c == '{':
            head = FUNCTION.search(text[since:i].split(' : ')[0].rstrip())
            name = head.group(1) if head and head.group(1) not in NOT_FUNCTIONS else None
            # Between parentheses it is a lambda or a default value: the statement goes on behind it.
            inside = text.count('(', since, i) > text.count(')', since, i)
            stack.append((i, name, since if inside else None))
            since = i + 1
        elif c == '}':
            begin, name, statement = stack.pop()
            if name:
                found.append((begin, i, name))
            since = i + 1 if statement is None else statement
        elif c == ';':
            since = i + 1
    return found


def find(path):
    """All sites of the header at `path`. Raises ValueError when a memory_order is at none of them."""
    text = blank_comments(path.read_text())
    starts = [0] + [m.end() for m in re.finditer('\n', text)]
    bodies = functions(text)

    def place(offset):
        line = bisect.bisect_right(starts, offset)
        return line, offset - starts[line - 1] + 1

    sites, seen, orders_seen = [], {}, 0
    for call in CALL.finditer(text):
        opening = call.end() - 1
        end = closing(text, opening)
        orders = tuple(m.group(1) for a in arguments(text[opening + 1:end]) if (m := ORDER.match(a)))
        if not orders:
            continue
        orders_seen += len(orders)
        begin = receiver(text, call.start())
        around = [b for b in bodies if b[0] < begin < b[1]]
        function = max(around)[2] if around else '-'
        expression = re.sub(r'\s+', '', text[begin:opening])
        nth = seen[function, expression] = seen.get((function, expression), 0) + 1
        sites.append(Site(path.name, function, expression, nth, call.group(1), orders, place(begin),
                          place(end)))
    written = len(re.findall(r'\bmemory_order(?:_|::)\w+', text))
    if written != orders_seen:
        raise ValueError(f'{path}: {written} memory orders are written, {orders_seen} understood')
    return sites


SAMPLE = """
// slot.load(std::memory_order_relaxed) in a comment is none
struct Ring {
  Ring() : head_(0) { head_.store(0, std::memory_order_relaxed); }
  template <class F>
  bool poll(F&& f) const {
    auto look = [&](int i) { return slots[i < n ? i : i - n].load(std::memory_order_acquire); };
    if (word(b, self).fetch_or(f(1), std::memory_order_release) != 0 ||
        !ring.who[c].compare_exchange_strong(none, me + 1, std::memory_order_seq_cst,
                                             std::memory_order_relaxed)) {
      return world_
          .participant_state(k)
          .load(std::memory_order_seq_cst) != next(a.exchange(b.load(std::memory_order_relaxed),
                                                              std::memory_order_acq_rel));
    }
    return slots[0].load(std::memory_order_acquire) != slots[0].load(std::memory_order_relaxed);
  }
  bool serve(std::optional<int> answer = {}) {
    return each([&](int i) {
      if (i) { return slots[i].load(std::memory_order_acquire); }
      return 0;
    }) || head_.load(std::memory_order_relaxed);
  }
};
"""
EXPECTED = [
    ('Ring head_.store#1', ('relaxed',), (4, 23)),
    ('poll slots[i<n?i:i-n].load#1', ('acquire',), (7, 37)),
    ('poll word(b,self).fetch_or#1', ('release',), (8, 9)),
    ('poll ring.who[c].compare_exchange_strong#1', ('seq_cst', 'relaxed'), (9, 10)),
    ('poll world_.participant_state(k).load#1', ('seq_cst',), (11, 14)),
    ('poll a.exchange#1', ('acq_rel',), (13, 52)),
    ('poll b.load#1', ('relaxed',), (13, 63)),
    ('poll slots[0].load#1', ('acquire',), (16, 12)),
    ('poll slots[0].load#2', ('relaxed',), (16, 56)),
    ('serve slots[i].load#1', ('acquire',), (20, 23)),
    ('serve head_.load#1', ('relaxed',), (22, 11)),
]


def self_test(scratch):
    """What is wrong with the reading of a sample, as lines."""
    file = scratch / 'sample.hpp'
    file.write_text(SAMPLE)
    got = [(s.key.removeprefix('sample.hpp '), s.orders, s.begin) for s in find(file)]
    failures = [f'expected {e}, got {g}' for e, g in zip(EXPECTED, got) if e != g]
    if len(got) != len(EXPECTED):
        failures.append(f'expected {len(EXPECTED)} sites, got {len(got)}')
    file.write_text('int f() { return g(std::memory_order_relaxed); }')
    try:
        find(file)
        failures.append('an order that belongs to no atomic step is overlooked')
    except ValueError:
        pass
    return failures
