#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The messages of ROS 2 that the gateway knows, beside the definitions of @foxglove/rosmsg-msgs-common.

    ros_schema_test.py PROGRAM MODULES

PROGRAM is gateway_ros_schema; MODULES the node_modules that scripts/setup makes.
"""

import pathlib
import shutil
import subprocess
import sys


def main():
    program, modules = sys.argv[1:]
    if not (shutil.which('node') and pathlib.Path(modules, '@foxglove', 'rosmsg-msgs-common').is_dir()):
        print('skipped: no packages of npm here (scripts/setup test)')
        return 0
    judge = pathlib.Path(__file__).resolve().parent / 'ros_schema_judge.mjs'
    return subprocess.run(['node', judge, program, modules], check=False).returncode


if __name__ == '__main__':
    sys.exit(main())
