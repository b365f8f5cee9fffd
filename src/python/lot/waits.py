# SPDX-License-Identifier: Apache-2.0
"""Wait sets: one thread for many subscribers, queues and timers."""

import atexit
import collections
import errno
import itertools
import threading
import time

from lot import _lot
from lot._lot import Error, Queue, Subscriber, Wait, _Waits


class WaitSet:
    """One thread for many subscribers, queues and timers.

        waits = lot.WaitSet()
        waits.add(camera, lambda: show(camera.pull(0)))
        waits.add_timer(0.1, report)
        waits.run()                      # until another thread, a handler or a signal calls stop()

    A handler that leaves messages unread is called again. What it raises leaves run(), which may be called again.
    stop() may be called by any thread, the rest by one at a time; handlers may add, remove and stop.
    """

    def __init__(self, wait=Wait.PARK):
        self._waits = _Waits(wait)
        self._numbers = itertools.count()
        self._entries = {}  # by number: the end, the handler, and whether it is called once only
        self._due = collections.deque()

    def _enter(self, what, handler, once, add):
        if not callable(handler):
            raise TypeError(f'{handler!r} is no handler')
        number = next(self._numbers)
        self._entries[number] = (what, handler, once)
        try:
            add(number)
        except BaseException:
            del self._entries[number]
            raise
        return number

    def add(self, end, handler):
        """Calls handler() when the Subscriber or Queue may have something. A handler looks with timeout 0. Each end is
        added once (errno.EEXIST)."""
        if not isinstance(end, (Subscriber, Queue)):
            raise TypeError(f'end: takes a Subscriber or a Queue, not {end!r}')
        if any(its is end for its, _, _ in self._entries.values()):
            raise Error(errno.EEXIST, 'the wait set has this subscriber or queue: remove() it before')
        self._enter(end, handler, False, lambda number: self._waits.add(number, end))

    def add_timer(self, period, handler):
        """Calls handler() every so many seconds. Gives a number, for remove()."""
        return self._enter(None, handler, False, lambda number: self._waits.add_timer(number, period, True))

    def add_timer_once(self, delay, handler):
        """Calls handler() once, after so many seconds. Gives a number, for remove()."""
        return self._enter(None, handler, True, lambda number: self._waits.add_timer(number, delay, False))

    def remove(self, what):
        """A Subscriber, a Queue or a timer's number: it is not called any more. Nothing where it was not added."""
        for number, (end, _, _) in list(self._entries.items()):
            if end is what or (end is None and number == what):
                self._waits.remove(number)
                del self._entries[number]

    def run_once(self, timeout=None):
        """Waits until something can be done, so many seconds at most, and does it: the number of handlers that were
        called. None: stop() was called."""
        if not self._due:
            news = self._waits.wait(timeout)
            if news is None:
                return None
            self._due.extend(news)
        called = 0
        while self._due:  # a handler that raises leaves the rest for the next time
            number = self._due.popleft()
            if number not in self._entries:  # another handler has removed it
                continue
            _, handler, once = self._entries[number]
            if once:
                self._waits.remove(number)
                del self._entries[number]
            called += 1
            handler()
        return called

    def run(self):
        """Calls handlers until stop()."""
        while self.run_once() is not None:
            pass

    def stop(self):
        """Ends run() after the handlers that are at work, or the next run() at once."""
        self._waits.stop()


def _end_waits():
    """At the end of the program: daemon threads that wait in LOT end, and let go of their objects."""
    waiting, until = _lot._end_waits() - {threading.get_ident()}, time.monotonic() + 1
    # Not by join(): a thread whose join() Ctrl-C has ended counts as gone.
    while time.monotonic() < until and any(thread.ident in waiting for thread in threading.enumerate()):
        time.sleep(0.002)


atexit.register(_end_waits)
