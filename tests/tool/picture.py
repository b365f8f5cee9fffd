#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Draws what a terminal shows: the picture of `lot top` in README.md.

    picture.py CAPTURE SVG     draws a capture (tmux capture-pane -e) into the file SVG
    picture.py --docs BUILD    has the test in the tree BUILD make the scene, and writes docs/lot-top.svg

Needs python3-rich of Debian, and so Debian's own python3.
"""

import os
import pathlib
import re
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parents[2]
CASE = 'the picture of lot top*'
ROW, COLUMN = 24.4, 12.2  # of a letter, in rich's units
BLANK = '&#160;'
PIECE = re.compile(r'<text class="(?P<name>[\w-]+)" x="(?P<x>[\d.]+)" y="(?P<y>[\d.]+)" textLength="(?P<length>[\d.]+)"'
                   r' clip-path="[^"]*">(?P<blanks>(?:&#160;)*)(?P<words>[^<]*)</text>', re.S)
# As that of rich, but for its fonts from the network.
FORMAT = '''<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} HEIGHT">
<!-- Made by tests/tool/picture.py -->
<style>
.{unique_id}-matrix {{ font-family: "DejaVu Sans Mono", Menlo, Consolas, monospace; font-size: {char_height}px; line-height: {line_height}px; }}
{styles}
</style>
<rect width="{width}" height="HEIGHT" rx="8" fill="#181818"/>
<g transform="translate({terminal_x}, 12)">
{backgrounds}
<g class="{unique_id}-matrix">
{matrix}
</g>
</g>
</svg>
'''


def without_indent(text):
    """A piece of text that begins with its first letter: some viewers swallow blanks before it."""
    blanks = len(text['blanks']) // len(BLANK)
    if not text['words'].replace(BLANK, '').strip():
        return ''
    x = round(float(text['x']) + blanks * COLUMN, 1)
    length = round(float(text['length']) - blanks * COLUMN, 1)
    return f'<text class="{text["name"]}" x="{x}" y="{text["y"]}" textLength="{length}">{text["words"]}</text>'


def draw(capture):
    from rich.console import Console
    from rich.terminal_theme import SVG_EXPORT_THEME
    from rich.text import Text
    lines = capture.rstrip('\n').split('\n')
    text = Text.from_ansi('\n'.join(lines))
    width = max(len(line) for line in text.plain.split('\n'))
    with open(os.devnull, 'w', encoding='utf-8') as nowhere:
        console = Console(record=True, width=width, file=nowhere, force_terminal=True, color_system='standard',
                          legacy_windows=False)
        console.print(text, no_wrap=True, overflow='crop')
        svg = console.export_svg(title='', theme=SVG_EXPORT_THEME, code_format=FORMAT)
    # rich leaves room for a title.
    svg = PIECE.sub(without_indent, svg)
    svg = svg.replace('HEIGHT', str(round(ROW * len(lines)) + 24))
    return '\n'.join(line.rstrip() for line in svg.split('\n'))


def main(arguments):
    if len(arguments) != 2:
        print(__doc__, file=sys.stderr)
        return 2
    if arguments[0] != '--docs':
        pathlib.Path(arguments[1]).write_text(draw(pathlib.Path(arguments[0]).read_text()))
        return 0
    program = ROOT / arguments[1] / 'tests/tool_top'
    environment = {**os.environ, 'LOT_PICTURE': str(ROOT / 'docs/lot-top.svg')}
    return subprocess.run([program, f'--test-case={CASE}'], env=environment, check=False).returncode


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
