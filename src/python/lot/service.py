# SPDX-License-Identifier: Apache-2.0
"""Services: clients ask, and one of the servers answers. They meet those of C++ (include/lot/service.hpp, which says
how a call goes)."""

import errno
import secrets
import sys
import threading
import time
import traceback

from lot import _lot
from lot._lot import Error, Part, Policy, Status, Type
from lot.waits import WaitSet

_u64, _bool = Type.number(_lot.Kind.UINT, 8), Type.number(_lot.Kind.BOOL, 1)
_MOST_SERVERS = 3  # of a request that may go to another server: after so many deaths the call ends
_SIZE = 2**64


def _with_hash(made, number):
    return Type.decode(made.name, made.alignment, made.encode(), number % _SIZE) if number % _SIZE else made


class _Ends:
    """The names and types that both ends of a service have, as detail/service.hpp says."""

    def __init__(self, name, request, response):
        if not 1 <= len(name.encode()) <= 170:
            raise Error(errno.EINVAL, 'a service has a name of 1 to 170 bytes')
        self.name = name
        self.calls, self.presence = name + '/calls', name + '/servers'
        ticket = Type.structure('lot::detail::Ticket', [('waits_for', _u64)])
        self.call = _with_hash(
            Type.structure(f'lot::Call<{request.name}>', [
                ('client', _u64), ('number', _u64), ('may_retry', _bool), ('ticket', Type.reference(ticket)), ('request', request)]),
            request.hash)
        self.answer = _with_hash(
            Type.structure(f'lot::Answer<{response.name}>', [
                ('number', _u64), ('has_given_up', _bool), ('has_failed', _bool), ('error', Type.string()), ('response', response)]),
            response.hash)
        self.serving = _with_hash(
            Type.structure(f'lot::Service<{request.name}, {response.name}>', [
                ('is_there', _u64), ('request', Type.reference(request)), ('response', Type.reference(response))]),
            request.hash * 31 + response.hash + request.size * 31 + response.size)

    def answers(self, client):
        return f'{self.name}/answers/{client}'


class Client:
    """Asks the servers of a service, one call at a time. Each thread makes a client of its own: Engine.client()."""

    def __init__(self, engine, ends, wait, retry):
        self._ends, self._may_retry = ends, retry
        self._id = secrets.randbits(64)
        self._presence = engine.subscribe(ends.presence, ends.serving, history=1)
        self._answers = engine.subscribe(ends.answers(self._id), ends.answer)
        self._calls = engine.queue(ends.calls, ends.call, depth=16, redeliver=True)
        self._ticket = engine._ticket()
        self._waits = WaitSet(wait)
        self._waits.add(self._answers, self._look_for_answer)
        self._waits.add(self._presence, self._see_servers)
        self._number = 0  # of the call that is made, or was made last
        self._answer = None
        self._has_server = self._holds_too_much = False
        self.status = Status.EMPTY
        """How the last call ended: OK, TIMEOUT, SERVER_GONE (it has died, or none has come), HOLDS_TOO_MUCH."""

    def loan(self, **fields):
        """A request that is built in shared memory, with these fields set."""
        request = self._calls.loan().request
        for name, value in fields.items():
            setattr(request, name, value)
        return request

    def call(self, request=None, timeout=None, **fields):
        """Sends a request of loan(), or one with these fields, and waits for the answer: so many seconds, also for a server;
        None: as long as there is a server, and where there is none not at all. The answer lives as long as any part or
        view of it. None: `status` says why. A handler that has raised is an Error (errno.EREMOTEIO)."""
        if request is not None and not isinstance(request, Part):
            raise TypeError(f'request: takes what loan() gives, or fields by name, call(x=3); not {request!r}')
        call = _lot._whole(self.loan(**fields) if request is None else request)
        until = float('inf') if timeout is None else time.monotonic() + timeout
        self._number += 1  # from here on what answers an earlier call is dropped
        self._answer = None
        if not self._wait_for_server(0 if timeout is None else until):
            self.status = Status.SERVER_GONE
            return None
        self._look_for_answer()  # makes room for the answer
        self.status = Status.HOLDS_TOO_MUCH if self._holds_too_much else self._ask(call, until)
        if self.status != Status.OK:
            return None
        answer, self._answer = self._answer, None
        if answer.has_failed:
            raise Error(errno.EREMOTEIO, f"{self._ends.name}: the server's handler has failed: {answer.error}")
        return answer.response

    def servers(self):
        """Servers that are there now."""
        return self._presence.publishers()

    def wait_for_server(self, timeout=None):
        """Waits until there is a server. False: the time is up."""
        return self._wait_for_server(float('inf') if timeout is None else time.monotonic() + timeout)

    def _ask(self, call, until):
        call.client, call.number, call.may_retry = self._id, self._number, self._may_retry
        call.ticket = self._ticket.message
        self._ticket.wait_for(self._number)
        try:
            sent = self._send(call, until)
            return self._wait_for_answer(until) if sent == Status.OK else sent
        finally:
            self._ticket.wait_for(0)

    def _send(self, call, until):
        """Requests of earlier calls may fill the queue. Looks now and then whether there are servers."""
        while True:
            soon = min(until, time.monotonic() + 0.05)
            if self._calls.put(call, soon - time.monotonic()):
                return Status.OK
            self._see_servers()
            if not self._has_server:
                return Status.SERVER_GONE
            if soon == until:
                return Status.TIMEOUT

    def _wait_for_answer(self, until):
        while self._answer is None and not self._holds_too_much and self._has_server:
            if not self._wait(until):
                self._look_for_answer()  # the wait tells of an answer that may not be kept once a second only
                if self._answer is None and not self._holds_too_much:
                    return Status.TIMEOUT
        if self._answer is None and not self._has_server:
            self._look_for_answer()  # it came before its server's end
        if self._answer is not None:
            return Status.SERVER_GONE if self._answer.has_given_up else Status.OK
        return Status.HOLDS_TOO_MUCH if self._holds_too_much else Status.SERVER_GONE

    def _wait_for_server(self, until):
        self._see_servers()
        while not self._has_server:
            if not self._wait(until):
                return False
        return True

    def _wait(self, until):
        return self._waits.run_once(None if until == float('inf') else max(until - time.monotonic(), 0))

    def _look_for_answer(self):
        """The first one counts: a server that has answered may die before it has finished the request, and another one
        then gives it up."""
        while (came := self._answers.pull(0)) is not None:
            if came.number == self._number and self._answer is None:
                self._answer = came
        self._holds_too_much = self._answers.status == Status.HOLDS_TOO_MUCH

    def _see_servers(self):
        while self._presence.pull(0) is not None:
            pass
        self._has_server = self._presence.publishers() != 0


