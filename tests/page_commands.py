# SPDX-License-Identifier: Apache-2.0
"""Checks the commands that a page shows, without running them. For pages.py.

`bash -n` reads each block. Then each command must be one that a reader can type: a script, program,
preset, target, test or verb of this tree, with options that it has, or one of OTHERS.
"""

import json
import re
import shlex
import subprocess

# Commands that are not this tree's.
OTHERS = {'addr2line', 'apt-get', 'base64', 'cc', 'clang++', 'clang-format-14', 'echo', 'export', 'g++', 'jq', 'kill', 'mkdir', 'node', 'npm', 'objdump', 'pkg-config', 'rosrun', 'unshare', 'valgrind', 'wait'}
FOLDERS = re.compile(r'(bench|cmake|docs|examples|fuzz|include|scripts|src|tests)/[\w./-]+')
ENDS = {'&&', '||', '|', ';', '&', '(', ')'}
REDIRECTIONS = {'>', '>>', '<', '2>'}


def commands(line):
    """The commands of a line, as lists of words."""
    inner = re.findall(r'\$\(([^()]*)\)', line)
    line = re.sub(r'\$\([^()]*\)', 'OUTPUT', line)
    lexer = shlex.shlex(line, posix=True, punctuation_chars=True)
    lexer.whitespace_split = True
    found, words = [], iter(lexer)
    command = []
    for word in words:
        if word in ENDS:
            found.append(command)
            command = []
        elif word in REDIRECTIONS:
            next(words, None)
        else:
            command.append(word)
    return [c for c in [*found, command] if c] + [c for part in inner for c in commands(part)]


class Tree:
    """What the tree at `root` has that a command can name."""

    def __init__(self, root):
        self.root = root
        presets = json.loads((root / 'CMakePresets.json').read_text())
        self.presets = {kind: {p['name'] for p in presets[kind + 'Presets'] if not p.get('hidden')}
                        for kind in ('configure', 'build', 'test')}
        folders = ('bench', 'cmake', 'examples', 'fuzz', 'src', 'tests')
        lists = [root / 'CMakeLists.txt', *root.glob('cmake/*.cmake'),
                 *(path for folder in folders for path in (root / folder).rglob('CMakeLists.txt'))]
        text = '\n'.join(path.read_text() for path in lists)
        self.cmake_words = set(re.findall(r'\w+', text))
        self.cmake_words |= {f'{name}_fuzz{end}' for name in re.findall(r'\blot_fuzz\((\w+)', text)
                             for end in ('', '_replay')}
        self.variables = set(re.findall(r'"(LOT_\w+)"', self.sources('src')))

    def sources(self, folder):
        return '\n'.join(path.read_text() for end in ('cpp', 'hpp')
                         for path in sorted((self.root / folder).rglob('*.' + end)))

    def complaints(self, words):
        """What is wrong with one command."""
        while words and re.match(r'\w+=', words[0]):
            variable = words[0].split('=')[0]
            if variable.startswith('LOT_') and variable not in self.variables:
                yield f'no such variable: {variable}'
            words = words[1:]
        if not words:
            return
        for word in words:
            if FOLDERS.fullmatch(word) and not (self.root / word).exists():
                yield f'no such file: {word}'
        name, arguments = words[0], words[1:]
        if name in ('cmake', 'ctest'):
            yield from self.of_cmake(name, arguments)
        elif name == 'lot':
            yield from self.of_program('src/tool', arguments)
        elif name == 'roslaunch':
            yield from self.of_roslaunch(arguments)
        elif FOLDERS.fullmatch(name):
            if (self.root / name).is_file():
                yield from self.of_script(name, arguments)
        elif name.startswith('build/'):
            yield from self.of_build(name, arguments)
        elif name not in OTHERS and not re.fullmatch(r'\./\w+', name):  # ./NAME: a program of the reader
            yield f'no such command: {name} (tests/page_commands.py: OTHERS)'

    def of_cmake(self, name, arguments):
        kind = 'test' if name == 'ctest' else 'build' if '--build' in arguments else 'configure'
        for option, value in zip(arguments, [*arguments[1:], '']):
            if option == '--preset' and value not in self.presets[kind]:
                yield f'no such preset: {value}'
            elif option == '--target' and value not in self.cmake_words:
                yield f'no such target: {value}'
            elif option == '-R' and not any(re.search(value, word) for word in self.cmake_words):
                yield f'no such test: {value}'
            elif option.startswith('-DLOT_') and re.match(r'-D(\w+)', option).group(1) not in self.cmake_words:
                yield f'no such option: {option}'

    def of_program(self, folder, arguments):
        text = self.sources(folder)
        verbs = re.findall(r'add_(?:subcommand|verb)\(\s*(?:app, )?"(\w+)"', text)
        if verbs and arguments and re.fullmatch('[a-z]+', arguments[0]) and arguments[0] not in verbs:
            yield f'no such verb: {arguments[0]}'
        yield from self.options(arguments, text)

    def of_script(self, name, arguments):
        text = (self.root / name).read_text()
        yield from self.options(arguments, text)
        if name == 'scripts/test':
            stages = re.search(r'^stages=\((.*?)\)', text, re.M).group(1).split()
            for option, value in zip(arguments, arguments[1:]):
                if option == '--stage' and value not in stages:
                    yield f'no such stage: {value}'
        if name == 'scripts/setup':
            groups = set(re.findall(r'^(\w+)=\(', text, re.M)) - {'wanted', 'missing', 'as_root'}
            yield from (f'no such group: {group}' for group in arguments if group not in groups)

    def of_build(self, name, arguments):
        _, *folders, program = name.split('/')
        if folders and folders[0] in self.presets['configure']:
            folders = folders[1:]
        folder = self.root.joinpath(*folders)
        if not folder.is_dir():
            yield f'no such preset: {folders[0]}'
        elif program not in self.cmake_words or not any((f / 'CMakeLists.txt').exists()
                                                        for f in (folder, folder.parent)):
            yield f'no such program: {name}'
        else:
            yield from self.of_program(folder, arguments)

    def of_roslaunch(self, arguments):
        if arguments[0] != 'lot':
            return
        files = list(self.root.glob('examples/**/' + arguments[1]))
        if not files:
            yield f'no such file: {arguments[1]}'
            return
        for argument in arguments[2:]:
            if f'<arg name="{argument.split(":=")[0]}"' not in files[0].read_text():
                yield f'{arguments[1]} has no argument {argument}'

    @staticmethod
    def options(arguments, text):
        """Long options that the program's text does not have. Google Benchmark's are its own."""
        for argument in arguments:
            option = argument.split('=')[0]
            if re.fullmatch(r'--[a-z][\w-]*', option) and not option.startswith('--benchmark_') and \
                    option not in ('--help', '--version') and option not in text:
                yield f'no such option: {option}'


def complaints(tree, code):
    """What is wrong with a block of commands: pairs of line (0 is the first) and text."""
    run = subprocess.run(['bash', '-n'], input=code, capture_output=True, text=True)
    if run.returncode != 0:
        return [(0, f'bash does not read this: {run.stderr.strip()}')]
    found, joined, begin = [], '', 0
    for number, line in enumerate(code.split('\n')):
        if not joined:
            begin = number
        joined += line
        if joined.endswith('\\'):
            joined = joined[:-1]
            continue
        found += [(begin, text) for words in commands(joined) for text in tree.complaints(words)]
        joined = ''
    return found
