# SPDX-License-Identifier: Apache-2.0
"""How the tests of lot_ab check: all of them run, and what failed is counted."""

import sys

_failures = []


def check(good, what):
    print(('ok      ' if good else 'FAILED  ') + what, flush=True)
    if not good:
        _failures.append(what)


def run(tests, *arguments):
    """Calls each test, and ends the program: 1 if anything failed."""
    for test in tests:
        try:
            test(*arguments)
        except Exception as e:  # pylint: disable=broad-except  # the others still say something
            check(False, f'{test.__name__}: {e!r}')
    print(f'{len(_failures)} failed')
    sys.exit(1 if _failures else 0)
