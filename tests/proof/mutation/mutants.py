# SPDX-License-Identifier: Apache-2.0
"""The mutants that are made at run time: weaker orders and re-checks that are left out."""

import dataclasses
import pathlib
import re
import subprocess

import sites

HEADERS = ('src/lockfree_ring', 'src/refcount', 'src/recovery',
           'src/robust_mutex/robust_condition.hpp', 'src/robust_mutex/lock_word.hpp',
           'src/segment/granules.hpp', 'src/segment/units.hpp',
           'src/selection/bounds.hpp', 'src/selection/selector.hpp')

# One step weaker. A step of a compare-exchange that fails is a load.
LOAD = {'seq_cst': ('acquire',), 'acquire': ('relaxed',)}
STORE = {'seq_cst': ('release',), 'release': ('relaxed',)}
BOTH = {'seq_cst': ('acq_rel',), 'acq_rel': ('acquire', 'release'), 'acquire': ('relaxed',),
        'release': ('relaxed',)}
WEAKER = {'load': LOAD, 'store': STORE, 'rmw': BOTH, 'compare_exchange': BOTH}

SEEN = re.compile(r'^site (\S+):(\d+):(\d+) ', re.M)


@dataclasses.dataclass(frozen=True)
class Mutant:
    site: sites.Site
    written: str
    instead: str  # as lot_model's --weaken says it: an order, fail:ORDER, or stale

    @property
    def key(self):
        return f'{self.site.key} {self.written}>{self.instead}'


def all_sites(root):
    """Every atomic step of the headers under test."""
    files = []
    for name in HEADERS:
        path = root / name
        files += sorted(path.glob('*.hpp')) if path.is_dir() else [path]
    found = [site for file in files for site in sites.find(file)]
    names = [pathlib.PurePath(f).name for f in files]
    if len(set(names)) != len(names):
        raise ValueError('two headers have the same name')
    return found


def of_orders(found):
    """A mutant for each order that can be weaker."""
    mutants = []
    for site in found:
        for order in WEAKER[site.kind].get(site.orders[0], ()):
            mutants.append(Mutant(site, site.orders[0], order))
        for failure in site.orders[1:]:
            for order in LOAD.get(failure, ()):
                mutants.append(Mutant(site, failure, 'fail:' + order))
    return mutants


def of_rechecks(found, path):
    """A mutant for each line of the list of re-checks that are one load: FUNCTION: CODE # why."""
    mutants = []
    for line in path.read_text().splitlines():
        line = line.split(' # ')[0].strip()
        if not line or line.startswith('#'):
            continue
        function, expression = (part.strip() for part in line.split(':', 1))
        expression, _, nth = expression.partition('#')
        matching = [s for s in found if s.function == function and s.method == 'load'
                    and s.expression == expression and s.occurrence == int(nth or 1)]
        if len(matching) != 1:
            raise ValueError(f'{path.name}: the re-check is no longer there: {line}')
        mutants.append(Mutant(matching[0], matching[0].orders[0], 'stale'))
    return mutants


def places(model, found):
    """{site key: FILE:LINE:COLUMN} of the steps that the model reaches, as it calls them."""
    run = subprocess.run([model, '--random', '1000', '--sites'], capture_output=True, text=True,
                         check=True, timeout=600)
    places = {}
    for name, line, column in SEEN.findall(run.stdout):
        at = int(line), int(column)
        around = [s for s in found if s.file == name and s.holds(*at)]
        if around:  # the innermost: an expression may have another one inside
            site = min(around, key=sites.Site.size)
            places.setdefault(site.key, f'{name}:{line}:{column}')
    return places
