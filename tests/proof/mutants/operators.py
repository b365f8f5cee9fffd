# SPDX-License-Identifier: Apache-2.0
"""Finds what can be mutated in a file, by libclang, and says how the mutant is written into it.

A mutant is asked for at run time (lot_mutant.hpp). It is written as text around an expression or a
statement, and sometimes over an operator; nothing is written twice, so that mutants nest. No line is
added: places stay.
"""

import dataclasses
import re

from clang.cindex import CursorKind as K
from clang.cindex import TypeKind

ABOUT = {
    'never': 'a condition that never holds',
    'always': 'a condition that always holds',
    'operand': 'an operand of && or || without effect',
    'negate': 'a comparison that says the opposite',
    'bound': 'a bound that is one further or one nearer',
    'sum': 'another arithmetic operator',
    'extreme': 'min for max, max for min',
    'constant': 'another constant',
    'drop': 'a statement that is left out',
    'swap': 'two statements in the other order',
    'result': 'a function that returns something else',
}

RELATIONS = {'<': ('less', '<='), '<=': ('less_equal', '<'),
             '>': ('greater', '>='), '>=': ('greater_equal', '>')}
SUMS = {'+': ('plus', '-'), '-': ('minus', '+'), '*': ('times', '+'), '/': ('divided', '*'),
        '%': ('modulo', '+'), '&': ('both_bits', '|'), '|': ('either_bit', '&'),
        '^': ('one_bit', '|'), '<<': ('left', '>>'), '>>': ('right', '<<')}
NUMBERS = {TypeKind.BOOL, TypeKind.CHAR_U, TypeKind.UCHAR, TypeKind.USHORT, TypeKind.UINT,
           TypeKind.ULONG, TypeKind.ULONGLONG, TypeKind.CHAR_S, TypeKind.SCHAR, TypeKind.SHORT,
           TypeKind.INT, TypeKind.LONG, TypeKind.LONGLONG, TypeKind.FLOAT, TypeKind.DOUBLE,
           TypeKind.LONGDOUBLE}
FUNCTIONS = {K.FUNCTION_DECL, K.CXX_METHOD, K.CONSTRUCTOR, K.DESTRUCTOR, K.CONVERSION_FUNCTION,
             K.FUNCTION_TEMPLATE}
SCOPES = {K.NAMESPACE, K.LINKAGE_SPEC, K.CLASS_DECL, K.STRUCT_DECL, K.UNION_DECL, K.CLASS_TEMPLATE,
          K.CLASS_TEMPLATE_PARTIAL_SPECIALIZATION, K.UNEXPOSED_DECL}
NO_CODE = {K.CXX_UNARY_EXPR, K.CXX_TYPEID_EXPR, K.STATIC_ASSERT, K.TYPE_REF, K.TEMPLATE_REF,
           K.NAMESPACE_REF, K.TYPEDEF_DECL, K.TYPE_ALIAS_DECL, K.ENUM_DECL,
           K.SIZE_OF_PACK_EXPR}
# A record that `return {}` makes: nothing, or zero.
EMPTY = re.compile(r'(const )?std::(__cxx11::)?(optional|basic_string|string|vector|deque|map|set|'
                   r'unordered_map|unordered_set|unique_ptr|shared_ptr|weak_ptr|function|pair|'
                   r'string_view|basic_string_view|chrono::duration|chrono::\w*seconds)\b')
TIMES = re.compile(r'\bchrono::(_V2::)?(duration|time_point|nanoseconds|microseconds|milliseconds|'
                   r'seconds|minutes|hours)\b')
PERIOD = re.compile(r"\d[\d'.]*(ns|us|ms|s|min|h)")
INTEGER = re.compile(r"(0[xX][\da-fA-F']+|0[bB][01']+|\d[\d']*)([uUlLzZ]*)")
FLOATING = re.compile(r"\d[\d']*\.?\d*(e[+-]?\d+)?[fFlL]?")
MACRO = re.compile(r'[A-Z][A-Z0-9_]{2,}\s*\(')
SMALL = 16  # a smaller constant becomes its neighbour, a larger one zero


@dataclasses.dataclass
class Mutant:
    file: str
    operator: str
    begin: int    # of the text that is replaced
    end: int
    now: str      # what stands there instead
    function: str
    wraps: list   # (begin, end, prefix, suffix)
    tokens: list  # (begin, end, text)
    line: int = 0
    written: str = ''  # the line, without what surrounds it
    nth: int = 1  # of the mutants of this operator in lines with this text
    number: int = 0

    @property
    def key(self):
        nth = f' #{self.nth}' if self.nth > 1 else ''
        return f'{self.file}: {self.operator} `{self.written}`{nth}'


