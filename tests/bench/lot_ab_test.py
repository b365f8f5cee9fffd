#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Runs lot_ab as a user would: what it says, what it saves, what it leaves behind.

    lot_ab_test.py PATH/TO/lot_ab

Times are never asserted. A run that is too long is killed by the watchdog, and the test fails.
"""

import ctypes
import functools
import glob
import json
import os
import pathlib
import platform
import re
import signal
import struct
import subprocess
import sys
import tempfile
import time

from checks import check, run

LOT_AB = sys.argv[1] if len(sys.argv) > 1 else 'build/release/bench/latency/lot_ab'
WATCHDOG = 240


def lot_ab(*arguments):
    return subprocess.run([LOT_AB, *arguments], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                          timeout=WATCHDOG, check=False)


def start(*arguments):
    return subprocess.Popen([LOT_AB, *arguments], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def children(pid):
    """All that live below this process, with the command of each."""
    found = []
    for task in glob.glob(f'/proc/{pid}/task/*/children'):
        try:
            for child in pathlib.Path(task).read_text().split():
                command = pathlib.Path(f'/proc/{child}/cmdline').read_text().replace('\0', ' ')
                found += [(int(child), command), *children(int(child))]
        except OSError:
            pass  # it has just ended
    return found


def lives(pid):
    try:
        return pathlib.Path(f'/proc/{pid}/stat').read_text().rsplit(')', 1)[1].split()[0] != 'Z'
    except OSError:
        return False


def wait_until(condition, most=60):
    end = time.monotonic() + most
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.02)
    return False


def workplace_of(process):
    """The name under which a run keeps its files: it holds that lock file open."""
    def found():
        for fd in glob.glob(f'/proc/{process.pid}/fd/*'):
            try:
                path = os.readlink(fd)
            except OSError:
                continue
            if re.fullmatch(r'/dev/shm/lot_ab_[0-9a-f]{8}\.lock', path):
                return path[:-len('.lock')]
        return None
    wait_until(lambda: found() is not None)
    return found()


def is_running(process, nodes):
    """All nodes have been started: their groups have children."""
    return wait_until(lambda: sum(' group ' in c for _, c in children(process.pid)) >= nodes)


def left_of(workplace):
    return glob.glob(workplace + '*')


def namespaces(pids):
    """Of these processes, or those that have just ended: none."""
    found = set()
    for pid in pids:
        for kind in ('net', 'mnt', 'pid', 'ipc', 'uts'):
            try:
                found.add(os.readlink(f'/proc/{pid}/ns/{kind}'))
            except OSError:
                pass
    return found


def all_namespaces():
    return namespaces(name for name in os.listdir('/proc') if name.isdigit())


def network_links():
    """Those that have names as ours have; they are made in the containers, and must not come out."""
    return {link for link in os.listdir('/sys/class/net') if re.match(r'(to|from)\d', link)}


def runs_and_saves():
    with tempfile.TemporaryDirectory() as directory:
        out = directory + '/out'
        for mode, more in (('paced', ['-r', '200']), ('ping-pong', []), ('throughput', [])):
            r = lot_ab('-t', 'ring,mutex,tcp', '-m', mode, '-s', '128,64K', '-n', '60', '--block', '20', '-o', out, *more)
            check(r.returncode == 0, f'{mode}: exit status 0')
            if r.returncode != 0:
                print(r.stdout)
        run = json.load(open(out + '/run.json', encoding='utf-8'))
        check(len(run['cells']) == 6, 'cells of three runs are in one file')
        arms = {a['transport'] for c in run['cells'] for a in c['arms'] if not a.get('refused')}
        check({'ring', 'mutex', 'tcp', 'floor-futex'} <= arms, 'every transport ran, and a floor')
        for mode, every in (('paced', 1), ('throughput', 16)):
            ends = [u for c in run['cells'] if c['conditions']['mode'] == mode for a in c['arms']
                    if a['transport'] in ('ring', 'mutex') for s in a['streams'] for u in s['subscribers']]
            check(len(ends) == 4 and all(u['sent'] == 60 and u['received'] > 0 for u in ends), f'{mode}: messages have come')
            stamped = [(u['latency_us']['from_fill']['count'], u['received']) for u in ends]
            check(all(n // every <= count <= -(-n // every) for count, n in stamped),
                  f'{mode}: one message of {every} is stamped: {stamped}')
        r = lot_ab('-t', 'ring,mutex,tcp', '-m', 'throughput', '-s', '128,64K', '-n', '60', '--block', '20', '-o', out,
                   '--resume')
        check(r.returncode == 0 and 'ring' not in r.stdout, 'what is saved is not run again')
        r = lot_ab('compare', out, out)
        check(r.returncode == 0, 'a run is not slower than itself')
        r = lot_ab('plot', out)
        check(r.returncode == 0, 'figures: what cannot be drawn is left out')


NO_CONTAINERS = 'no containers here'
NO_NETWORK = 'no network between containers here'
NO_ROOT = 'containers with networks of their own need root'


@functools.lru_cache(maxsize=None)
def lacking():
    """What of containers cannot be had here, as lot_ab says, which has tried it. In tests/skips.txt is who may lack it."""
    said = lot_ab('-t', 'ring,tcp', '-s', '4096', '--place', 'containers', '-n', '2', '--no-floors').stdout
    print(said)
    found = {reason for reason, text in ((NO_CONTAINERS, f': {NO_CONTAINERS}: '), (NO_NETWORK, f': {NO_NETWORK}: '),
                                         (NO_ROOT, ': a network between containers needs root')) if text in said}
    for reason in sorted(found):
        print('skipped:', reason)
    return found


def places():
    for graph, place, transports in (('1p2s', 'container', 'ring,tcp'), ('2p2s', 'containers', 'ring,tcp'),
                                     ('1p2s', 'host', 'ring,intra')):
        if place != 'host' and NO_CONTAINERS in lacking():
            continue
        if place == 'containers' and lacking():
            transports = 'ring'
        r = lot_ab('-t', transports, '-g', graph, '-s', '4096', '--place', place, '-n', '20', '-r', '200', '--block', '10')
        ran = all(re.search(rf'^ {name} +\d', r.stdout, re.M) for name in transports.split(','))
        check(r.returncode == 0 and ran, f'{transports} {graph} {place}')
        if r.returncode != 0 or not ran:
            print(r.stdout)


def refused_containers():
    """Where the system refuses them lot_ab gives the words of what it has tried, and tries it once."""
    words = 'bwrap: Failed to make / slave: Invalid argument'
    with tempfile.TemporaryDirectory() as directory:
        def replace(program, says):
            path = pathlib.Path(directory, program)
            path.write_text(f'#!/bin/sh\necho $0 >> {directory}/called\necho "{says}" >&2\necho more >&2\nexit 1\n',
                            encoding='utf-8')
            path.chmod(0o755)
            return path

        def run_there():
            return subprocess.run([LOT_AB, '-t', 'ring,tcp', '-s', '128,4096', '--place', 'containers', '-n', '5',
                                   '--no-floors'], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                                  timeout=WATCHDOG, check=False, env={**os.environ, 'PATH': f'{directory}:{os.environ["PATH"]}'})
        bwrap = replace('bwrap', words)
        r = run_there()
        refusals = re.findall(rf'^  (ring|tcp): no containers here: {re.escape(words)}$', r.stdout, re.M)
        check(r.returncode == 0 and refusals == ['ring', 'tcp'] * 2, f'containers are refused in the words of bwrap: {refusals}')
        called = pathlib.Path(directory, 'called').read_text(encoding='utf-8').split()
        check(called == [str(bwrap)], f'bwrap was tried once: {called}')
        if lacking():
            return
        bwrap.unlink()
        replace('ip', 'RTNETLINK answers: Operation not permitted')
        r = run_there()
        refusals = re.findall(r'^  (\w+): no network between containers here: RTNETLINK answers: Operation not permitted$',
                              r.stdout, re.M)
        check(r.returncode == 0 and refusals == ['tcp', 'tcp'], f'networks are refused in the words of ip: {refusals}')
        check(re.search(r'^ ring +\d', r.stdout, re.M) is not None, 'what needs no network has run')


def nodes_of(process):
    """Processes of nodes, in the order of their start; what starts them (bwrap, too) is not among them."""
    return sorted(c for c, command in children(process.pid)
                  if re.match(r'\S*lot_ab group ', command) and not children(c))


def cores_of(pid):
    try:
        return os.sched_getaffinity(pid)
    except OSError:
        return set()  # it has just ended


def end(process):
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=WATCHDOG)


def pins():
    if len(os.sched_getaffinity(0)) < 2:
        return
    for pin, apart in (('same-core', False), ('other-core', True)):
        p = start('-t', 'ring', '-s', '4096', '-n', '100000', '--no-floors', '--pin', pin)
        found = []

        def are_pinned():
            found[:] = [cores_of(node) for node in nodes_of(p)]
            return len(found) == 2 and all(len(cores) == 1 for cores in found)
        check(wait_until(are_pinned), f'--pin {pin}: each node has one core')
        check((found[0] != found[1]) == apart, f'--pin {pin}: {found}')
        end(p)


def containers():
    if NO_CONTAINERS in lacking():
        return
    p = start('-t', 'ring', '-g', '1p2s', '-s', '4096', '-n', '100000', '--no-floors', '--place', 'containers')
    nodes = []

    def are_there():
        nodes[:] = nodes_of(p)
        return len(nodes) == 3
    check(wait_until(are_there), 'three nodes in containers')
    each = [namespaces([os.getpid()]), *(namespaces([node]) for node in nodes)]
    check(all(len(those) == 5 for those in each), 'a node has five namespaces')
    check(len(set.union(*each)) == 4 * 5, 'all of its own')
    end(p)


def many_publishers():
    r = lot_ab('-t', 'ring', '-g', '20p1s', '-s', '64K', '-n', '5', '--block', '5', '--no-floors')
    check(r.returncode == 0 and re.search(r'^ ring +100 +100 ', r.stdout, re.M) is not None,
          'the segment holds what twenty publishers have prepared')
    if r.returncode != 0:
        print(r.stdout)


def perf_events_are_allowed():
    if platform.machine() != 'x86_64':
        return False
    clock = struct.pack('IIQQ', 1, 64, 1, 1_000_000) + bytes(40)  # software, of 64 bytes, the task's clock, 1 ms
    fd = ctypes.CDLL(None).syscall(298, clock, 0, -1, -1, 0)  # perf_event_open
    if fd != -1:
        os.close(fd)
    return fd != -1


def profile():
    # Without perf events a sample is taken each tick of the kernel's clock: that takes more messages.
    amount = ['-n', '90'] if perf_events_are_allowed() else ['-n', '1200', '-r', '120']
    with tempfile.TemporaryDirectory() as out:
        r = lot_ab('-t', 'ring,tcp', '-s', '4M', *amount, '--block', '90', '--pool', '4', '--depth', '4',
                   '--no-floors', '--profile', '-o', out)
        check(r.returncode == 0, 'a profile ends well')
        cells = json.load(open(out + '/run.json', encoding='utf-8'))['cells']
    for arm in cells[0]['arms']:
        p = arm['profile']
        used = sum(end['usage']['cpu_us'] for s in arm['streams'] for ends in ('publishers', 'subscribers')
                   for end in s[ends]) / 1e6
        name = arm['transport']
        check(abs(p['cpu_s'] - used) < 1e-6, f'{name}: processor time is what getrusage counts')
        shown = sum(spot['seconds'] for spot in p['hottest'])
        check(0 < shown <= p['cpu_s'] * 1.001, f'{name}: its hot spots are parts of it')
        check(0 <= p['spin_s'] <= p['cpu_s'], f'{name}: and so is what is spun')
        if perf_events_are_allowed():  # then a sample is taken in each millisecond of a thread
            check(p['samples'] > used * 500, f'{name}: at least half of its {used * 1000:.0f} ms are seen: {p["samples"]}')
    spots = {spot['symbol'] for arm in cells[0]['arms'] if arm['transport'] == 'tcp' for spot in arm['profile']['hottest']}
    check('memcpy' in spots and any('send' in s for s in spots), f'tcp copies and sends: {sorted(spots)}')


def bad_use():
    for arguments, sentence in ((['-t', 'pigeon'], 'pigeon'), (['-g', '0p1s'], '--graph'), (['-s', '100'], '--size'),
                                (['-m', 'fast'], '--mode'), (['-w', 'nap'], '--wait'),
                                (['--pin', 'same-core', '-w', 'spin'], '--wait'), (['--place', 'moon'], '--place'),
                                (['-m', 'ping-pong', '-g', '1p2s'], '--graph'), (['-r', '0'], '--rate'),
                                (['-n', '0'], '--messages'), (['-n', '-5'], '--messages'), (['--block', '-1'], '--block'),
                                (['--seed', '-3'], '--seed'), (['-s', '-128'], '--size'), (['--pool', '-1'], '--pool'), (['--resume'], '--out'),
                                (['compare', '/nowhere', '/nowhere'], '/nowhere')):
        r = lot_ab(*arguments)
        check(r.returncode == 2 and sentence in r.stdout, f'bad use is told: {" ".join(arguments)}')


def interrupted_while_starting():
    if NO_CONTAINERS in lacking():
        return
    seen = set()
    for wait in (0.05, 0.2, 0.5, 2):
        p = start('-t', 'ring,tcp,uds', '-g', '2p2s', '-s', '4096', '--place', 'containers', '-n', '100000')
        workplace = workplace_of(p)
        time.sleep(wait)
        nodes = [c for c, _ in children(p.pid)]
        theirs = namespaces(nodes) - namespaces([os.getpid()])
        p.send_signal(signal.SIGINT)
        p.communicate(timeout=WATCHDOG)
        check(p.returncode == 128 + signal.SIGINT, 'interrupted while it starts containers')
        check(wait_until(lambda: not any(lives(n) for n in nodes)), 'no process is left')
        check(not left_of(workplace), 'no file is left')
        # A number may be another one's by now, who keeps it for a while.
        check(wait_until(lambda: not theirs & all_namespaces() and not network_links()),
              f'none of {len(theirs)} namespaces is left, and no network link')
        seen |= theirs
    check(seen, 'there were namespaces to look for')


def interrupted():
    for number in (signal.SIGINT, signal.SIGTERM):
        p = start('-t', 'ring,tcp', '-s', '4096', '-n', '100000')
        workplace = workplace_of(p)
        check(is_running(p, 3), 'nodes live')
        nodes = [c for c, _ in children(p.pid)]
        p.send_signal(number)
        output = p.communicate(timeout=WATCHDOG)[0]
        check(p.returncode == 128 + number and 'signal' in output, f'{number.name}: it says so')
        check(wait_until(lambda: not any(lives(n) for n in nodes)), f'{number.name}: no process is left')
        check(not left_of(workplace), f'{number.name}: no file is left')


def files_of_peers():
    """What iceoryx, Fast DDS and nodes of ROS make under names of their own."""
    return {f for pattern in ('/dev/shm/*fastrtps_*', '/dev/shm/iceoryx*', '/tmp/roudi*', '/tmp/lot_ab_*')
            for f in glob.glob(pattern)}


def interrupted_with_peers():
    wanted = ('iceoryx', 'fastdds', 'fastdds-loan', 'lot2021', 'tzc', 'udp', 'ros-lot', 'ros-tcp')
    there = lot_ab('list').stdout
    names = [n for n in wanted if re.search(rf'^{n} +[^ (]', there, re.M)]
    before = files_of_peers()
    for wait in (0.1, 0.3, 0.6, 1, 2, 4, None):
        p = start('-t', ','.join(names), '-s', '4096', '-n', '100000', '--block', '20')
        workplace = workplace_of(p)
        if wait is None:
            check(is_running(p, len(names)), 'nodes live')
            time.sleep(6)
        else:
            time.sleep(wait)
        nodes = [c for c, _ in children(p.pid)]
        p.send_signal(signal.SIGINT)
        p.communicate(timeout=WATCHDOG)
        check(p.returncode == 128 + signal.SIGINT, f'interrupted after {wait} s with {names}')
        check(wait_until(lambda: not any(lives(n) for n in nodes)), 'no process is left')
        check(not left_of(workplace), 'no file is left')
    # Others may run just now, and clean up when they end.
    check(wait_until(lambda: not files_of_peers() - before), f'nor one of a peer: {files_of_peers() - before}')


def killed():
    p = start('-t', 'ring,tcp', '-s', '4096', '-n', '100000')
    workplace = workplace_of(p)
    is_running(p, 3)
    nodes = [c for c, _ in children(p.pid)]
    p.kill()
    p.communicate(timeout=WATCHDOG)
    check(wait_until(lambda: not any(lives(n) for n in nodes)), 'SIGKILL: nodes die with their conductor')
    check(left_of(workplace), 'SIGKILL: files are left')
    lot_ab('-t', 'ring', '-s', '4096', '-n', '2', '-r', '1000', '--no-floors')
    check(not left_of(workplace), 'SIGKILL: the next run removes them')


def node_killed():
    p = start('-t', 'ring,tcp', '-s', '4096', '-n', '60', '--block', '20')
    is_running(p, 6)
    time.sleep(1)
    groups = [c for c, command in children(p.pid) if re.search(r' group \d+ 0 0', command)]
    victim = max(groups)  # a node; its parent came before it
    os.kill(victim, signal.SIGKILL)
    output = p.communicate(timeout=WATCHDOG)[0]
    check(p.returncode == 1 and re.search(r'ring.*killed by signal 9', output, re.S) is not None,
          'a node that is killed is named, and the run has failed')
    check(re.search(r'^ *tcp', output, re.M) is not None, 'the others go on')


def vehicle():
    r = lot_ab('-t', 'ring', '-g', 'av', '-n', '40', '--block', '10', '--depth', '4', '--no-floors')
    check(r.returncode == 0 and re.search(r'^ ring camera0 ', r.stdout, re.M) is not None,
          'the vehicle has cameras')
    check(re.search(r'^ ring quiet imu ', r.stdout, re.M) is not None and 'ring quiet camera' not in r.stdout,
          'its quiet twin has none')
    check('beside the same without them' in r.stdout, 'and they are compared')
    if r.returncode != 0:
        print(r.stdout)


run((bad_use, runs_and_saves, places, refused_containers, pins, containers, many_publishers, vehicle, profile, interrupted, interrupted_while_starting,
     interrupted_with_peers, killed, node_killed))
