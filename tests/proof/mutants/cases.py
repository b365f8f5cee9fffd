# SPDX-License-Identifier: Apache-2.0
"""The test cases that mutants are tried with, and running them.

Each run has namespaces of its own: processes, mounts, IPC; with a /dev/shm and a /tmp of its own. What
a mutant leaves there goes with them, and so does each process that it has started.
"""

import ctypes
import dataclasses
import json
import os
import pathlib
import re
import resource
import signal
import subprocess
import time
import traceback

# Not tried: what needs a compiler, a model checker or a benchmark, and what tries out the tests.
NO_LABELS = {'model', 'bench', 'compile_fail', 'can_fail'}
NO_TESTS = re.compile(r'pages|ros_pages|arrows|kill|kill_.*|chaos|.*_self_test|ros_refuses.*|'
                      r'compilers_test|million_.*|cameras_test|threads_test|conformance_test|'
                      r'lot_ab.*|transports_test|example_.*|one_definition.*')
SHM_BYTES, HEAP_BYTES = 4 << 30, 6 << 30
HANGS_S = 10  # a case that takes longer than this and five times what it should has hung

NEWNS, NEWIPC, NEWUSER, NEWPID = 0x00020000, 0x08000000, 0x10000000, 0x20000000
MS_BIND, MS_REC, MS_PRIVATE = 0x1000, 0x4000, 1 << 18
OVER = []  # (file, place): the file lies over what is at the place, in each world
libc = ctypes.CDLL(None, use_errno=True)


@dataclasses.dataclass
class Case:
    name: str
    command: list
    environment: dict
    folder: str
    seconds: float = 0.0


def all_tests(objects):
    """(name, command, environment, folder) of each test that mutants are tried with."""
    listed = json.loads(subprocess.run(['ctest', '--show-only=json-v1'], cwd=objects, check=True,
                                       capture_output=True, text=True).stdout)
    found = []
    for test in listed['tests']:
        about = {p['name']: p['value'] for p in test['properties']}
        if NO_LABELS & set(about.get('LABELS', [])) or NO_TESTS.fullmatch(test['name']):
            continue
        environment = dict(e.split('=', 1) for e in about.get('ENVIRONMENT', []))
        found.append((test['name'], test.get('command'), environment, about['WORKING_DIRECTORY']))
    return found


def place_of(program):
    """Where it lies in its build tree, wherever that is."""
    path = pathlib.Path(program)
    root = next((p for p in path.parents if (p / 'CMakeCache.txt').exists()), path.parent)
    return path.relative_to(root).as_posix()


def cases_of_doctest(program, environment, folder):
    """(case, the options that choose it) of each. None: it is another program."""
    listed = subprocess.run([program, '-ltc', '-nc'], cwd=folder, capture_output=True, text=True,
                            env={**os.environ, **environment}, timeout=60)
    if not listed.stdout.startswith('[doctest]'):
        return None
    lines = [line for line in listed.stdout.splitlines() if not line.startswith(('[doctest]', '==='))]
    return [(line.strip(), ['-nc', '-aa=1', f'-f={i}', f'-l={i}']) for i, line in enumerate(lines, 1)]


# The models from outside: a few short runs of each. And nodes of ROS that have many cases.
SEEDS = (1, 2, 3)
NODES = {'Handles': 'LOT_ROS_HANDLES', 'Filters': 'LOT_ROS_FILTERS'}


def cases_of(name, command, environment, folder):
    """A program of doctest, or a file of unittest, has many cases; another command is one."""
    if name.startswith('outside_'):
        return [Case(f'{name}: seed {seed}', [*command, '--seed', str(seed)], environment, folder) for seed in SEEDS]
    if len(command) == 1 and place_of(command[0]).startswith('tests/'):
        chosen_cases = cases_of_doctest(command[0], environment, folder)
        if chosen_cases is not None:
            return [Case(f'{name}: {line}', [*command, *chosen], environment, folder)
                    for line, chosen in chosen_cases]
    # Names may follow where the last word is for unittest.
    script = next((word for word in command if word.endswith('.py')), '')
    takes_names = script and command[-1] in (script, '-v')
    if takes_names and 'unittest.main' in (text := pathlib.Path(script).read_text()):
        found, group = [], None
        for line in text.splitlines():
            if match := re.match(r'class (\w+)\(', line):
                group = match.group(1)
            elif (match := re.match(r'    def (test_\w+)\(', line)) and NODES.get(group, '') in environment:
                found += [Case(f'{name}: {group}: {its}', [*command, f'{group}.{match.group(1)}'],
                               {**environment, 'LOT_ROS_CHOSEN': ' '.join(chosen)}, folder) for its, chosen in
                          cases_of_doctest(environment[NODES[group]], environment, folder)]
            elif match:
                found.append(Case(f'{name}: {group}.{match.group(1)}',
                                  [*command, f'{group}.{match.group(1)}'], environment, folder))
        return found
    return [Case(name, command, environment, folder)]


# ---- a world of its own ---------------------------------------------------------------------------