class Finder:
    """All mutants of one file of a translation unit."""

    def __init__(self, file, text):
        self.file, self.text = file, text
        self.found, self.seen = [], set()
        self.function, self.result = '-', None
        self.question = 'is'

    # ---- text ---------------------------------------------------------------------------------

    def span(self, cursor):
        return cursor.extent.start.offset, cursor.extent.end.offset

    def at(self, cursor):
        begin, end = self.span(cursor)
        return self.text[begin:end]

    def inside(self, cursor, around):
        begin, end = self.span(cursor)
        file = cursor.location.file
        return (file is not None and file.name == self.source and
                around[0] <= begin < end <= around[1])

    def semicolon(self, end):
        """Behind the semicolon that follows `end`, or None."""
        found = re.compile(r'(\s|//[^\n]*\n|/\*.*?\*/)*;', re.S).match(self.text, end)
        return found.end() if found else None

    def in_template_arguments(self, offset):
        """clang-format writes a<b> for arguments, and a < b for a comparison."""
        depth, angles, i = 0, 0, offset - 1
        while i > 0:
            c = self.text[i]
            if c in ')]}':
                depth += 1
            elif c in '([{':
                if depth == 0:
                    return False
                depth -= 1
            elif depth == 0 and c == ';':
                return False
            elif depth == 0 and c == '>' and self.text[i - 1] not in '- ':
                angles += 1
            elif depth == 0 and c == '<' and (self.text[i - 1].isalnum() or self.text[i - 1] == '_'):
                if angles == 0:
                    return True
                angles -= 1
            i -= 1
        return False

    # ---- mutants ------------------------------------------------------------------------------

    def add(self, operator, begin, end, now, wraps, tokens=(), variant=''):
        """`@` in the texts stands for the question."""
        if (operator, begin, end, variant) in self.seen:
            return
        self.seen.add((operator, begin, end, variant))
        ask = f'::lot_mutant::{self.question}(@)'
        self.found.append(Mutant(
            self.file, operator, begin, end, now, self.function,
            [(b, e, p.replace('@', ask), s) for b, e, p, s in wraps], list(tokens)))

    def never(self, cursor, operator='never', now='false'):
        b, e = self.span(cursor)
        if self.at(cursor) not in ('true', 'false'):
            self.add(operator, b, e, now, [(b, e, '(!@ && (', '))')])

    def always(self, cursor, operator='always', now='true'):
        b, e = self.span(cursor)
        if self.at(cursor) not in ('true', 'false'):
            self.add(operator, b, e, now, [(b, e, '(@ || (', '))')])

    def drop(self, cursor):
        b, e = self.span(cursor)
        text = self.text[b:e]
        body = list(cursor.get_children())[-1:] if cursor.kind == K.CXX_FOR_RANGE_STMT else []
        if not body or body[0].kind != K.COMPOUND_STMT:
            e = self.semicolon(e)
        if e is None or MACRO.match(text) or re.match(r'(static_cast<void>|\(void\))', text):
            return
        self.add('drop', b, e, ';', [(b, e, '{ if (!@) { ', ' } }')])

    def swap(self, first, second):
        b1, e1 = self.span(first)
        b2, e2 = self.span(second)
        e1, e2 = self.semicolon(e1), self.semicolon(e2)
        if e1 is None or e2 is None or '#' in self.text[e1:b2]:
            return
        now = self.text[b2:e2] + ' ' + self.text[b1:e1]
        self.add('swap', b1, e2, now, [
            (b1, e2, 'for (int lot_turn = 0; lot_turn < 2; ++lot_turn) { ', ' }'),
            (b1, e1, 'if ((lot_turn == 0) != @) { ', ' }'), (b2, e2, 'else { ', ' }')])

    # ---- declarations -------------------------------------------------------------------------

    def all(self, unit, source):
        self.source = source
        self.declarations(unit.cursor)
        lines = [0] + [m.end() for m in re.finditer('\n', self.text)]
        texts = self.text.split('\n')
        self.found.sort(key=lambda m: (m.begin, -m.end))
        count, row = {}, 0
        for mutant in self.found:
            while row + 1 < len(lines) and lines[row + 1] <= mutant.begin:
                row += 1
            mutant.line, mutant.written = row + 1, texts[row].strip()
            same = mutant.operator, mutant.written
            mutant.nth = count[same] = count.get(same, 0) + 1
        return self.found

    def declarations(self, cursor):
        for child in cursor.get_children():
            file = child.location.file
            if file is None or file.name != self.source:
                continue
            if MACRO.match(self.text, child.extent.start.offset):
                continue
            if child.kind in FUNCTIONS or child.kind == K.FRIEND_DECL:
                self.any_function(child)
            elif child.kind in SCOPES:
                self.declarations(child)
            elif child.kind == K.FIELD_DECL:
                self.early(child)

    def any_function(self, cursor):
        if cursor.kind == K.FRIEND_DECL:
            for child in cursor.get_children():
                if child.kind in FUNCTIONS:
                    self.any_function(child)
            return
        children = list(cursor.get_children())
        bodies = [c for c in children if c.kind in (K.COMPOUND_STMT, K.CXX_TRY_STMT) and
                  self.at(c).startswith(('{', 'try'))]  # one that is defaulted has a body of no text
        if not bodies:
            for child in children:
                if child.kind == K.PARM_DECL:
                    self.early(child)
            return
        head = self.text[cursor.extent.start.offset:bodies[-1].extent.start.offset]
        if re.search(r'\bconsteval\b', head):
            return
        before = self.function, self.result, self.question
        self.function, self.result = cursor.spelling, cursor.result_type
        self.question = 'maybe' if re.search(r'\bconstexpr\b', head) else 'is'
        for child in children:
            if child.kind == K.PARM_DECL:
                self.early(child)
            elif child in bodies:
                self.statement(child)
            elif cursor.kind == K.CONSTRUCTOR and child.kind.is_expression():
                self.expression(child)
        self.function, self.result, self.question = before

    def early(self, cursor):
        """The initialiser of a member or parameter, which constexpr functions may use, too."""
        before, self.question = self.question, 'maybe'
        self.initialiser(cursor)
        self.question = before

    def initialiser(self, cursor):
        """Of a variable, a member or a parameter: what stands behind its name."""
        name = cursor.location.offset
        head = self.text[cursor.extent.start.offset:name]
        if re.search(r'\b(constexpr|constinit|static|thread_local|extern)\b', head):
            return
        around = self.span(cursor)
        for child in cursor.get_children():
            begin = child.extent.start.offset
            if not self.inside(child, around) or not child.kind.is_expression() or begin <= name:
                continue
            lead = self.text[name:begin].rstrip()
            if lead.endswith('[') or (lead.endswith(':') and not lead.endswith('::')):
                continue
            self.expression(child)

    # ---- statements ---------------------------------------------------------------------------

    def statement(self, s):
        kind = s.kind
        if MACRO.match(self.text, s.extent.start.offset):
            return
        if kind == K.COMPOUND_STMT:
            self.block(s)
        elif kind.is_expression():
            self.drop(s)
            self.expression(s, statement=True)
        elif kind == K.DECL_STMT:
            for child in s.get_children():
                if child.kind == K.VAR_DECL:
                    self.initialiser(child)
        elif kind == K.RETURN_STMT:
            self.returned(s)
        elif kind in (K.BREAK_STMT, K.CONTINUE_STMT):
            self.drop(s)
        elif kind == K.IF_STMT:
            self.condition(s)
        elif kind == K.WHILE_STMT:
            self.condition(s, loop=True)
        elif kind == K.DO_STMT:
            body, *condition = s.get_children()
            self.statement(body)
            for c in condition:
                self.never(c)
                self.expression(c, asked=True)
        elif kind == K.FOR_STMT:
            self.for_loop(s)
        elif kind == K.CXX_FOR_RANGE_STMT:
            self.drop(s)
            self.parts(s)
        elif kind in (K.CASE_STMT, K.DEFAULT_STMT):
            self.statement(list(s.get_children())[-1])
        elif kind in (K.SWITCH_STMT, K.CXX_TRY_STMT, K.CXX_CATCH_STMT):
            self.parts(s)

    def parts(self, s):
        around = self.span(s)
        for child in s.get_children():
            if not self.inside(child, around):
                continue
            if child.kind.is_expression():
                self.expression(child)
            elif child.kind == K.VAR_DECL:
                self.initialiser(child)
            else:
                self.statement(child)

    def block(self, s):
        before = None
        for child in s.get_children():
            self.statement(child)
            acts = self.acts(child)
            if before is not None and acts:
                self.swap(before, child)
                before = None
            else:
                before = child if acts else None

    def acts(self, s):
        """It changes something that others see, as far as its text tells: there is a call in it."""
        if not s.kind.is_expression():
            return False
        text = self.at(s)
        return '(' in text and not MACRO.match(text) and not text.startswith(('throw', 'static_cast<void>'))

    def condition(self, s, loop=False):
        begin, end = self.span(s)
        opening = self.text.index('(', begin)
        fixed = re.fullmatch(r'(if|while)\s+(constexpr|consteval)\s*', self.text[begin:opening])
        children = [c for c in s.get_children() if self.inside(c, (begin, end))]
        heads = []
        while children and not self.is_body(children[0], opening):
            heads.append(children.pop(0))
        declared = any(h.kind in (K.VAR_DECL, K.DECL_STMT) and
                       self.semicolon(h.extent.end.offset) is None and
                       not self.text[:h.extent.end.offset].endswith(';') for h in heads)
        for head in heads:
            if head.kind == K.VAR_DECL:
                self.initialiser(head)
            elif not head.kind.is_expression():
                self.statement(head)
            elif head is heads[-1] and not fixed and not declared:
                self.never(head)
                if not loop:
                    self.always(head)
                self.expression(head, asked=True)
        for child in children:
            self.statement(child)

    def is_body(self, child, opening):
        """It begins behind the parenthesis that closes the condition's."""
        depth, i = 0, opening
        while True:
            depth += (self.text[i] == '(') - (self.text[i] == ')')
            if depth == 0:
                break
            i += 1
        return child.extent.start.offset > i

    def for_loop(self, s):
        begin, end = self.span(s)
        opening = self.text.index('(', begin)
        depth, stops, i = 0, [], opening
        while True:
            c = self.text[i]
            depth += (c in '([{') - (c in ')]}')
            if depth == 0:
                break
            if depth == 1 and c == ';':
                stops.append(i)
            i += 1
        for child in s.get_children():
            if not self.inside(child, (begin, end)):
                continue
            start = child.extent.start.offset
            if start > i or not child.kind.is_expression():
                self.statement(child)
            else:
                asked = stops[0] < start < stops[1]
                if asked:
                    self.never(child)
                self.expression(child, asked=asked)

    def returned(self, s):
        children = list(s.get_children())
        if not children:
            self.drop(s)
            return
        value = children[0]
        begin, end = self.span(value)
        text = self.text[begin:end]
        plain = re.fullmatch(r"\{.*\}|true|false|nullptr|std::nullopt|-?[\d'.]+\w*|\*this|this|\"[^\"]*\"",
                             text, re.S)
        kind = self.result.get_canonical() if self.result is not None else None
        asked = False
        if plain or kind is None or kind.kind == TypeKind.VOID:
            pass
        elif kind.kind == TypeKind.BOOL:
            self.add('result', begin, end, f'!({text})', [(begin, end, '(@ != static_cast<bool>(', '))')])
            asked = True
        elif kind.kind in NUMBERS or kind.kind == TypeKind.POINTER:
            zero = 'nullptr' if kind.kind == TypeKind.POINTER else '0'
            self.add('result', begin, end, zero, [(begin, end, '::lot_mutant::value(@, ', ')')])
        elif self.is_empty_record(kind) and '&' not in self.result.spelling:
            b, e = s.extent.start.offset, self.semicolon(s.extent.end.offset)
            if e is not None:
                self.add('result', b, e, 'return {};', [(b, e, '{ if (@) return {}; ', ' }')])
        self.expression(value, asked=asked)

    def is_empty_record(self, kind):
        if EMPTY.match(kind.spelling) or EMPTY.match(self.result.spelling):
            return True
        if kind.kind != TypeKind.RECORD or kind.spelling.startswith(('std::', 'const std::')):
            return False
        record = kind.get_declaration().get_definition()
        if record is None:
            return False
        kinds = {c.kind for c in record.get_children()}
        return K.CONSTRUCTOR not in kinds and K.CXX_BASE_SPECIFIER not in kinds

    # ---- expressions --------------------------------------------------------------------------

    def expression(self, c, asked=False, statement=False):
        """asked: something else negates it already, or leaves it out."""
        kind = c.kind
        if kind in NO_CODE or not self.at(c):
            return
        around = self.span(c)
        if MACRO.match(self.text, around[0]):
            return
        if kind == K.LAMBDA_EXPR:
            self.lambda_expression(c)
            return
        if PERIOD.fullmatch(self.at(c)):
            self.period(c)
            return
        if kind in (K.INTEGER_LITERAL, K.FLOATING_LITERAL, K.CXX_BOOL_LITERAL_EXPR):
            self.literal(c)
            return
        if kind == K.DECL_REF_EXPR:
            self.named(c)
            return
        children = [x for x in c.get_children() if self.inside(x, around)]
        if kind == K.MEMBER_REF_EXPR:
            children = [x for x in children if self.span(x)[0] == around[0] and x.kind.is_expression()]
        if kind == K.CONDITIONAL_OPERATOR and len(children) == 3:
            self.never(children[0])
            self.always(children[0])
            self.expression(children[0], asked=True)
            self.expression(children[1])
            self.expression(children[2])
            return
        sides = self.sides(c, children)
        if sides:
            self.binary(c, *sides, asked, statement)
            return
        if kind == K.UNARY_OPERATOR and self.text[around[0]] == '!' and len(children) == 1:
            if not asked:
                self.negate(c)
            self.expression(children[0], asked=True)
            return
        if kind == K.CALL_EXPR:
            if self.text.startswith('__builtin_', around[0]):
                return  # its arguments may have to be constants
            self.extreme(c)
        same = len(children) == 1 and self.span(children[0]) == around or kind == K.PAREN_EXPR
        for child in children:
            self.expression(child, asked=asked and same)

    def sides(self, c, children):
        """(left, operator, its place, right) of a binary operator, or None."""
        overloaded = c.kind in (K.CALL_EXPR, K.UNEXPOSED_EXPR)
        if not overloaded and c.kind not in (K.BINARY_OPERATOR, K.COMPOUND_ASSIGNMENT_OPERATOR):
            return None
        if overloaded:
            children = sorted((x for x in children if x.kind.is_expression() and
                               re.search(r'[\w)\]}"\']', self.at(x))), key=self.span)
        if len(children) != 2:
            return None
        left, right = children
        (begin, middle), (right_begin, end) = self.span(left), self.span(right)
        if (begin, end) != self.span(c) or middle > right_begin:
            return None
        between = re.sub(r'//[^\n]*|/\*.*?\*/', lambda m: ' ' * len(m.group()),
                         self.text[middle:right_begin], flags=re.S)
        operator = between.strip()
        if not re.fullmatch(r'[-+*/%&|^<>=!]{1,3}', operator):
            return None
        place = middle + between.index(operator)
        return left, operator, place, right

    def kind_of(self, c):
        kind = c.type.get_canonical()
        if kind.kind in NUMBERS or kind.kind == TypeKind.ENUM:
            return 'number'
        if kind.kind in (TypeKind.POINTER, TypeKind.NULLPTR):
            return 'pointer'
        if TIMES.search(kind.spelling) and kind.spelling.startswith(('std::chrono', 'const std::chrono')):
            return 'time_point' if 'time_point' in kind.spelling else 'duration'
        if kind.kind in (TypeKind.DEPENDENT, TypeKind.UNEXPOSED):
            return 'unknown'
        return 'other'

    def binary(self, c, left, operator, place, right, asked, statement):
        begin, end = self.span(c)
        kinds = self.kind_of(left), self.kind_of(right)
        if operator in ('&&', '||') and 'other' not in kinds:
            for side in (left, right):
                inner = self.sides(side, [x for x in side.get_children() if self.inside(x, self.span(side))])
                if inner is None or inner[1] != operator:
                    if operator == '&&':
                        self.always(side, 'operand')
                    else:
                        self.never(side, 'operand')
                self.expression(side, asked=True)
            return
        if operator in ('==', '!='):
            if not asked and not statement:
                self.negate(c)
        elif operator in RELATIONS and 'other' not in kinds:
            self.replace('bound', c, left, place, operator, right, *RELATIONS[operator])
        elif operator in SUMS and self.sums_up(operator, kinds) and not statement:
            self.replace('sum', c, left, place, operator, right, *SUMS[operator])
        self.expression(left)
        self.expression(right)

    def sums_up(self, operator, kinds):
        if kinds == ('number', 'number'):
            return True
        if operator in '+-':
            return kinds in (('pointer', 'number'), ('duration', 'duration'), ('time_point', 'duration'),
                             ('unknown', 'number'))
        return False

    def replace(self, name, c, left, place, operator, right, function, instead):
        begin, end = self.span(c)
        now = self.text[begin:place] + instead + self.text[place + len(operator):end]
        self.add(name, begin, end, now, [(begin, end, f'::lot_mutant::{function}(@, ', ')')],
                 [(place, place + len(operator), ',')])

    def negate(self, c):
        b, e = self.span(c)
        self.add('negate', b, e, f'!({self.text[b:e]})', [(b, e, '(@ != static_cast<bool>(', '))')])

    def extreme(self, c):
        b, e = self.span(c)
        found = re.match(r'std::(min|max)(<[^()]*>)?\(', self.text[b:e])
        if not found or '{' == self.text[b + found.end()]:
            return
        name = found.group(1)
        now = self.text[b:e].replace(f'std::{name}', 'std::max' if name == 'min' else 'std::min', 1)
        ours = '::lot_mutant::' + ('least' if name == 'min' else 'most')
        self.add('extreme', b, e, now, [(b + found.end(), b + found.end(), '@, ', '')],
                 [(b, b + len('std::min'), ours)])

    def literal(self, c):
        b, e = self.span(c)
        text = self.text[b:e]
        if self.in_template_arguments(b):
            return
        if text in ('true', 'false'):
            now = 'false' if text == 'true' else 'true'
        elif found := INTEGER.fullmatch(text):
            digits = found.group(1).replace("'", '')
            n = int(digits, 0 if digits[1:2] in 'xXbB' else 10)
            now = ('1' if n == 0 else str(n - 1) if n < SMALL else '0') + found.group(2)
        elif FLOATING.fullmatch(text):
            now = '0.0' if float(text.rstrip('fFlL').replace("'", '')) else '1.0'
        else:
            return
        self.add('constant', b, e, now, [(b, e, f'(@ ? {now} : ', ')')])

    def period(self, c):
        b, e = self.span(c)
        text = self.text[b:e]
        self.add('constant', b, e, f'0 * {text}', [(b, e, '::lot_mutant::value(@, ', ')')], variant='none')
        self.add('constant', b, e, f'1000 * {text}', [(b, e, '::lot_mutant::longer(@, ', ')')], variant='long')

    def named(self, c):
        """A named constant where it is used: it may not change where it is declared."""
        b, e = self.span(c)
        target = c.referenced
        if target is None or target.kind != K.VAR_DECL or self.in_template_arguments(b):
            return
        if not re.fullmatch(r'[\w:]+', self.text[b:e]) or not re.search(r'\bk[A-Z]\w*$', self.text[b:e]):
            return
        kind = self.kind_of(c)
        if kind == 'duration':
            self.period(c)
        elif kind == 'number' and c.type.get_canonical().kind != TypeKind.ENUM:
            if c.type.get_canonical().kind == TypeKind.BOOL:
                return
            self.add('constant', b, e, f'{self.text[b:e]} + 1', [(b, e, '::lot_mutant::more(@, ', ')')])

    def lambda_expression(self, c):
        around = self.span(c)
        before = self.result
        self.result = None
        for child in c.get_children():
            if not self.inside(child, around):
                continue
            if child.kind == K.COMPOUND_STMT:
                self.statement(child)
            elif child.kind.is_expression() and child.kind != K.DECL_REF_EXPR:
                self.expression(child)
        self.result = before