class Server:
    """Answers the requests of a service, on a thread of its own, until close(), the end of its `with`, or the end of the
    main thread: Engine.serve()."""

    def __init__(self, engine, ends, handler, wait, on_error):
        self._engine, self._ends, self._handler = engine, ends, handler
        self._on_error = on_error
        self._clients = {}  # publishers, by client
        self._tasks = engine.queue(ends.calls, ends.call, depth=16, redeliver=True)
        self._waits = WaitSet(wait)
        self._waits.add(self._tasks, self._serve)
        self._presence = engine.advertise(ends.presence, ends.serving)
        self._presence.push(self._presence.loan(is_there=1))  # clients that wait for a server look then
        self._thread = threading.Thread(target=self._run, name='lot-serve')
        self._thread.start()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def close(self):
        """Ends after the request that it works on. The others go to other servers. Once more: nothing."""
        if self._waits is None:
            return
        self._waits.stop()
        self._thread.join()
        self._waits = self._presence = self._tasks = self._engine = None
        self._clients.clear()

    def _run(self):
        waits = self._waits
        while threading.main_thread().is_alive():
            try:
                if waits.run_once(0.2) is None:
                    return
            except Exception as error:  # of one request; the next one may be answered
                self._on_error(error)

    def _serve(self):
        task = self._tasks.take(0)
        if not task:
            return
        try:
            self._handle(task)
        finally:
            task.finish()  # also then: given back it would be the next one, and again

    def _handle(self, task):
        call = task.item
        client = self._client_of(call)
        if client is None:
            return
        if task.deliveries > (_MOST_SERVERS if call.may_retry else 1):
            client.push(client.loan(number=call.number, has_given_up=True))
        else:
            self._answer(client, call)

    def _answer(self, client, call):
        answer = client.loan(number=call.number)
        try:
            self._handler(call.request, answer.response)
            client.push(answer)  # a view that the handler has left is an error of its own, too
        except BaseException as error:  # SystemExit, too, is of this request, and the server goes on
            failed = client.loan(number=call.number, has_failed=True)
            failed.error = ''.join(traceback.format_exception_only(error)).strip()
            client.push(failed)

    def _client_of(self, call):
        """None: no client waits for the answer."""
        if call.ticket.waits_for != call.number:
            return None
        if call.client not in self._clients:
            self._clients = {client: its for client, its in self._clients.items() if its.readers() != 0}
            # Never full: a client reads its answers before it asks.
            self._clients[call.client] = self._engine.advertise(
                self._ends.answers(call.client), self._ends.answer, depth=4, policy=Policy.REFUSE, history=0)
        client = self._clients[call.client]
        return client if client.readers() != 0 else None


def print_error(error):
    """What a server does with what keeps it from an answer, unless it was told else."""
    print('lot: a request cannot be answered; its client waits to its time-out:', error, file=sys.stderr)
