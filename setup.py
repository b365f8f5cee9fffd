# SPDX-License-Identifier: Apache-2.0
"""Builds the package `lot` by CMake: for pip, which reads pyproject.toml. In the environment: LOT_CMAKE_OPTIONS, more options of
CMake; LOT_BUILD_TREE, a tree of CMake that is configured already, in place of one that is made and thrown away."""

import os
import pathlib
import re
import shlex
import subprocess
import sys

from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext

ROOT = pathlib.Path(__file__).resolve().parent
SCRATCH = ROOT / 'build' / 'pip'
VERSION = re.search(r'^ *VERSION ([0-9.]+)$', (ROOT / 'CMakeLists.txt').read_text(), re.M)[1]
OPTIONS = ['-DCMAKE_BUILD_TYPE=Release', '-DCMAKE_UNITY_BUILD=ON', '-DLOT_LIBRARY_UNITY=ON', '-DLOT_BUILD_PYTHON=ON', '-DLOT_BUILD_RECORD=ON',
           *(f'-DLOT_BUILD_{what}=OFF' for what in ('TOOL', 'TESTS', 'BENCH', 'EXAMPLES', 'ROS'))]


class BuildByCMake(build_ext):
    def build_extension(self, extension):
        known = os.environ.get('LOT_BUILD_TREE')
        tree = pathlib.Path(known or self.build_temp).resolve()
        if not known:
            subprocess.run(['cmake', '-S', ROOT, '-B', tree, f'-DPYTHON_EXECUTABLE={sys.executable}', *OPTIONS,
                            *shlex.split(os.environ.get('LOT_CMAKE_OPTIONS', ''))], check=True)
        subprocess.run(['cmake', '--build', tree, '--target', 'lot_python', '--parallel', str(os.cpu_count())], check=True)
        built, = (tree / 'python' / 'lot').glob('_lot.*.so')
        self.copy_file(built, self.get_ext_fullpath(extension.name))


SCRATCH.mkdir(parents=True, exist_ok=True)
setup(version=VERSION, packages=['lot'], package_dir={'lot': 'src/python/lot'}, package_data={'lot': ['*.pyi', 'py.typed']},
      ext_modules=[Extension('lot._lot', [])], cmdclass={'build_ext': BuildByCMake}, zip_safe=False,
      options={'build': {'build_base': str(SCRATCH)}, 'egg_info': {'egg_base': str(SCRATCH)}})