def write(text, mutants):
    """The text with these mutants in it, under their numbers, and where each now stands in it:
    [(begin, end, mutant)]."""
    edits, order = [], 0  # (offset, what comes first there, ..., text, until, what begins or ends)
    for mutant in sorted(mutants, key=lambda m: (m.begin, -m.end)):
        for begin, end, prefix, suffix in mutant.wraps:
            order += 1
            # What has no width stands behind a parenthesis, in front of all that begins there.
            edits.append((begin, 1, -end if begin < end else -len(text) - 1, order,
                          prefix.replace('@', str(mutant.number)), begin, mutant))
            edits.append((end, 0 if begin < end else 2, -begin, -order, suffix, end, None))
        edits += [(begin, 3, 0, order, instead, end, None) for begin, end, instead in mutant.tokens]
    edits.sort(key=lambda e: e[:4])
    out, done, length, opened, places = [], 0, 0, {}, []
    for at, _, _, order, piece, until, mutant in edits:
        length += at - done
        if mutant is not None:
            opened[order] = length, mutant
        length += len(piece)
        if mutant is None and -order in opened:
            begin, whose = opened.pop(-order)
            places.append((begin, length, whose))
        out += [text[done:at], piece]
        done = until
    out.append(text[done:])
    return ''.join(out), places