def die_with_parent():
    libc.prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


def call(what, done):
    if done != 0:
        raise OSError(ctypes.get_errno(), f'{what}: {os.strerror(ctypes.get_errno())}')


def mount(source, target, kind, flags=0, data=None):
    encoded = [x.encode() if x else None for x in (source, target, kind)]
    call(f'mount {target}', libc.mount(*encoded, ctypes.c_ulong(flags), data.encode() if data else None))


def own_namespaces():
    """For this process and, of processes, its children. Raises OSError where the kernel refuses."""
    user, group = os.getuid(), os.getgid()
    call('unshare', libc.unshare(NEWNS | NEWPID | NEWIPC | (NEWUSER if user else 0)))
    if user:
        pathlib.Path('/proc/self/setgroups').write_text('deny')
        pathlib.Path('/proc/self/uid_map').write_text(f'{user} {user} 1')
        pathlib.Path('/proc/self/gid_map').write_text(f'{group} {group} 1')


def furnish(build):
    mount(None, '/', None, MS_REC | MS_PRIVATE)
    for file, place in OVER:
        mount(file, place, None, MS_BIND)
    mount('proc', '/proc', 'proc')
    mount('shm', '/dev/shm', 'tmpfs', data=f'size={SHM_BYTES},mode=1777')
    if not str(build).startswith('/tmp/'):
        mount('tmp', '/tmp', 'tmpfs', data=f'size={SHM_BYTES},mode=1777')


def inside(build, work):
    """Runs `work` as the first process of new namespaces; returns what it returns (JSON).
    Raises OSError where the kernel refuses them."""
    reading, writing = os.pipe()
    outer = os.fork()
    if outer == 0:
        status = 1
        try:
            os.setsid()
            die_with_parent()
            own_namespaces()
            first = os.fork()
            if first == 0:
                try:
                    die_with_parent()
                    furnish(build)
                    said = work()
                except OSError as error:
                    said = {'refused': str(error)}
                except BaseException:
                    said = {'broken': traceback.format_exc()}
                os.write(writing, json.dumps(said).encode())
                os._exit(0)
            os.waitpid(first, 0)
            status = 0
        except OSError as error:
            os.write(writing, json.dumps({'refused': str(error)}).encode())
        finally:
            os._exit(status)
    os.close(writing)
    with os.fdopen(reading, 'rb') as pipe:
        data = pipe.read()
    os.waitpid(outer, 0)
    said = json.loads(data) if data else {'broken': 'the first process has died'}
    if 'refused' in said:
        raise OSError(said['refused'])
    if 'broken' in said:
        raise RuntimeError(said['broken'])
    return said


# ---- one case, in there -----------------------------------------------------------------------------


def limited():
    os.setsid()
    for number in (signal.SIGINT, signal.SIGQUIT, signal.SIGHUP):  # a script in the background ignores them
        signal.signal(number, signal.SIG_DFL)
    resource.setrlimit(resource.RLIMIT_DATA, (HEAP_BYTES, HEAP_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def sweep():
    """What the case has left: processes, segments, files. Only the first process of a namespace may do
    so: elsewhere it would end every process."""
    if os.getpid() != 1:
        raise RuntimeError('not in namespaces of its own')
    try:
        os.kill(-1, signal.SIGKILL)
    except ProcessLookupError:
        pass
    try:
        while True:
            os.waitpid(-1, 0)
    except ChildProcessError:
        pass
    for place in ('/dev/shm', '/tmp'):
        if place == '/dev/shm' or os.path.ismount(place):
            subprocess.run(['find', place, '-mindepth', '1', '-delete'], stderr=subprocess.DEVNULL)


def run(case, limit, mutant=0, reached=None):
    """(how it ended: '' or what has failed, its seconds)."""
    environment = {**os.environ, **case.environment, 'LOT_MUTANT': str(mutant)}
    if reached:
        environment['LOT_MUTANT_REACHED'] = str(reached)
    began = time.monotonic()
    with open('/dev/shm/.said', 'w+b') as said:
        os.unlink('/dev/shm/.said')
        process = subprocess.Popen(case.command, cwd=case.folder, env=environment, stdin=subprocess.DEVNULL,
                                   stdout=said, stderr=subprocess.STDOUT, preexec_fn=limited)
        status = None
        while status is None and time.monotonic() - began < limit:
            try:
                status = process.wait(timeout=max(0.01, limit - (time.monotonic() - began)))
            except subprocess.TimeoutExpired:
                break
        seconds = time.monotonic() - began
        sweep()
        if status == 0:
            return '', seconds
        said.seek(max(0, said.seek(0, 2) - 4000))
        text = said.read().decode(errors='replace')
    if status is None:
        return f'hangs (more than {limit:.0f} s)', seconds
    lines = [l.strip() for l in text.splitlines() if re.search(r'ERROR|Error|FAIL|terminate|what\(\)', l)]
    return (lines[0] if lines else f'status {status}')[:160], seconds


def limit_of(case):
    return HANGS_S + 5 * case.seconds
