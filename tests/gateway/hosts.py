# SPDX-License-Identifier: Apache-2.0
"""Two hosts for the tests of the gateway: network namespaces with a cable between them, and programs in them."""

import os
import pathlib
import signal
import subprocess
import sys
import tempfile
import time

NO_ROOT = 'containers with networks of their own need root'
NO_NETWORK = 'no network between containers here'
CABLE = 'lot0'
FORWARDER = pathlib.Path(__file__).with_name('forwarder.py')
PATIENCE_S = 60


def address(host):
    return f'10.77.0.{host + 1}'


class Refused(Exception):
    """This system gives no namespaces, and why."""


def skipped():
    """What a program says that cannot have hosts here."""
    return f'skipped: {NO_ROOT if os.geteuid() != 0 else NO_NETWORK}'


def must(*command):
    result = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    if result.returncode != 0:
        raise Refused(f'{" ".join(command)}: {result.stdout.strip()}')


class Program:
    """A program that runs; it is killed with the test."""

    def __init__(self, name, command, folder, **environment):
        self.name = name
        self.out = pathlib.Path(folder, f'{name}.{time.monotonic_ns()}')
        with open(self.out, 'wb') as out:
            self.process = subprocess.Popen(['setpriv', '--pdeathsig', 'KILL', *map(str, command)], stdout=out, stderr=out,
                                            env={**os.environ, **environment})

    def said(self):
        return self.out.read_text(errors='replace')

    def wait_for(self, text):
        self.wait_until(lambda: text in self.said(), repr(text))

    def wait_until(self, is_true, what):
        until = time.monotonic() + PATIENCE_S
        while not is_true():
            if self.process.poll() is not None or time.monotonic() > until:
                raise AssertionError(f'{self.name} does not say {what} (exit status {self.process.poll()}):\n{self.said()}')
            time.sleep(0.02)

    def wait_for_lines(self, more):
        """Until it has said so many lines more than now."""
        now = self.said().count('\n')
        self.wait_until(lambda: self.said().count('\n') >= now + more, f'{more} more lines')

    def finish(self):
        """Waits until it ends by itself, and well."""
        try:
            status = self.process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            status = 'none'
        if status != 0:
            raise AssertionError(f'{self.name} ends with {status}:\n{self.said()}')

    def kill(self, number=signal.SIGKILL):
        if self.process.poll() is None:
            self.process.send_signal(number)
        self.process.wait(PATIENCE_S)


class Hosts:
    """A context: two hosts, 0 and 1, each with an address, and a segment of its own.

    `bad`: their cable is one that loses: (seed, percent of the frames, milliseconds that the others take).
    """

    def __init__(self, bad=None):
        if os.geteuid() != 0:
            raise Refused(NO_ROOT)
        self.programs = []
        self.bad = bad
        self.forwarder = None
        self.folder = tempfile.TemporaryDirectory(prefix='lot_gateway.')
        self.holders = [subprocess.Popen(['setpriv', '--pdeathsig', 'KILL', 'unshare', '--net', 'sleep', 'infinity'],
                                         stderr=subprocess.DEVNULL) for _ in range(2)]
        self.segments = [f'{os.environ.get("LOT_SEGMENT", "lottest")}_{os.getpid()}_{i}' for i in range(2)]
        try:
            self.connect()
        except BaseException:
            self.close()
            raise

    def connect(self):
        own = os.readlink('/proc/self/ns/net')
        until = time.monotonic() + PATIENCE_S
        for holder in self.holders:
            while self.network_of(holder) in (own, None):
                if holder.poll() is not None or time.monotonic() > until:
                    raise Refused(NO_NETWORK)
                time.sleep(0.01)
        a, b = (str(h.pid) for h in self.holders)
        if self.bad is None:
            must('ip', 'link', 'add', CABLE, 'netns', a, 'type', 'veth', 'peer', 'name', CABLE, 'netns', b)
        else:
            self.forwarder = Program('forwarder', [sys.executable, FORWARDER, CABLE, a, b, *self.bad], self.folder.name)
            try:
                self.forwarder.wait_for('ready')
            except AssertionError as refused:
                raise Refused(str(refused)) from refused
        for i in range(2):
            must(*self.inside(i), 'ip', 'address', 'add', f'{address(i)}/24', 'dev', CABLE)
            self.plug(i, True)
            must(*self.inside(i), 'ip', 'link', 'set', 'lo', 'up')
        # Programs pass over an interface that is not ready when they start.
        while not all('LOWER_UP' in self.link(i) for i in range(2)):
            if time.monotonic() > until:
                raise Refused(NO_NETWORK)
            time.sleep(0.01)

    def link(self, host):
        return subprocess.run([*self.inside(host), 'ip', 'link', 'show', CABLE], stdout=subprocess.PIPE, text=True,
                              check=True).stdout

    @staticmethod
    def network_of(process):
        try:
            is_there = b'sleep' in pathlib.Path(f'/proc/{process.pid}/cmdline').read_bytes().split(b'\0')[0]
            return os.readlink(f'/proc/{process.pid}/ns/net') if is_there else None
        except OSError:
            return None

    def inside(self, host):
        return ['nsenter', f'--net=/proc/{self.holders[host].pid}/ns/net']

    def plug(self, host, is_in):
        """The cable's end at that host."""
        must(*self.inside(host), 'ip', 'link', 'set', CABLE, 'up' if is_in else 'down')

    def limit(self, host, rate):
        """What that host sends goes no faster: a rate of tc."""
        must(*self.inside(host), 'tc', 'qdisc', 'add', 'dev', CABLE, 'root', 'tbf', 'rate', rate, 'burst', '64kb', 'latency',
             '50ms')

    def heal(self):
        """From now on the bad cable loses nothing."""
        self.forwarder.process.send_signal(signal.SIGUSR1)

    def run(self, host, *command, **environment):
        """Begins a program on that host."""
        usual = {'LOT_SEGMENT': self.segments[host], 'LOT_SIZE': '256M', 'CYCLONEDDS_URI': ''}
        program = Program(f'{pathlib.Path(command[0]).name}_{host}', [*self.inside(host), *command], self.folder.name,
                          **{**usual, **environment})
        self.programs.append(program)
        return program

    def close(self):
        for program in self.programs:
            program.kill()
        if self.forwarder is not None:
            self.forwarder.kill(signal.SIGTERM)
        for holder in self.holders:
            holder.kill()
            holder.wait()
        for segment in self.segments:
            for suffix in '', '.lock':
                pathlib.Path('/dev/shm', segment + suffix).unlink(missing_ok=True)
        self.folder.cleanup()

    @classmethod
    def of_test(cls, test, bad=None):
        """Those of a test of unittest, closed with it. Where this system gives none it is skipped."""
        try:
            hosts = cls(bad)
        except Refused as refused:
            print(skipped())
            test.skipTest(str(refused))
        test.addCleanup(hosts.close)
        return hosts

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()
