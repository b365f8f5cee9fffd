#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The five lines of Python in README.md show the demo's frames, and the examples in Python do what they say.

    pages_test.py PACKAGES DEMO CHAIN PEER [unittest's arguments]     DEMO, CHAIN, PEER: programs
"""

import contextlib
import os
import pathlib
import re
import subprocess
import sys
import tempfile
import unittest

PACKAGES, DEMO, CHAIN, PEER = sys.argv[1:5]
del sys.argv[1:5]
ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
EXAMPLES = ROOT / 'examples' / 'python'
RUNTIME = os.environ.pop('LD_PRELOAD', '')  # of a sanitizer, for Python alone
PYTHON = dict(os.environ, PYTHONPATH=PACKAGES, **({'LD_PRELOAD': RUNTIME} if RUNTIME else {}))
FRAMES, BYTES = 30, 1 << 20


def python(*words, **options):
    return subprocess.run([sys.executable, *map(str, words)], env=PYTHON, capture_output=True, text=True, timeout=100, **options)


class Pages(unittest.TestCase):
    def passed(self, done):
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        return done.stdout.splitlines()

    @contextlib.contextmanager
    def camera(self):
        """The demo's, in its second life: it waits for no consumer. It leaves when its input ends."""
        camera = subprocess.Popen([DEMO, '--role=ring-camera', '--run=2', f'--frames={FRAMES}', '--hz=20', f'--bytes={BYTES}'],
                                  stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.addCleanup(camera.kill)
        self.assertIn('ready', camera.stdout.readline())
        yield
        camera.communicate(timeout=100)  # its output is read to the end: else SIGPIPE would kill it
        self.assertEqual(camera.returncode, 0)

    def test_the_lines_of_the_readme_show_live_frames(self):
        lines = re.search(r'^```python\n(.*?)^```$', (ROOT / 'README.md').read_text(), re.M | re.S)[1]
        self.assertEqual(len(lines.splitlines()), 5)
        with self.camera():
            seen = [[int(word) for word in line.split()] for line in self.passed(python('-c', lines))]
        self.assertGreater(len(seen), 1)
        for number, size, last in seen:
            self.assertEqual((size, last), (BYTES, number))
        self.assertEqual(seen[-1][0], FRAMES - 1)

    def test_the_viewer_looks_at_any_topic(self):
        with self.camera():
            lines = self.passed(python(EXAMPLES / 'viewer.py', '/camera/front', 3))
        self.assertEqual(len(lines), 3)
        self.assertRegex(lines[0], rf'^0: \({BYTES},\) uint8, mean \d')

    def test_the_detector_stands_between_two_nodes_in_cpp(self):
        lines = self.passed(python(EXAMPLES / 'detector.py', CHAIN))
        self.assertEqual([line.split(';')[0] for line in lines], [f'frame {n}: {4 << 20} bytes' for n in range(1, 6)])
        self.assertIn('pixel 5000 is the brightest', lines[-1])

    def test_the_tasks_of_a_killed_worker_are_done(self):
        self.assertEqual(self.passed(python(EXAMPLES / 'tasks.py'))[-1], '1 worker was killed, 12 tasks are done')

    def test_the_service_answers(self):
        lines = self.passed(python(EXAMPLES / 'service.py'))
        self.assertEqual(lines[0], '[3. 4. 3.]')
        self.assertIn('a window has one value or more', lines[1])

    def delays(self, stamp):
        """What delays.py says of a recording of ten messages."""
        program = ("import lot, subprocess, sys\n@lot.message\nclass Point:\n    x: lot.f64\n"
                   f"pub = lot.Engine().advertise('/topic', Point, stamp={stamp})\n"
                   "push = lambda: pub.push(pub.loan(x=1))\npush()\n"
                   "with subprocess.Popen([sys.argv[1], 'record', sys.argv[2]], stdin=-1, stdout=-1) as peer:\n"
                   "    peer.stdout.readline()\n    for _ in range(9): push()\n    peer.stdin.close()\n")
        with tempfile.TemporaryDirectory() as folder:
            file, plot = os.path.join(folder, 'some.mcap'), os.path.join(folder, 'plot.png')
            env = dict(PYTHON)
            self.passed(subprocess.run([sys.executable, '-c', 'import os; os.environ.pop("LD_PRELOAD", 0)\n' + program, PEER, file],
                                       env=env, capture_output=True, text=True))
            return self.passed(python(EXAMPLES / 'delays.py', file, plot))

    def test_delays_of_a_recording_are_figures(self):
        lines = self.delays(stamp=True)
        self.assertRegex(lines[0], '^/topic: 10 of ')
        self.assertRegex(lines[1], r'^/topic: median \d+ us, p99')

    def test_delays_without_stamps_are_unknown(self):
        self.assertEqual(self.delays(stamp=False)[1:], ['/topic: unknown, no message has a stamp'])


if __name__ == '__main__':
    unittest.main()
