#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Writes a header with a mistake in it, one of tests/proof/mutation/recovery.py.

    plant.py --mistake NAME --into DIR

The header lies under DIR as it lies under src, so that a compiler that looks there first finds it.
Fails where there is no such mistake, or the header has no place for it.
"""

import argparse
import pathlib
import sys

ROOT = pathlib.Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / 'tests' / 'proof' / 'mutation'))

import recovery  # noqa: E402  (it lies there)


def main():
    parser = argparse.ArgumentParser(usage=__doc__)
    parser.add_argument('--mistake', required=True)
    parser.add_argument('--into', type=pathlib.Path, required=True)
    options = parser.parse_args()
    chosen = [m for m in recovery.MISTAKES if m.name == options.mistake]
    if len(chosen) != 1:
        parser.error(f'{len(chosen)} mistakes have that name')
    file = options.into / pathlib.Path(chosen[0].file).relative_to('src')
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(recovery.changed(chosen[0], (ROOT / chosen[0].file).read_text()))
    return 0


if __name__ == '__main__':
    sys.exit(main())
