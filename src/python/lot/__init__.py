# SPDX-License-Identifier: Apache-2.0
"""LOT: messages in shared memory, without copies. docs/python.md says what its objects keep.

    engine = lot.Engine()
    sub = engine.subscribe("/camera/front")
    with sub.borrow(timeout=0.1) as frame:
        if frame is not None:
            image = numpy.asarray(frame.data).reshape(frame.height, frame.width, 3)
"""

import asyncio
import collections
import enum
import errno
import inspect
import itertools

import numpy

from lot._lot import (Borrow, Engine, Envelope, Error, Kind, OutOfMemory, Part, Policy, Publisher, Queue, QueueEngine,
                      RecordedMessage, RecordedMessages, RecordedTopic, Recording, RecordingDamage, Status, Subscriber,
                      Task, Type, Wait, Weak, _Waits, share, weak)

__all__ = ['Borrow', 'Engine', 'Envelope', 'Error', 'Kind', 'OutOfMemory', 'Part', 'Policy', 'Publisher', 'Queue',
           'QueueEngine', 'RecordedMessage', 'RecordedMessages', 'RecordedTopic', 'Recording', 'RecordingDamage', 'Status',
           'Subscriber', 'Task', 'Type', 'Wait', 'WaitSet', 'Weak', 'array', 'boolean', 'char', 'duration', 'enumeration',
           'f32', 'f64', 'i8', 'i16', 'i32', 'i64', 'message', 'ref', 'share', 'string', 'time_point', 'type_of', 'u8',
           'u16', 'u32', 'u64', 'vector', 'weak']

boolean = Type.number(Kind.BOOL, 1)
char = Type.number(Kind.CHAR, 1)
i8, i16, i32, i64 = (Type.number(Kind.INT, size) for size in (1, 2, 4, 8))
u8, u16, u32, u64 = (Type.number(Kind.UINT, size) for size in (1, 2, 4, 8))
f32, f64 = (Type.number(Kind.FLOAT, size) for size in (4, 8))
string = Type.string()


def type_of(what):
    """The Type that a class, a Type, or bool, int, float, str stands for."""
    plain = {bool: boolean, int: i64, float: f64, str: string}
    if isinstance(what, Type):
        return what
    if what in plain:
        return plain[what]
    found = vars(what).get('__lot_type__') if isinstance(what, type) else None
    if found is None:
        raise TypeError(f'{what!r} is no message type: use @lot.message, lot.f32, lot.vector[...]')
    return found


class vector:
    """lot.vector[T]: any number of T."""

    def __class_getitem__(cls, element):
        return Type.vector(type_of(element))


class array:
    """lot.array[T, n]: n of T."""

    def __class_getitem__(cls, parts):
        element, count = parts
        return Type.array(type_of(element), count)


class ref:
    """lot.ref[T]: a reference to a message of type T."""

    def __class_getitem__(cls, target):
        return Type.reference(type_of(target))


class duration:
    """lot.duration[T, numerator, denominator]: so many seconds, numerator / denominator, are one."""

    def __class_getitem__(cls, parts):
        number, numerator, denominator = parts
        return Type.duration(type_of(number), numerator, denominator)


def time_point(clock, span):
    """A time point of 'system_clock' or 'steady_clock'; span: a lot.duration."""
    return Type.time_point(clock, span)


def enumeration(number, name=None):
    """Decorates an IntEnum: it lies as that integer. name: the C++ name, by default the class's."""

    def decorate(cls):
        if not issubclass(cls, enum.IntEnum):
            raise TypeError(f'{cls.__name__} is no IntEnum')
        cls.__lot_type__ = Type.enumeration(name or cls.__name__, type_of(number))
        return cls

    return decorate


def message(cls=None, *, name=None):
    """Decorates a class with annotations: the type of messages whose C++ struct has that name and these
    fields, in this order. name: the C++ name with its namespaces, by default the class's.

        @lot.message(name='robot::Box')
        class Box:
            x: lot.f32
            label: lot.string
    """

    def decorate(decorated):
        hints = inspect.get_annotations(decorated, eval_str=True)
        decorated.__lot_type__ = Type.structure(
            name or decorated.__name__, [(field, type_of(what)) for field, what in hints.items()])
        return decorated

    return decorate if cls is None else decorate(cls)


def _advertise(self, topic, message_type, *, policy=Policy.OVERWRITE, depth=64, block_for=1.0, history=None, max_bytes=0,
               stamp=False, queue_engine=QueueEngine.RING):
    """A publisher of the topic. message_type: a class, or a Type. block_for: seconds that a push waits under
    Policy.BLOCK. history: how many of the newest messages stay for later readers; None: all."""
    return self._advertise(topic, type_of(message_type), policy, depth, block_for, history, max_bytes, stamp, queue_engine)


def _subscribe(self, topic, message_type=None, *, wait=Wait.ADAPTIVE, history=0, max_held_bytes=0, observer=False):
    """A subscriber of the topic. message_type: a class, or a Type; None: what the topic carries, which some process
    must use then (errno.ENOENT). history: how many messages of before come first. observer: it only looks on."""
    wanted = None if message_type is None else type_of(message_type)
    return self._subscribe(topic, wanted, wait, history, max_held_bytes, observer)


