# SPDX-License-Identifier: Apache-2.0
"""LOT: messages in shared memory, without copies. docs/python.md says what its objects keep.

    engine = lot.Engine()
    sub = engine.subscribe("/camera/front")
    with sub.borrow(timeout=0.1) as frame:
        if frame is not None:
            image = numpy.asarray(frame.data).reshape(frame.height, frame.width, 3)
"""

import asyncio
import enum
import errno
import inspect
import operator
import time
import types

import numpy

from lot._lot import (Borrow, Engine, Envelope, Error, Kind, OutOfMemory, Part, Policy, Publisher, Queue, QueueEngine,
                      RecordedMessage, RecordedMessages, RecordedTopic, Recording, RecordingDamage, Status, Subscriber,
                      Task, Type, Wait, Weak, end_cleanly_on_signals, share, weak)
from lot.service import Client, Server, _Ends as _ServiceEnds, print_error
from lot.waits import WaitSet

__all__ = ['Borrow', 'Client', 'Engine', 'Envelope', 'Error', 'Kind', 'OutOfMemory', 'Part', 'Policy', 'Publisher', 'Queue',
           'QueueEngine', 'RecordedMessage', 'RecordedMessages', 'RecordedTopic', 'Recording', 'RecordingDamage', 'Server', 'Status',
           'Subscriber', 'Task', 'Type', 'Wait', 'WaitSet', 'Weak', 'array', 'boolean', 'char', 'duration',
           'end_cleanly_on_signals', 'enumeration', 'f32', 'f64', 'i8', 'i16', 'i32', 'i64', 'message', 'ref', 'share', 'string',
           'time_point', 'type_of', 'u8', 'u16', 'u32', 'u64', 'vector', 'weak']

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


def _count(name, value):
    """The number that an argument is; TypeError, which names the argument."""
    try:
        number = operator.index(value)
    except TypeError:
        number = -1
    if not 0 <= number < 1 << 64:
        raise TypeError(f'{name}: takes a number of 0 or more, not {value!r}')
    return number


def _a(kind, name, value):
    """The argument, which is of that class; TypeError, which names the argument."""
    if not isinstance(value, kind):
        module = '' if kind.__module__ == 'builtins' else 'lot.'
        raise TypeError(f'{name}: takes a {module}{kind.__name__}, not {value!r}')
    return value


class vector:
    """lot.vector[T]: any number of T."""

    def __class_getitem__(cls, element):
        return Type.vector(type_of(element))


class array:
    """lot.array[T, n]: n of T."""

    def __class_getitem__(cls, parts):
        if not isinstance(parts, tuple) or len(parts) != 2:
            raise TypeError(f'lot.array takes an element and a count, lot.array[lot.f32, 3], not {parts!r}')
        element, count = parts
        return Type.array(type_of(element), _count('count', count))


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


def _require_fields_alone(cls, hints):
    """TypeError for what a struct of LOT cannot have."""
    for base in cls.__mro__[1:]:
        if '__lot_type__' in vars(base) or vars(base).get('__annotations__'):
            raise TypeError(f'{cls.__name__} inherits fields of {base.__name__}: a message has all of its fields in its own '
                            f'class. Repeat them there, or have a field of type {base.__name__}')
    for name, value in vars(cls).items():
        if name in hints and not isinstance(value, types.MemberDescriptorType):
            raise TypeError(f'{cls.__name__}.{name}: a field has no default. Set it in each message: loan({name}=...)')
        is_method = isinstance(value, (types.FunctionType, property, classmethod, staticmethod))
        is_nested = isinstance(value, type) and value.__qualname__.startswith(cls.__qualname__ + '.')
        if not (name in hints or is_method or is_nested or name.startswith('__')):
            raise TypeError(f'{cls.__name__}.{name} is no field: a field has an annotation, as in x: lot.f32. Other values '
                            'stand outside of the class')


def message(cls=None, *, name=None):
    """Decorates a class with annotations: the type of messages whose C++ struct has that name and these
    fields, in this order. name: the C++ name with its namespaces, by default the class's.

        @lot.message(name='robot::Box')
        class Box:
            x: lot.f32
            label: lot.string
    """

    if cls is not None and not isinstance(cls, type):
        raise TypeError(f'@lot.message decorates a class; with a name it is @lot.message(name={cls!r})')

    def decorate(decorated):
        hints = inspect.get_annotations(decorated, eval_str=True)
        _require_fields_alone(decorated, hints)
        decorated.__lot_type__ = Type.structure(
            name or decorated.__name__, [(field, type_of(what)) for field, what in hints.items()])
        return decorated

    return decorate if cls is None else decorate(cls)


def _advertise(self, topic, message_type, *, policy=Policy.OVERWRITE, depth=64, block_for=1.0, history=None, max_bytes=0,
               stamp=False, queue_engine=QueueEngine.RING):
    """A publisher of the topic. message_type: a class, or a Type. block_for: seconds that a push waits under
    Policy.BLOCK. history: how many of the newest messages stay for later readers; None: all."""
    return self._advertise(
        _a(str, 'topic', topic), type_of(message_type), _a(Policy, 'policy', policy), _count('depth', depth), block_for,
        history if history is None else _count('history', history), _count('max_bytes', max_bytes), stamp,
        _a(QueueEngine, 'queue_engine', queue_engine))


