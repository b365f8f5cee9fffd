#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Checks that `lot --help`, what the shells offer, and the man pages name the same verbs and options.

    words_test.py LOT               check the files of this tree against the program LOT
    words_test.py LOT --self-test   take each option away from each file, and see that this is found
"""

import json
import os
import pathlib
import re
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[2]
COMPLETIONS = ROOT / 'src/tool/completions'
PAGES = ROOT / 'docs/man'
OPTION = re.compile(r'^ +(?:(-\w),)?(--[\w-]+)(?: ([A-Z]+)(?![a-z]))?', re.M)
VERB = re.compile(r'^  ([a-z]+)  ', re.M)
SOMETIMES = {'segment', 'other_file'}  # checks of what may not be there


def run(*words, **more):
    done = subprocess.run(words, text=True, capture_output=True, timeout=60, check=False, **more)
    if done.returncode not in (0, 1):
        raise RuntimeError(f'{words}: {done.stderr}')
    return done.stdout


class Program:
    """What the program says of itself."""

    def __init__(self, path):
        text = run(path, '--help')
        self.verbs = set(VERB.findall(text[text.index('Subcommands:'):text.index('Exit status:')]))
        self.options = {'': self.parse(text)}
        self.options.update((verb, self.parse(run(path, verb, '--help'))) for verb in self.verbs)
        findings = json.loads(run(path, 'doctor', '--json'))['findings']
        self.checks = {finding['check'] for finding in findings}

    @staticmethod
    def parse(text):
        """{'--segment': ('-s', 'NAME'), ...}"""
        return {long: (short, argument) for short, long, argument in OPTION.findall(text)}

    def names(self, verb):
        """All options of a verb, short ones too."""
        return set(self.options[verb]) | {short for short, _ in self.options[verb].values() if short}


def difference(what, found, expected):
    found, expected = set(found), set(expected)
    for name in sorted(expected - found):
        yield f'{what}: {name} is missing'
    for name in sorted(found - expected):
        yield f'{what}: {name} is none'


# ---- shells -------------------------------------------------------------------------------------------

BASH = '''source "$1"; shift
COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); COMPREPLY=(); _lot
if ((${#COMPREPLY[@]})); then printf '%s\\n' "${COMPREPLY[@]}"; fi'''


def in_bash(file, *line, **env):
    return run('bash', '-c', BASH, 'bash', file, *line, env={**os.environ, **env}).splitlines()


def check_bash(program, text):
    with tempfile.TemporaryDirectory() as scratch:
        file = f'{scratch}/lot'
        pathlib.Path(file).write_text(text)
        yield from difference('bash: lot', in_bash(file, 'lot', ''), program.verbs)
        for verb in sorted(program.options):
            line = ('lot', verb, '-') if verb else ('lot', '-')
            yield from difference(f'bash: lot {verb}', in_bash(file, *line), program.names(verb))
        for name in ('one', 'two words', 'no_segment.lock'):
            pathlib.Path(f'{scratch}/{name}').touch()
        for name in ('one.lock', 'two words.lock'):
            pathlib.Path(f'{scratch}/{name}').touch()
        segments = ['one', 'two\\ words']
        for line in (('lot', 'ls', '-d', scratch, '-s', ''), ('lot', '--dir', '=', scratch, 'who', '--segment', '='),
                     ('lot', '--json', '-d', scratch, 'clean', '--segment', '=', '')):
            yield from difference(f'bash: {line}', in_bash(file, *line), segments)
        yield from difference('bash: LOT_DIR', in_bash(file, 'lot', 'ls', '-s', 'o', LOT_DIR=scratch), ['one'])
        for line in (('lot', 'ls', '--interval', ''), ('lot', 'ls', ''), ('lot', 'fly', '-')):
            yield from difference(f'bash: {line}', in_bash(file, *line), [])


def check_fish(program, text):
    def offers(line):
        done = run('fish', '--no-config', '-c', f'{text}\ncomplete -C "{line}"')
        return [words.split('\t')[0] for words in done.splitlines()]

    yield from difference('fish: lot', offers('lot '), program.verbs)
    for verb in sorted(program.options):
        line = f'lot {verb} ' if verb else 'lot '
        found = set(offers(line + '-')) | set(offers(line + '--'))
        yield from difference(f'fish: {line}', (o for o in found if not re.match(r'-\w.', o)), program.names(verb))


def check_zsh(program, text):
    with tempfile.NamedTemporaryFile('w', suffix='.zsh') as file:
        file.write(text)
        file.flush()
        done = subprocess.run(['zsh', '-n', file.name], text=True, capture_output=True, check=False)
        if done.returncode != 0:
            yield f'zsh: {done.stderr}'

    def options(part):
        groups = re.findall(r"^ *(?:_arguments \$common )?'(?:\([^)]*\)'?)?(?:'?\{([^}]*)\})?'?(--?[\w-]+)?\[?", part, re.M)
        return {o for braces, single in groups for o in braces.split(',') + [single] if o}

    common = options(text[text.index('common=('):text.index('verbs=(')])
    verbs = re.findall(r"^ +'(\w+):", text[text.index('verbs=('):text.index('_arguments -C')], re.M)
    yield from difference('zsh: lot', verbs, program.verbs)
    first = text[text.index('_arguments -C'):text.index("'1:verb")]
    yield from difference('zsh: lot ', common | options(first), program.names(''))
    for verb in sorted(program.verbs):
        part = re.search(rf'^ +{verb}\)\n(.*?);;', text, re.M | re.S)
        found = common | options(part.group(1)) if part and '$common' in part.group(1) else set()
        yield from difference(f'zsh: lot {verb}', found, program.names(verb))


# ---- pages --------------------------------------------------------------------------------------------

def items(text, section):
    """The heads of the lists in a section of a page."""
    body = re.search(rf'^\.Sh {section}\n(.*?)(?=^\.Sh |\Z)', text, re.M | re.S)
    return re.findall(r'^\.It (.*)', body.group(1), re.M) if body else []


def check_page(program, name, text):
    verb = name.partition('-')[2]
    done = subprocess.run(['mandoc', '-T', 'lint', '-W', 'warning'], input=text, text=True, capture_output=True,
                          check=False)
    if done.returncode != 0:
        yield f'{name}: {done.stdout}{done.stderr}'
    found = set()
    for head in items(text, 'OPTIONS'):
        option = re.fullmatch(r'(?:Fl (\w) , )?Fl Fl ([\w-]+)(?: Ar ([A-Z]+))?', head)
        found.add((option[1] and f'-{option[1]}' or '', f'--{option[2]}', option[3] or '') if option else (head, '', ''))
    expected = {(short, long, argument) for long, (short, argument) in program.options[verb].items()}
    yield from difference(name, (' '.join(o).strip() for o in found), (' '.join(o).strip() for o in expected))
    synopsis = re.search(r'^\.Sh SYNOPSIS\n(.*?)^\.Sh', text, re.M | re.S).group(1)
    short = {f'-{o}' for o in re.findall(r'(?<!Fl )\bFl (\w)\b', synopsis)}
    long = {f'--{o}' for o in re.findall(r'Fl Fl ([\w-]+)', synopsis)}
    expected = {s or l for l, (s, _) in program.options[verb].items()} - {'-h'}
    yield from difference(f'{name}, SYNOPSIS', {o for o in short | long if o != '--help'}, expected)
    if not verb:
        yield from difference(name, re.findall(r'^\.It Xr lot-(\w+) 1', text, re.M), program.verbs)
    if verb in ('ls', 'who'):
        heads = set()
        for table in re.findall(r'[Tt]able[ \w]*[({]\{(.*?)\}', (ROOT / f'src/tool/{verb}.cpp').read_text(), re.S):
            heads |= set(re.findall(r'"([A-Z ]+)"', table))
        explained = {head.removeprefix('Li ') for head in items(text, 'OUTPUT')}
        yield from (f'{name}: the column {head} is missing' for head in sorted(heads - explained))
        if not heads:
            yield f'{name}: no table was found in the source'
    if verb in ('hz', 'bw', 'delay'):
        head = re.search(r'Row head\(\) const override \{(.*?)^  \}', (ROOT / f'src/tool/{verb}.cpp').read_text(), re.M | re.S)
        explained = {column for item in items(text, 'OUTPUT') for column in item.removeprefix('Li ').split(' , ')}
        yield from difference(f'{name}, OUTPUT', explained, re.findall(r'"([A-Z0-9]+)"', head.group(1)))
    if verb == 'top':
        columns = re.findall(r"^ +\{'(\w)', (?:\"(\w+)\"|nullptr), (?:\"(\w+)\"|nullptr), ",
                             (ROOT / 'src/tool/board.cpp').read_text(), re.M)
        heads = {head for _, *both in columns for head in both if head}
        yield from difference(f'{name}, OUTPUT', (head.removeprefix('Li ') for head in items(text, 'OUTPUT')), heads)
        letters = next((head for head in items(text, 'KEYS') if head.startswith('Li n ,')), '')
        yield from difference(f'{name}, KEYS', re.findall(r'\b[a-z]\b', letters), (key for key, *_ in columns))
    if verb == 'doctor':
        checks = {head.removeprefix('Li ') for head in items(text, 'CHECKS')}
        yield from difference(name, checks - SOMETIMES, program.checks - SOMETIMES)
        yield from difference(name, checks & SOMETIMES, SOMETIMES)


# ---- all ----------------------------------------------------------------------------------------------

CHECKS = {'lot.bash': check_bash, 'lot.fish': check_fish, 'lot.zsh': check_zsh}


def texts():
    files = {file.name: file.read_text() for file in COMPLETIONS.iterdir()}
    files.update((file.stem, file.read_text()) for file in [PAGES / 'lot.1', *PAGES.glob('lot-*.1')])
    return files


def complaints(program, name, text):
    if name in CHECKS:
        return list(CHECKS[name](program, text))
    return list(check_page(program, name, text))


def without(text, word):
    """The text with one word less; in a page, with a line less."""
    offered = re.sub(rf'^(.*words\b.*?) ?--{word}(?![\w-])', r'\1', text, flags=re.M)
    if offered != text:  # bash: the lists alone, so that the file is a program still
        yield offered
    for pattern in (rf'^\.It (Fl \w , )?Fl Fl {word}\b.*\n', rf'^\.It (Li|Xr) (lot-)?{word}\b.*\n',
                    rf'(?<![\w-])--{word}(?![\w-])', rf' -l {word} ', rf'^.* -a {word} .*$',
                    rf'^ +\'{word}:.*$', rf'(?<=[\' ]){word}(?=[\' ])'):
        changed = re.sub(pattern, ' ', text, flags=re.M)
        if changed != text:
            yield changed


def self_test(program):
    missed, count = [], 0
    words = {o.lstrip('-') for verb in program.options for o in program.options[verb]} | program.verbs
    for name, text in texts().items():
        if name in CHECKS or name == 'lot':
            wanted = words
        else:
            wanted = {o.lstrip('-') for o in program.options[name.partition('-')[2]]}
        if name == 'lot-doctor':
            wanted |= program.checks
        if name == 'lot':
            wanted = {o.lstrip('-') for o in program.options['']} | program.verbs
        for word in sorted(wanted):
            changed = next(without(text, word), None)
            count += 1
            if changed is None or not complaints(program, name, changed):
                missed.append(f'{name}: without {word} it is as good')
    return missed, count


def main(arguments):
    program = Program(arguments[0])
    if arguments[1:] == ['--self-test']:
        wrong, count = self_test(program)
        print('\n'.join(wrong + [f'words self-test: {count} mistakes, {len(wrong)} not found']))
        return 1 if wrong or not count else 0
    wrong = []
    names = {'lot', *(f'lot-{verb}' for verb in program.verbs), *CHECKS}
    files = texts()
    wrong += difference('files', files, names)
    for name in sorted(names & set(files)):
        wrong += complaints(program, name, files[name])
    print('\n'.join(wrong + [f'words: {len(wrong)} wrong']))
    return 1 if wrong else 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