def _make(self, message_type, **fields):
    """A message that belongs to no topic, with these fields set: to be finished by lot.share()."""
    return self._make(type_of(message_type), **fields)


def _queue(self, name, item_type, *, depth=64, policy=Policy.BLOCK, redeliver=False, wait=Wait.ADAPTIVE,
           queue_engine=QueueEngine.RING):
    """A queue whose items are each taken by one reader. item_type: a class, or a Type. depth: how many of this handle
    wait in it at most. redeliver: items are tasks (take()), which another worker gets if one dies at work."""
    return self._queue(name, type_of(item_type), depth, policy, redeliver, wait, queue_engine)


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
        self._entries = {}  # by number: what, the handler, and whether it is called once only
        self._due = collections.deque()

    def _enter(self, what, handler, once=False):
        if not callable(handler):
            raise TypeError(f'{handler!r} is no handler')
        number = next(self._numbers)
        self._entries[number] = (what, handler, once)
        return number

    def add(self, end, handler):
        """Calls handler() when the Subscriber or Queue may have something. A handler looks with timeout 0."""
        number = self._enter(end, handler)
        try:
            self._waits.add(number, end)
        except BaseException:
            del self._entries[number]
            raise

    def add_timer(self, period, handler):
        """Calls handler() every so many seconds. Gives a number, for remove()."""
        number = self._enter(None, handler)
        try:
            self._waits.add_timer(number, period, True)
        except BaseException:
            del self._entries[number]
            raise
        return number

    def add_timer_once(self, delay, handler):
        """Calls handler() once, after so many seconds. Gives a number, for remove()."""
        number = self._enter(None, handler, once=True)
        self._waits.add_timer(number, delay, False)
        return number

    def remove(self, what):
        """A Subscriber, a Queue or a timer's number: it is not called any more. Nothing where it was not added."""
        numbers = [number for number, entry in self._entries.items() if entry[0] is what or number is what]
        for number in numbers:
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
            entry = self._entries.get(self._due[0])
            number = self._due.popleft()
            if entry is None:  # another handler has removed it
                continue
            if entry[2]:
                del self._entries[number]
            called += 1
            entry[1]()
        return called

    def run(self):
        """Calls handlers until stop()."""
        while self.run_once() is not None:
            pass

    def stop(self):
        """Ends run() after the handlers that are at work, or the next run() at once."""
        self._waits.stop()


def _require_room(self):
    if self.status == Status.HOLDS_TOO_MUCH:
        raise Error(errno.EDQUOT, 'the subscription keeps all that it may (max_held_bytes): let messages go')


def _iterate(self):
    """Messages until the last publisher has gone."""
    while True:
        found = self.pull()
        if found is None:
            _require_room(self)
            return
        yield found
        del found  # what the caller has let go does not count while this waits


async def _iterate_async(self):
    """Messages until the last publisher has gone; other tasks run meanwhile."""
    loop = asyncio.get_running_loop()
    descriptor = self.fileno()
    had_publisher = self.publishers() > 0
    while True:
        found = self.pull(timeout=0)
        if found is not None:
            had_publisher = True
            yield found
            del found
            continue
        _require_room(self)
        has_publisher = self.publishers() > 0
        if had_publisher and not has_publisher and self.size() == 0:
            return
        had_publisher = has_publisher
        readable = loop.create_future()
        loop.add_reader(descriptor, lambda: readable.done() or readable.set_result(None))
        try:
            await readable
        finally:
            loop.remove_reader(descriptor)


def _fill(part, source):
    """Sets elements; a number that does not fit is an error, where numpy would cut it."""
    target, values = numpy.asarray(part), numpy.asarray(source)
    casting = 'same_kind'
    if target.dtype.kind in 'iu' and values.dtype.kind in 'iu' and not numpy.can_cast(values.dtype, target.dtype):
        bounds = numpy.iinfo(target.dtype)
        if values.size and (values.min() < bounds.min or values.max() > bounds.max):
            raise OverflowError(f'some of these do not fit a {target.dtype}')
        casting = 'unsafe'
    numpy.copyto(target, values, casting=casting)


def _dlpack(self, **arguments):
    """For torch.from_dlpack() and others: the elements, without a copy. Of a loan: DLPack cannot say read-only."""
    return numpy.asarray(self).__dlpack__(**arguments)


def _dlpack_device(self):
    return numpy.asarray(self).__dlpack_device__()


def _same(copy):
    """What a message is pickled as: a copy in plain Python."""
    return copy


Engine.advertise = _advertise
Engine.subscribe = _subscribe
Engine.make = _make
Engine.queue = _queue
Part.__dlpack__ = _dlpack
Part.__dlpack_device__ = _dlpack_device
Subscriber.__iter__ = _iterate
Subscriber.__aiter__ = _iterate_async