def _subscribe(self, topic, message_type=None, *, wait=Wait.ADAPTIVE, history=0, max_held_bytes=0, observer=False, timeout=0):
    """A subscriber of the topic. message_type: a class, or a Type; None: what the topic carries, which some process
    must use then. timeout: seconds to wait for such a process (errno.ENOENT: there is none); None: for ever. history:
    how many messages of before come first. observer: it only looks on."""
    _a(str, 'topic', topic)
    wanted = _type_on(self, topic, timeout) if message_type is None else type_of(message_type)
    return self._subscribe(topic, wanted, _a(Wait, 'wait', wait), _count('history', history),
                           _count('max_held_bytes', max_held_bytes), observer)


def _type_on(engine, topic, timeout):
    """What the topic carries, as soon as a process uses it; None: the time is up."""
    until = float('inf') if timeout is None else time.monotonic() + timeout
    while (found := engine.type_of(topic)) is None and time.monotonic() < until:
        time.sleep(0.02)
    return found


def _make(self, message_type, **fields):
    """A message that belongs to no topic, with these fields set: to be finished by lot.share()."""
    return self._make(type_of(message_type), **fields)


def _queue(self, name, item_type, *, depth=64, policy=Policy.BLOCK, redeliver=False, wait=Wait.ADAPTIVE,
           queue_engine=QueueEngine.RING):
    """A queue whose items are each taken by one reader. item_type: a class, or a Type. depth: how many of this handle
    wait in it at most. redeliver: items are tasks (take()), which another worker gets if one dies at work."""
    return self._queue(_a(str, 'name', name), type_of(item_type), _count('depth', depth), _a(Policy, 'policy', policy), redeliver,
                       _a(Wait, 'wait', wait), _a(QueueEngine, 'queue_engine', queue_engine))


def _serve(self, name, request_type, response_type, handler, *, wait=Wait.ADAPTIVE, on_error=print_error):
    """Answers the requests of a service by handler(request, response), which fills the response in shared memory, on a
    thread of its own: until Server.close(), or the end of its `with`. What the handler raises, the client gets as an
    Error. on_error(exception): told what else keeps a request from its answer."""
    return Server(self, _ServiceEnds(name, type_of(request_type), type_of(response_type)), handler, wait, on_error)


def _client(self, name, request_type, response_type, *, wait=Wait.ADAPTIVE, retry=False):
    """Asks the servers of a service. retry: a request whose server dies at work goes to another one, so it may be done
    more than once."""
    return Client(self, _ServiceEnds(name, type_of(request_type), type_of(response_type)), wait, retry)


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


def _elements(part, source):
    """What the vector or array is to be filled with, in its shape. Whoever gives an array of another shape means its
    elements in their order: an image of three dimensions fills a vector of bytes."""
    with memoryview(part) as view:
        size, (_, *inner), is_struct = view.itemsize, view.shape, view.format.startswith('T{')
    if isinstance(source, (bytes, bytearray)):
        if size != 1 or is_struct:
            raise TypeError('bytes fill elements of one byte: use numpy.frombuffer(...) with the type of the elements')
        its = numpy.asarray(part).dtype
        source = numpy.frombuffer(source, numpy.uint8 if its.kind == 'b' else its)  # not every byte is a bool
    values = numpy.asarray(source)
    has_shape = isinstance(source, (numpy.ndarray, memoryview, Part)) and bool(values.dtype.names) == is_struct
    if not has_shape or values.ndim in (0, 1 + len(inner)):
        return values
    return values.reshape(-1, *inner)


def _fill(part, source):
    """Sets elements; a number that does not fit is an error, where numpy would cut it."""
    target, values = numpy.asarray(part), numpy.asarray(source)
    if target.dtype.names and not values.dtype.names:
        target = _plain(target, values.shape)
    casting = 'same_kind'
    if target.dtype.kind in 'iu' and values.dtype.kind in 'iu' and not numpy.can_cast(values.dtype, target.dtype):
        bounds = numpy.iinfo(target.dtype)
        if values.size and (values.min() < bounds.min or values.max() > bounds.max):
            raise OverflowError(f'some of these do not fit a {target.dtype}')
        casting = 'unsafe'
    numpy.copyto(target, values, casting=casting)


def _plain(structs, shape):
    """Structs of equal fields as rows of an array, to be set by an array of (n, fields)."""
    fields = [structs.dtype[name] for name in structs.dtype.names]
    are_rows = len(set(fields)) == 1 and fields[0].kind in 'biuf' and structs.dtype.itemsize == len(fields) * fields[0].itemsize
    if not are_rows or shape[1:] != (len(fields),):
        raise TypeError('structs are set by a list of dicts or tuples, by a structured array, or, where all fields have one type, '
                        'by an array of (n, fields)')
    return structs.view(fields[0]).reshape(-1, len(fields))


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
Engine.client = _client
Engine.make = _make
Engine.queue = _queue
Engine.serve = _serve
Part.__dlpack__ = _dlpack
Part.__dlpack_device__ = _dlpack_device
Subscriber.__iter__ = _iterate
Subscriber.__aiter__ = _iterate_async
