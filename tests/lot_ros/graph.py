# SPDX-License-Identifier: Apache-2.0
"""A ROS graph for one test: a real rosmaster on a port of its own, nodes, and what they leave behind."""

import contextlib
import json
import os
import pathlib
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import xmlrpc.client

NODE = os.environ.get('LOT_ROS_NODE', 'ros_node')
TOOL = os.environ.get('LOT_TOOL', 'lot')
PATIENCE_S = 50


def free_port():
    """Below those that the kernel gives to whoever asks for any: a node could have it before the master."""
    while True:
        port = secrets.choice(range(20000, 32000))
        with socket.socket() as s:
            try:
                s.bind(('127.0.0.1', port))
            except OSError:
                continue
            return port


class Graph:
    """Used by `with`: everything that was started in it is gone afterwards, and its files are."""

    def __init__(self, shm='/dev/shm', inside=(), host='127.0.0.1'):
        """`inside`: what the master's command begins with; `host`: where it is."""
        self.inside = inside
        self.port = free_port()
        self.shm = pathlib.Path(shm)
        self.segment = f'lottest_ros_{os.getpid()}_{secrets.token_hex(3)}'
        self.home = pathlib.Path(tempfile.mkdtemp(prefix='lot_ros_'))
        self.uri = f'http://{host}:{self.port}/'
        self.env = {
            **os.environ,
            'ROS_MASTER_URI': self.uri,
            'ROS_IP': host,
            'ROS_HOME': str(self.home),
            'ROS_LOG_DIR': str(self.home / 'log'),
            'LOT_SEGMENT': self.segment,
            'LOT_DIR': str(self.shm),
            'PYTHONUNBUFFERED': '1',
        }
        self.started = []

    def __enter__(self):
        self.master = self.run([*self.inside, 'rosmaster', '--core', '-p', str(self.port), '-w', '3'])
        try:
            if self.inside:
                self.wait_for(self.answers, 'the master')
            else:
                self.wait_for(lambda: self.ask('getPid') is not None, 'the master')
        except BaseException:
            self.__exit__()  # which `with` leaves out then
            raise
        return self

    def answers(self):
        """Asked from inside, since the master is not to be reached from here."""
        program = f'import xmlrpc.client; xmlrpc.client.ServerProxy({self.uri!r}).getPid("/test")'
        return subprocess.run([*self.inside, '/usr/bin/python3', '-c', program], env=self.env,
                              stderr=subprocess.DEVNULL, timeout=60, check=False).returncode == 0

    def __exit__(self, *_):
        for process in reversed(self.started):
            if process.poll() is None and 'roslaunch' in process.name:
                process.send_signal(signal.SIGINT)  # killed, it leaves its nodes behind
                try:
                    process.wait(30)
                except subprocess.TimeoutExpired:
                    pass
            if process.poll() is None:
                self.kill_all_of(process)
            process.wait()
            process.out.close()
            process.err.close()
        shutil.rmtree(self.home, ignore_errors=True)
        for path in self.files():
            path.unlink()

    @staticmethod
    def kill_all_of(process):
        """Kills it, and what it has started."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)

    def files(self):
        """What lies in the segment's directory of this graph."""
        return list(self.shm.glob(self.segment + '*'))

    def ask(self, method, *arguments):
        """The master's answer; None when it has none."""
        try:
            with xmlrpc.client.ServerProxy(self.uri) as master:
                code, _, value = getattr(master, method)('/test', *arguments)
            return value if code == 1 else None
        except OSError:
            return None

    def set_parameter(self, name, value):
        assert self.ask('setParam', name, value) is not None

    def run(self, command, **env):
        """Starts a program in the graph; its output is kept."""
        number = len(self.started)
        out = open(self.home / f'{number}.out', 'w+', encoding='utf-8', errors='replace')
        err = open(self.home / f'{number}.err', 'w+', encoding='utf-8', errors='replace')
        process = subprocess.Popen(command, stdout=out, stderr=err, env={**self.env, **env},
                                   stdin=subprocess.DEVNULL, start_new_session=True)
        process.out, process.err, process.name = out, err, ' '.join(map(str, command))
        self.started.append(process)
        return process

    def start(self, command, **env):
        """A node that has all its ends. (roscpp may cut a link when a publisher comes while a
        subscription is being registered: the master's answer is older than its news of the publisher.)"""
        node = self.run(command, **env)
        self.wait_for(lambda: 'ready' in self.output(node).splitlines() or node.poll() is not None,
                      f'{node.name} to be ready')
        return node

    def node(self, name, *ends, **env):
        return self.start([NODE, *ends, f'__name:={name}'], **env)

    def seen(self):
        return subprocess.run([TOOL, '--json', '-s', self.segment, 'ls'], env=self.env, text=True,
                              capture_output=True, timeout=60, check=False).stdout

    def look(self):
        """What `lot ls` sees of the graph's segment."""
        segments = json.loads(self.seen())['segments']
        return segments[0] if segments else {'processes': [], 'blocks': {'used': 0}}

    def ring(self, topic):
        """The name that a topic has in the graph's segment."""
        def found():
            return [t['name'] for t in self.look().get('topics', []) if t['name'].endswith(' ' + topic)]
        self.wait_for(found, f'{topic} in the segment')
        return found()[0]

    def published(self):
        """How many messages are, or were, in the rings of the graph's segment."""
        return sum(publisher['published'] for topic in self.look().get('topics', []) for publisher in topic['publishers'])

    @staticmethod
    def said(process):
        process.err.flush()
        return pathlib.Path(process.err.name).read_text(errors='replace')

    def output(self, process):
        return pathlib.Path(process.out.name).read_text(errors='replace')

    def report(self, process, patience_s=PATIENCE_S):
        """What a node says of its ends when it has ended by itself."""
        try:
            status = process.wait(patience_s)
        except subprocess.TimeoutExpired:
            others = self.stacks(process) + self.others(process)  # as they are now
            raise AssertionError(f'{process.name} does not end:\n{self.has_got(process)}\n'
                                 f'{self.said(process)}\n{others}') from None
        text = self.output(process)
        assert status == 0 and text, f'{process.name} ended with {status}:\n{self.said(process)}'
        return json.loads(text.splitlines()[-1])

    def ended(self, process, patience_s):
        """The status of a program of tests, which must end by itself. One that does not is told to abort: doctest then
        says in which test it was."""
        try:
            return process.wait(patience_s)
        except subprocess.TimeoutExpired:
            others = self.stacks(process) + self.others(process)  # as they are now
            process.send_signal(signal.SIGABRT)
            process.wait(PATIENCE_S)
            self.kill_all_of(process)
            raise AssertionError(f'{process.name} does not end:\n{self.output(process)}\n{self.said(process)}\n'
                                 f'{others}') from None

    @staticmethod
    def stacks(process):
        """Where its threads stand: for people."""
        if process.poll() is not None:
            return ''
        try:
            seen = subprocess.run(['eu-stack', '-p', str(process.pid)], stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                                  timeout=PATIENCE_S, check=False, text=True, errors='replace')
        except (OSError, subprocess.TimeoutExpired) as error:
            return f'{error}\n'
        return seen.stdout

    def others(self, process):
        """What all but this one have said, where they stand, and what lies in the segment: for people."""
        text = ''.join(f'-- {other.name}: status {other.poll()}\n{self.output(other)}{self.said(other)}{self.stacks(other)}'
                       for other in self.started if other is not process)
        return f'{text}-- lot ls\n{self.seen()}'

    def has_got(self, process):
        """What a node says of its ends when it is asked to end before it would."""
        process.send_signal(signal.SIGINT)
        try:
            process.wait(5)
        except subprocess.TimeoutExpired:
            return f'nor when it is asked to\n{self.output(process)}'
        return self.output(process)

    def stop(self, process, how=signal.SIGINT):
        process.send_signal(how)
        return self.report(process) if how == signal.SIGINT else process.wait(PATIENCE_S)

    def stop_recording(self, record, path):
        """`rosbag record` is a script that may end before the recorder, which renames the bag at last."""
        record.send_signal(signal.SIGINT)
        record.wait(60)
        self.wait_for(path.exists, 'the bag')

    def wait_for(self, condition, what, patience_s=PATIENCE_S):
        until = time.monotonic() + patience_s
        while not condition():
            if time.monotonic() > until:
                for process in self.started:
                    print(f'--- {process.name}\n{self.said(process)}{self.stacks(process)}', file=sys.stderr)
                print(f'--- the segment\n{self.seen()}', file=sys.stderr)
                raise AssertionError(f'in vain: waiting for {what}')
            time.sleep(0.01)

    def peers(self, topic):
        """(publishers, subscribers) of a topic, as the master knows them."""
        state = self.ask('getSystemState')
        return tuple(next((nodes for name, nodes in part if name == topic), []) for part in state[:2])
