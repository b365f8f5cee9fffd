#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The package `lot`: types, views, lifetimes, errors, threads, signals, fork, asyncio.

    lot_test.py PACKAGES PEER [unittest's arguments]    PACKAGES: the folder that has lot/; PEER: peer.cpp's program
"""

import ast
import asyncio
import enum
import errno
import gc
import importlib.util
import os
import pathlib
import pickle
import random
import select
import signal
import subprocess
import sys
import tempfile
import threading
import time
import unittest
import unittest.mock
import weakref

sys.path.insert(0, sys.argv.pop(1))
PEER = sys.argv.pop(1)
RUNTIME = os.environ.pop('LD_PRELOAD', '')  # of a sanitizer: the peer has its own

import lot  # noqa: E402
import numpy as np  # noqa: E402


@lot.message
class Point:
    flag: lot.u8
    x: lot.f64
    counts: lot.array[lot.i16, 3]
    y: lot.f32


@lot.enumeration(lot.u16)
class Mode(enum.IntEnum):
    IDLE = 0
    MOVING = 7


@lot.message(name='robot::Box')
class Box:
    label: lot.string
    mode: Mode
    scores: lot.vector[lot.f32]
    points: lot.vector[Point]
    names: lot.vector[lot.string]
    rows: lot.vector[lot.vector[lot.u8]]
    grid: lot.array[lot.array[lot.u16, 2], 3]
    home: lot.ref[Point]
    is_good: bool


@lot.message
class Frame:
    height: lot.u32
    width: lot.u32
    data: lot.vector[lot.u8]


@lot.message
class Job:
    number: lot.i32
    text: lot.string


@lot.message
class Note:
    label: lot.string
    scores: lot.vector[lot.f32]
    points: lot.vector[Point]
    names: lot.vector[lot.string]
    is_good: bool


@lot.message
class Pair:
    left: lot.ref[Point]
    right: lot.ref[Point]
    boxes: lot.vector[lot.ref[Box]]


NEEDED = {'cv2': 'no OpenCV here', 'PIL': 'no Pillow here'}  # scripts/setup test has them


def needs(name):
    return unittest.skipUnless(importlib.util.find_spec(name), NEEDED[name])


def setUpModule():
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores it
    for name, reason in NEEDED.items():
        if not importlib.util.find_spec(name):
            print('skipped:', reason)
    os.environ.setdefault('LOT_SEGMENT', f'lot_python_{os.getpid()}')
    os.environ['LOT_SIZE'] = '64M'


class Case(unittest.TestCase):
    """Each has an engine, and leaves no file."""

    def setUp(self):
        self.engine = lot.Engine()
        self.path = self.engine.path

    def tearDown(self):
        for name in list(vars(self)):
            if not name.startswith('_') and name != 'path':
                delattr(self, name)
        gc.collect()
        self.assertFalse(os.path.exists(self.path), 'something still keeps the segment')

    def ends(self, what, topic='/topic', **options):
        return self.engine.advertise(topic, what, **options), self.engine.subscribe(topic, what)

    def raises(self, number, call, *arguments, **named):
        with self.assertRaises(lot.Error) as caught:
            call(*arguments, **named)
        self.assertEqual(caught.exception.errno, number, caught.exception)


class Types(Case):
    def test_a_class_lies_as_the_struct_of_c(self):
        point = lot.type_of(Point)
        self.assertEqual((point.name, point.size, point.alignment), ('Point', 32, 8))
        self.assertEqual([(name, offset) for name, offset, _ in point.fields()],
                         [('flag', 0), ('x', 8), ('counts', 16), ('y', 24)])
        self.assertEqual(point.fields()[2][2].element(), lot.i16)

    def test_a_type_goes_through_bytes(self):
        box = lot.type_of(Box)
        again = lot.Type.decode(box.name, box.alignment, box.encode())
        self.assertEqual(box, again)
        self.assertEqual(hash(box), hash(again))
        self.assertNotEqual(box, lot.type_of(Point))
        self.assertNotEqual(box, 5)

    def test_what_is_no_type_is_refused(self):
        self.raises(errno.EINVAL, lot.Type.number, lot.Kind.UINT, 3)
        self.raises(errno.EINVAL, lot.Type.structure, '', [])
        with self.assertRaises(TypeError):
            lot.vector[list]
        with self.assertRaises(TypeError):
            @lot.message
            class Wrong:
                x: dict

    def refused(self, text, call, *arguments, **named):
        with self.assertRaisesRegex(TypeError, text):
            call(*arguments, **named)

    def test_what_a_struct_cannot_have_is_refused(self):
        class Derived(Point):
            z: lot.f64

        class Default:
            x: lot.f64 = 7.0

        class Bare:
            x = lot.f64

        class Other:
            x: lot.f64
            y = float

        class Fine:
            x: lot.f64

            class Inner:
                pass

            def twice(self):
                return 2 * self.x
        self.refused('Derived inherits fields of Point: .*a field of type Point', lot.message, Derived)
        self.refused(r'Default.x: a field has no default.*loan\(x=', lot.message, Default)
        self.refused('Bare.x is no field: .*annotation', lot.message, Bare)
        self.refused('Other.y is no field', lot.message, Other)
        self.assertEqual(len(lot.type_of(lot.message(Fine)).fields()), 1)
        self.refused("lot.message.name='robot::Bad'", lot.message, 'robot::Bad')

    def test_wrong_arguments_are_named(self):
        self.refused("size_bytes: takes a number of 0 or more, not '2G'", lot.Engine, size_bytes='2G')
        self.refused('segment: takes a str, not 3', lot.Engine, segment=3)
        self.refused("persist: takes True or False, not 'yes'", lot.Engine, persist='yes')
        self.refused("policy: takes a lot.Policy, not 'block'", self.engine.advertise, '/topic', Point, policy='block')
        self.refused('topic: takes a str, not 3', self.engine.advertise, 3, Point)
        self.refused('topic: takes a str, not 3', self.engine.subscribe, 3)
        self.refused('history: takes a number of 0 or more, not -1', self.engine.subscribe, '/topic', Point, history=-1)
        self.refused('history: takes a number of 0 or more, not -1', self.engine.advertise, '/topic', Point, history=-1)
        self.refused("policy: takes a lot.Policy, not 'block'", self.engine.queue, 'jobs', Job, policy='block')
        self.refused('element and a count', lot.array.__class_getitem__, lot.f32)
        self.refused('count: takes a number of 0 or more, not -1', lot.array.__class_getitem__, (lot.f32, -1))
        self.refused('request: takes what loan', self.engine.client('/frame', Job, Frame).call, {'number': 3})
        self.refused('end: takes a Subscriber or a Queue', lot.WaitSet().add, 3, print)

    def test_a_subscriber_waits_for_the_type_of_its_topic(self):
        self.raises(errno.ENOENT, self.engine.subscribe, '/topic', timeout=0.05)
        pubs = []
        later = threading.Timer(0.1, lambda: pubs.append(self.engine.advertise('/topic', Point)))
        later.start()
        sub = self.engine.subscribe('/topic', timeout=None)
        later.join()
        pubs[0].push(pubs[0].loan(x=3))
        self.assertEqual(sub.pull(0).x, 3)

    def test_a_topic_tells_its_type(self):
        self.raises(errno.ENOENT, self.engine.subscribe, '/none')
        self.assertIsNone(self.engine.type_of('/none'))
        pub = self.engine.advertise('/topic', Box)
        self.assertEqual(self.engine.subscribe('/topic').type, lot.type_of(Box))
        self.assertEqual(self.engine.type_of('/topic'), pub.type)
        self.raises(errno.EPROTOTYPE, self.engine.advertise, '/topic', Point)


class Peers(Case):
    """Beside a program in C++ that has the same types."""

    def test_types_are_those_of_cpp(self):
        lines = subprocess.run([PEER, 'types'], check=True, capture_output=True, text=True).stdout.splitlines()
        for line, what in zip(lines, (Point, Frame, Box), strict=True):
            name, *numbers = line.split()
            its = lot.type_of(what)
            self.assertEqual(its.name, name)
            self.assertEqual([its.size, its.alignment, its.layout_hash, its.names_hash],
                             [int(number) for number in numbers], name)

    def test_messages_go_both_ways(self):
        slots, blocks = self.engine.subscribe('/slots', Point), self.engine.subscribe('/blocks', Point)
        boxes = self.engine.subscribe('/box', Box)
        answers = self.engine.advertise('/answer', Box)
        with subprocess.Popen([PEER, 'send'], stdout=subprocess.PIPE, text=True) as peer:
            for points in (slots, blocks):
                views = []
                for i in range(3):
                    with points.borrow() as point:
                        self.assertEqual((point.x, point.counts[2]), (i + 0.5, -3))
                        views.append(np.asarray(point))
                # A view of a message that lay in a slot has a copy; of one in a block it keeps the message.
                self.assertEqual([float(view['x']) for view in views], [0.5, 1.5, 2.5])
            with boxes.borrow() as box:
                home = box.home
                Values.check(self, box, 42)
                self.assertEqual(home.x, 42)
                answer = answers.loan(**{name: box.copy().__dict__[name] for name in box.fields() if name != 'home'
                                         and name != 'points'}, points=np.asarray(box.points))
            self.assertTrue(answers.push(answer))
            said = peer.stdout.read()
        self.assertEqual((peer.returncode, said), (0, 'left \u00e9 7 2.5 2.5 40 3 6\n'))


    def test_items_go_both_ways(self):
        jobs, points = self.engine.queue('/items', Job), self.engine.queue('/points', Point)
        self.assertTrue(jobs.put(jobs.loan(number=7, text='x' * 50)))
        said = subprocess.run([PEER, 'items'], check=True, capture_output=True, text=True).stdout
        self.assertEqual(said, f"7 {'x' * 50}\n")
        self.assertEqual([points.pop().x, points.pop().x], [1.5, 2.5])
        self.assertIsNone(points.pop(0))

    def test_a_task_of_a_killed_worker_comes_again(self):
        tasks = self.engine.queue('/tasks', Job, redeliver=True)
        for number in range(3):
            self.assertTrue(tasks.put(tasks.loan(number=number)))
        peer = subprocess.run([PEER, 'tasks'], capture_output=True, text=True)
        self.assertEqual((peer.returncode, peer.stdout), (-signal.SIGKILL, '0\n'))
        seen = set()
        for _ in range(2):
            with tasks.take() as task:
                seen.add((task.item.number, task.deliveries))
        self.assertEqual(seen, {(1, 2), (2, 1)})
        self.assertFalse(tasks.take(0))


class Values(Case):
    def box(self, pub):
        return pub.loan(label='left \u00e9', mode=Mode.MOVING, scores=[0.5, 1.5, 2.5], points=[{'x': 1.0}, {'x': 2.5}],
                        names=['a', 'b' * 40], rows=[[1, 2], [], [3]], grid=[[1, 2], [3, 4], [5, 6]], is_good=True)

    def check(self, box, home=None):
        self.assertEqual(box.label, 'left \u00e9')
        self.assertEqual(Mode(box.mode), Mode.MOVING)
        self.assertIs(box.is_good, True)
        self.assertEqual(list(box.scores), [0.5, 1.5, 2.5])
        self.assertEqual(box.points[1].x, 2.5)
        self.assertEqual(box.points[-2].x, 1.0)
        self.assertEqual(box['points[1].x'], 2.5)
        self.assertEqual(list(box.names), ['a', 'b' * 40])
        self.assertEqual([list(row) for row in box.rows], [[1, 2], [], [3]])
        self.assertEqual(np.asarray(box.grid).tolist(), [[1, 2], [3, 4], [5, 6]])
        self.assertEqual(box.home and box.home.x, home)
        self.assertEqual(len(box.points), 2)
        self.assertIn('label: "left', repr(box))
        self.assertIn('scores', dir(box))

    def test_fields_are_set_and_read(self):
        pub, sub = self.ends(Box)
        box = self.box(pub)
        self.check(box)
        self.assertTrue(pub.push(box))
        with self.assertRaises(ValueError):
            box.label
        again = pub.loan()
        again.scores = np.array([1, 2], np.float64)
        again.scores = np.arange(3, dtype=np.float32) + 0.5
        again.rows.resize(1)
        again.rows[0] = np.array([1, 255], np.int64)
        self.assertEqual(([*again.scores], [*again.rows[0]]), ([0.5, 1.5, 2.5], [1, 255]))
        with sub.borrow(0) as seen:
            self.check(seen)
            copied = pickle.loads(pickle.dumps(seen))
        self.assertEqual(copied.label, 'left \u00e9')
        self.assertEqual(copied.scores.tolist(), [0.5, 1.5, 2.5])
        self.assertEqual(copied.points['x'].tolist(), [1.0, 2.5])
        self.assertEqual(copied.names, ['a', 'b' * 40])

    def test_structs_are_structured_arrays(self):
        pub, sub = self.ends(Box)
        box = pub.loan()
        box.points.resize(1000)
        view = np.asarray(box.points)
        self.assertEqual((view.shape, view.dtype.itemsize), ((1000,), 32))
        view['x'] = np.arange(1000)
        view['counts'][:, 1] = 5
        del view
        pub.push(box)
        seen = sub.pull(0)
        self.assertEqual(seen.points[999].x, 999)
        self.assertEqual(list(seen.points[7].counts), [0, 5, 0])
        self.assertEqual(np.asarray(seen.points)['x'].sum(), 499500)

    def test_what_does_not_fit_is_refused(self):
        pub = self.engine.advertise('/topic', Box)
        box = self.box(pub)
        for wrong, error in (({'mode': 70000}, OverflowError), ({'mode': 'x'}, TypeError), ({'mode': -1}, OverflowError),
                             ({'nothing': 1}, AttributeError), ({'label': 3}, TypeError),
                             ({'scores': ['x']}, TypeError), ({'rows': [[1], [256]]}, OverflowError), ({'rows': [[-1]]}, OverflowError),
                             ({'scores': np.zeros(3, complex)}, TypeError), ({'grid': [[1, 2]] * 4}, ValueError),
                             ({'points': [3]}, Exception)):
            with self.assertRaises(error, msg=wrong):
                for name, value in wrong.items():
                    setattr(box, name, value)
        with self.assertRaises(IndexError):
            box.points[2]
        self.raises(errno.EINVAL, box.__getitem__, 'points[2]')
        self.assertEqual(box.mode, 7)

    def test_errors_name_the_field(self):
        box = self.box(self.engine.advertise('/topic', Box))
        fields = "Point has no field 'z': it has flag, x, counts, y"
        for name, value, error, text in (
                ('mode', 'x', TypeError, 'mode, Mode: must be real'), ('mode', 70000, OverflowError, 'mode'),
                ('label', 3, TypeError, 'label, string: takes a str or bytes, not 3'),
                ('names', 3, TypeError, 'names, vector of string: takes a sequence'),
                ('scores', ['x'], TypeError, 'scores, vector'), ('home', 3, TypeError, 'home'),
                ('points', [{'x': 'y'}], TypeError, r'points\[0\].x, float64: must be real'),
                ('points', [(1, 2)], ValueError, r'points\[0\], Point: it has 4 fields'),
                ('points', [{'z': 1}], AttributeError, fields)):
            with self.assertRaisesRegex(error, text):
                setattr(box, name, value)
        with self.assertRaisesRegex(AttributeError, fields):
            box.points[0].z

    def test_arrays_of_any_shape_fill_elements(self):
        pub = self.engine.advertise('/topic', Frame)
        image = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
        for data in (image, image[:, ::-1], image.tobytes(), bytearray(image), memoryview(image)):
            loan = pub.loan(data=data)
            self.assertEqual(np.asarray(loan.data).tobytes(), data.tobytes() if isinstance(data, np.ndarray) else bytes(data))
        self.assertEqual(len(pub.loan(data=b'').data), 0)
        box = self.engine.advertise('/box', Box).loan()
        box.scores = np.ones((2, 3))
        self.assertEqual(len(box.scores), 6)
        box.grid = np.arange(6)
        self.assertEqual(np.asarray(box.grid).tolist(), [[0, 1], [2, 3], [4, 5]])
        for wrong in ({'scores': b'abcd'}, {'points': np.ones((2, 4))}):
            with self.assertRaisesRegex(TypeError, 'bytes fill|a list of dicts'):
                setattr(box, *wrong.popitem())
        with self.assertRaises(ValueError):
            box.grid = np.arange(5)

    def test_structs_are_filled_by_tuples_and_rows(self):
        @lot.message
        class Corner:
            x: lot.f32
            y: lot.f32

        @lot.message
        class Shape:
            corners: lot.vector[Corner]
            origin: Corner
        shape = self.engine.advertise('/shape', Shape).loan(corners=[(1, 2), (3, 4)], origin=(5, 6))
        self.assertEqual([(corner.x, corner.y) for corner in shape.corners], [(1, 2), (3, 4)])
        self.assertEqual(shape.origin.y, 6)
        shape.corners = np.arange(6).reshape(3, 2)
        self.assertEqual((len(shape.corners), shape.corners[2].y), (3, 5))

    def test_parts_are_objects_like_others(self):
        pub = self.engine.advertise('/topic', Box)
        box = self.box(pub)
        for wrong, error in ((lot.Part, TypeError), (lambda: type('Mine', (lot.Part,), {}), TypeError),
                             (lambda: delattr(box, 'mode'), TypeError), (lambda: box.scores.__delitem__(0), TypeError),
                             (lambda: box.scores.resize('x'), TypeError), (lambda: box.scores.resize(-1), OverflowError),
                             (lambda: box.scores.resize(1 << 64), OverflowError), (lambda: box[1.5], TypeError),
                             (lambda: getattr(box, '\udcff'), UnicodeEncodeError)):
            with self.assertRaises(error):
                wrong()
        seen = weakref.ref(box)
        self.assertIs(seen(), box)
        self.assertEqual((len({box, box}), bool(box.names), [*reversed(box.scores)]), (1, True, [2.5, 1.5, 0.5]))
        self.assertEqual([name for name in dir(box) if not name.startswith('_')],
                         sorted(['assign', 'copy', 'fields', 'resize', *box.fields()]))
        del box
        self.assertIsNone(seen())

    def test_received_messages_are_read_only(self):
        pub, sub = self.ends(Box)
        pub.push(self.box(pub))
        seen = sub.pull(0)
        for change in (lambda: setattr(seen, 'mode', 1), lambda: seen.scores.resize(5),
                       lambda: seen.scores.assign([1]), lambda: seen.points[0].__setattr__('x', 1)):
            with self.assertRaises(TypeError):
                change()
        view = np.asarray(seen.scores)
        self.assertFalse(view.flags.writeable)
        with self.assertRaises(ValueError):
            view[0] = 1
        with self.assertRaises(BufferError):
            np.frombuffer(seen.names, np.uint8)
        self.assertTrue(memoryview(seen.scores).readonly)

    def test_a_view_is_no_copy(self):
        pub, sub = self.ends(Frame)
        frame = pub.loan(width=4, height=2)
        frame.data.resize(8 << 20)
        place = np.asarray(frame.data).ctypes.data
        np.asarray(frame.data)[:] = 9
        pub.push(frame)
        seen = sub.pull(0)
        self.assertEqual(np.asarray(seen.data).ctypes.data, place)
        self.assertEqual(bytes(memoryview(seen.data)[:3]), b'\t\t\t')


class Views(Case):
    """What a view says of itself, as PEP 3118 has it."""

    def view(self, what, **fields):
        """Of the field `it` of a loan with that type."""
        made = lot.message(type('Holder', (), {'__annotations__': {'before': lot.u8, 'it': what}}))
        loan = self.engine.advertise('/' + str(len(self.engine_topics)), made).loan(**fields)
        self.engine_topics.append(made)
        return memoryview(loan.it)

    def setUp(self):
        super().setUp()
        self.engine_topics = []

    def told(self, what, **fields):
        view = self.view(what, **fields)
        self.assertEqual(view.nbytes, view.itemsize * (np.prod(view.shape, dtype=int) if view.ndim else 1))
        self.assertFalse(view.readonly)
        return view.format, view.itemsize, view.shape, view.strides

    def test_a_number_is_one_letter(self):
        for what, letter, size in ((bool, '?', 1), (lot.char, 'c', 1), (lot.i8, 'b', 1), (lot.i16, 'h', 2),
                                   (lot.i32, 'i', 4), (lot.i64, 'q', 8), (lot.u8, 'B', 1), (lot.u16, 'H', 2),
                                   (lot.u32, 'I', 4), (lot.u64, 'Q', 8), (lot.f32, 'f', 4), (lot.f64, 'd', 8)):
            with self.subTest(what):
                two = {bool: [True, False], lot.char: [b'a', b'b']}.get(what, [1, 0])
                self.assertEqual(self.told(lot.vector[what], it=two), (letter, size, (2,), (size,)))
                self.assertEqual(self.told(lot.array[what, 3]), (letter, size, (3,), (size,)))
        self.assertEqual(self.told(lot.vector[Mode], it=[0, 7, 7]), ('H', 2, (3,), (2,)))

    def test_an_empty_vector_has_a_view_of_nothing(self):
        self.assertEqual(self.told(lot.vector[lot.f32]), ('f', 4, (0,), (4,)))

    def test_arrays_in_arrays_are_dimensions(self):
        self.assertEqual(self.told(lot.array[lot.array[lot.u16, 2], 3]), ('H', 2, (3, 2), (4, 2)))
        self.assertEqual(self.told(lot.array[lot.array[lot.array[lot.f64, 5], 2], 3]), ('d', 8, (3, 2, 5), (80, 40, 8)))
        self.assertEqual(self.told(lot.vector[lot.array[lot.f32, 4]], it=[[1, 2, 3, 4]] * 2), ('f', 4, (2, 4), (16, 4)))
        view = self.view(lot.array[lot.array[lot.u16, 2], 3], it=np.arange(6))
        self.assertEqual(view.tolist(), [[0, 1], [2, 3], [4, 5]])
        deep = lot.u8
        for _ in range(14):
            deep = lot.array[deep, 1]
        self.assertEqual(self.told(deep)[2], (1,) * 14)

    def test_a_struct_has_names_and_padding(self):
        @lot.message
        class Inner:
            low: lot.u8
            rows: lot.array[lot.array[lot.f32, 3], 2]

        @lot.message
        class Outer:
            first: lot.i64
            inner: Inner
            last: lot.i16
        text = 'T{=B:low:3x(2,3)=f:rows:}'
        self.assertEqual(self.told(Inner), (text, 28, (), ()))
        self.assertEqual(self.told(lot.vector[Inner], it=[{}, {}]), (text, 28, (2,), (28,)))
        self.assertEqual(self.told(Outer), ('T{=q:first:' + text + ':inner:=h:last:2x}', 40, (), ()))
        self.assertEqual(self.told(Point), ('T{=B:flag:7x=d:x:(3)=h:counts:2x=f:y:4x}', 32, (), ()))
        read = np.asarray(self.view(lot.vector[Point], it=[{'x': 1.5, 'y': 2, 'counts': [1, 2, 3]}]))
        self.assertEqual((read['x'][0], read['y'][0], read['counts'][0].tolist()), (1.5, 2, [1, 2, 3]))

    def test_what_is_elsewhere_has_no_view(self):
        for what in (lot.vector[lot.string], lot.vector[lot.vector[lot.u8]], lot.array[lot.string, 2],
                     lot.array[lot.ref[Point], 2], Note):
            with self.subTest(what), self.assertRaisesRegex(BufferError, 'use them one by one'):
                self.view(what)

    def test_a_user_of_bytes_alone_gets_bytes_alone(self):
        pub, sub = self.ends(Frame)
        pub.push(pub.loan(data=[1, 2, 3]))
        seen = sub.pull(0)
        self.assertEqual(bytes(seen.data), b'\1\2\3')
        with tempfile.TemporaryFile() as file:
            self.assertEqual(file.write(seen.data), 3)
            file.seek(0)
            loan = pub.loan(data=bytes(3))
            self.assertEqual(file.readinto(loan.data), 3)
            self.assertEqual(bytes(loan.data), b'\1\2\3')
            file.seek(0)
            with self.assertRaisesRegex((BufferError, TypeError), 'read-only|read-write'):
                file.readinto(seen.data)


class Lifetimes(Case):
    def push(self, pub, value):
        frame = pub.loan(width=value)
        frame.data.resize(1000)
        np.asarray(frame.data)[:] = value
        self.assertTrue(pub.push(frame))

    def test_a_view_keeps_its_message(self):
        pub, sub = self.ends(Frame, depth=2)
        self.push(pub, 1)
        view = np.asarray(sub.pull(0).data)[10:20]
        for value in range(2, 200):  # each block of the publisher comes again
            self.push(pub, value)
        self.assertTrue((view == 1).all())

    def test_a_view_outlives_its_borrow_and_a_part_does_not(self):
        pub, sub = self.ends(Frame, depth=2)
        self.push(pub, 1)
        with sub.borrow(0) as frame:
            view = np.asarray(frame.data)
            data = frame.data
        for value in range(2, 200):  # each block of the publisher comes again
            self.push(pub, value)
        self.assertTrue((view == 1).all())
        for use in (lambda: frame.width, lambda: len(data), lambda: np.asarray(data, dtype=np.uint8)[0], lambda: repr(frame)):
            with self.assertRaises((ValueError, BufferError)):
                use()
        with sub.borrow(0) as frame:
            self.assertEqual(frame.width, 198)

    def test_a_borrow_is_closed_by_an_exception(self):
        pub, sub = self.ends(Frame)
        self.push(pub, 1)
        self.push(pub, 2)
        with self.assertRaises(ZeroDivisionError):
            with sub.borrow(0) as frame:
                1 / 0
        with sub.borrow(0) as frame:
            self.assertEqual(frame.width, 2)
            self.raises(errno.EBUSY, sub.borrow, 0)
        with sub.borrow(0) as frame:
            self.assertIsNone(frame)
        self.assertEqual(sub.status, lot.Status.EMPTY)

    def test_a_loan_with_views_is_neither_pushed_nor_grown(self):
        pub, sub = self.ends(Frame)
        frame = pub.loan()
        frame.data.resize(10)
        view = np.asarray(frame.data)
        for grow in (lambda: frame.data.resize(20), lambda: pub.push(frame)):
            with self.assertRaises(BufferError):
                grow()
        view[:] = 3
        del view
        frame.data.resize(20)
        self.assertTrue(pub.push(frame))
        self.assertEqual(np.asarray(sub.pull(0).data).sum(), 30)

    def test_parts_of_a_loan_stay_right_while_it_grows(self):
        pub = self.engine.advertise('/topic', Box)
        box = pub.loan()
        box.points.resize(2)
        first, last = box.points[0], box.points[1]
        last.x = 7
        box.points.resize(10000)
        self.assertEqual(last.x, 7)
        first.x = 8
        self.assertEqual(box.points[0].x, 8)
        box.points.resize(1)
        with self.assertRaises(lot.Error):
            last.x

    def test_objects_go_in_any_order(self):
        pub, sub = self.ends(Frame)
        self.push(pub, 5)
        frame = sub.pull(0)
        data = frame.data
        del pub, sub, frame
        self.engine = None
        self.assertEqual(np.asarray(data)[999], 5)

    def test_a_message_is_forwarded_without_a_copy(self):
        pub, sub = self.ends(Frame)
        out, again = self.ends(Frame, '/again')
        self.push(pub, 5)
        frame = sub.pull(0)
        self.assertTrue(out.push(frame))
        self.assertEqual(np.asarray(again.pull(0).data).ctypes.data, np.asarray(frame.data).ctypes.data)
        with self.assertRaises(TypeError):
            out.push(frame.data)
        other = self.engine.advertise('/other', Point)
        self.raises(errno.EINVAL, other.push, frame)


    def test_a_weak_pointer_keeps_nothing(self):
        pub, sub = self.ends(Frame, depth=2)
        self.push(pub, 5)
        frame = sub.pull(0)
        weak = lot.weak(frame)
        self.assertEqual(weak().width, 5)
        with self.assertRaises(TypeError):
            lot.weak(frame.data)
        del frame
        for value in range(200):
            self.push(pub, value)
            sub.pull(0)
        self.assertIsNone(weak())

    def test_references_keep_their_targets(self):
        pub, sub = self.ends(Pair)
        left = lot.share(self.engine.make(Point, x=3))
        with self.assertRaises(TypeError):
            left.x = 5
        pair = pub.loan(left=left)
        pair.boxes.resize(2)
        other = self.engine.make(Box, label='left', scores=[1, 2])
        other.home = left
        pair.boxes[1] = lot.share(other)
        pair.right = left
        pair.right = None
        for wrong, error in ((3, TypeError), (pair, TypeError), (self.engine.make(Point), TypeError)):
            with self.assertRaises(error, msg=wrong):
                pair.right = wrong
        self.raises(errno.EINVAL, setattr, pair, 'right', lot.share(self.engine.make(Box)))
        del left, other
        self.assertTrue(pub.push(pair))
        del pub, pair
        seen = sub.pull(0)
        self.assertEqual((seen.left.x, seen.right, seen.boxes[0]), (3, None, None))
        self.assertEqual((seen.boxes[1].label, seen.boxes[1].home.x), ('left', 3))
        view = np.asarray(seen.boxes[1].scores)
        del seen
        self.assertEqual(view.tolist(), [1, 2])

    def test_a_message_of_no_topic_goes_on_several(self):
        point = lot.share(self.engine.make(Point, x=3))
        subs = []
        for topic in ('/a', '/b'):
            pub, sub = self.ends(Point, topic)
            self.assertTrue(pub.push(point))
            subs.append(sub)
        self.assertEqual([sub.pull(0).x for sub in subs], [3, 3])

    def test_dlpack_takes_loans(self):
        pub, sub = self.ends(Frame)
        frame = pub.loan()
        frame.data.resize(100)
        np.asarray(frame.data)[:] = 7
        seen = np.from_dlpack(frame.data)
        self.assertEqual(seen.ctypes.data, np.asarray(frame.data).ctypes.data)
        with self.assertRaises(BufferError):
            pub.push(frame)
        del seen
        self.assertTrue(pub.push(frame))
        kept = sub.pull(0)
        self.assertEqual(np.asarray(kept.data).sum(), 700)
        with self.assertRaises(BufferError):
            np.from_dlpack(kept.data)

    def image(self):
        """A received frame of 4 x 6 pixels with three colours, and its view."""
        pub, sub = self.ends(Frame)
        frame = pub.loan(height=4, width=6)
        frame.data = np.arange(72, dtype=np.uint8)
        pub.push(frame)
        frame = sub.pull(0)
        return frame, np.asarray(frame.data).reshape(frame.height, frame.width, 3)

    @needs('cv2')
    def test_opencv_takes_views(self):
        import cv2
        frame, image = self.image()
        self.assertEqual(cv2.extractChannel(image, 1).tolist(), image[:, :, 1].tolist())
        self.assertEqual(cv2.sumElems(image)[0], image[:, :, 0].sum())

    @needs('PIL')
    def test_pillow_takes_views(self):
        from PIL import Image
        frame, pixels = self.image()
        image = Image.frombuffer('L', (18, 4), frame.data, 'raw', 'L', 0, 1)
        self.assertEqual(np.asarray(image).tolist(), pixels.reshape(4, 18).tolist())


class Queues(Case):
    def test_items_wait_for_the_one_that_pops(self):
        jobs = self.engine.queue('jobs', Job, depth=2, policy=lot.Policy.REFUSE)
        self.assertIsNone(jobs.pop(0))
        self.assertIsNone(jobs.pop(0.02))
        for number in range(2):
            self.assertTrue(jobs.put(jobs.loan(number=number)))
        job = jobs.loan(number=2)
        self.assertFalse(jobs.put(job))
        self.assertEqual((jobs.size(), jobs.capacity, jobs.type), (2, 2, lot.type_of(Job)))
        first = jobs.pop()
        self.assertEqual(first.number, 0)
        with self.assertRaises(TypeError):
            first.number = 3
        self.assertTrue(jobs.put(job))
        with self.assertRaises(ValueError):
            job.number
        self.assertEqual([jobs.pop(1).number, jobs.pop(1).number], [1, 2])
        self.raises(errno.EINVAL, jobs.take, 0)
        self.raises(errno.EINVAL, jobs.put, self.engine.make(Point))
        self.raises(errno.EPROTOTYPE, self.engine.queue, 'jobs', Point)
        self.raises(errno.EPROTOTYPE, self.engine.queue, 'jobs', Job, redeliver=True)

    def test_a_full_queue_is_waited_for(self):
        jobs = self.engine.queue('jobs', Job, depth=1)
        self.assertTrue(jobs.put(jobs.loan(number=1)))
        job = jobs.loan(number=2)
        self.assertFalse(jobs.put(job, 0))
        self.assertFalse(jobs.put(job, 0.06))
        popper = threading.Timer(0.1, lambda: jobs.pop(0))
        popper.start()
        self.assertTrue(jobs.put(job))
        popper.join()
        self.assertEqual(jobs.pop(0).number, 2)

    def test_a_task_is_done_at_the_end_of_its_with(self):
        tasks = self.engine.queue('tasks', Job, redeliver=True)
        self.assertTrue(tasks.put(tasks.loan(number=1)))
        with self.assertRaises(ZeroDivisionError):
            with tasks.take() as task:
                1 / 0
        with self.assertRaises(ValueError):
            task.item.number
        with tasks.take() as task:
            self.assertEqual((task.item.number, task.deliveries), (1, 2))
            self.assertFalse(tasks.take(0))
            task.give_back()
        del task
        task = tasks.take()
        item = task.item
        self.assertEqual(task.deliveries, 3)
        task.finish()
        with self.assertRaises(ValueError):
            item.number
        with self.assertRaises(ValueError):
            task.finish()
        with tasks.take(0.02) as none:
            self.assertIsNone(none)
        for use in (lambda: tasks.take(0).item, tasks.take(0).finish):
            with self.assertRaises(ValueError):
                use()
        self.raises(errno.EINVAL, tasks.pop, 0)

    def test_views_keep_the_item_of_a_task(self):
        frames = self.engine.queue('frames', Frame, redeliver=True, depth=2)

        def put(value):
            frame = frames.loan(width=value)
            frame.data = np.full(1000, value, np.uint8)
            self.assertTrue(frames.put(frame))
        put(1)
        with frames.take() as task:
            view = np.asarray(task.item.data)
        put(2)
        with self.assertRaises(ZeroDivisionError):
            with frames.take() as task:
                other = np.asarray(task.item.data)
                1 / 0
        with frames.take() as task:
            self.assertEqual(task.item.width, 2)
        for value in range(3, 200):
            put(value)
            with frames.take():
                pass
        self.assertTrue((view == 1).all() and (other == 2).all())

    def test_ctrl_c_ends_a_pop(self):
        jobs, tasks = self.engine.queue('jobs', Job, depth=1), self.engine.queue('tasks', Job, redeliver=True)
        jobs.put(jobs.loan())
        for call in (tasks.take, lambda: jobs.put(jobs.loan())):
            threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGINT)).start()
            with self.assertRaises(KeyboardInterrupt):
                call()


class WaitSets(Case):
    def test_handlers_are_called(self):
        pub, sub = self.ends(Point)
        jobs = self.engine.queue('jobs', Job)
        waits, seen = lot.WaitSet(), []
        waits.add(sub, lambda: seen.append(sub.pull(0).x))
        waits.add(jobs, lambda: seen.append(jobs.pop(0).number))
        self.assertEqual(waits.run_once(0), 0)
        self.assertEqual(waits.run_once(0.06), 0)
        for x in range(2):
            pub.push(pub.loan(x=x))
        jobs.put(jobs.loan(number=7))
        while len(seen) < 3:
            waits.run_once()
        self.assertEqual(sorted(seen), [0, 1, 7])
        waits.remove(sub)
        pub.push(pub.loan(x=9))
        self.assertEqual(waits.run_once(0.02), 0)
        for wrong, error in ((lambda: waits.add(sub, 3), TypeError), (lambda: waits.add(pub, print), TypeError),
                             (lambda: waits.add_timer(0, print), lot.Error)):
            with self.assertRaises(error):
                wrong()

    def test_an_end_is_added_once(self):
        pub, sub = self.ends(Point)
        waits = lot.WaitSet()
        waits.add(sub, print)
        self.raises(errno.EEXIST, waits.add, sub, print)
        waits.remove(sub)
        waits.add(sub, waits.stop)
        pub.push(pub.loan())
        waits.run()

    def test_timers_and_stop(self):
        waits, calls = lot.WaitSet(), []
        timer = waits.add_timer(0.001, lambda: calls.append('often'))
        waits.add_timer_once(0.01, lambda: calls.append('once'))
        waits.add_timer_once(0.05, waits.stop)
        waits.run()
        self.assertEqual(calls.count('once'), 1)
        self.assertGreater(calls.count('often'), 1)
        waits.remove(timer)
        calls.clear()
        self.assertEqual((waits.run_once(0.02), calls), (0, []))
        waits.stop()
        self.assertIsNone(waits.run_once())
        stopper = threading.Timer(0.05, waits.stop)
        stopper.start()
        waits.run()
        stopper.join()

    def test_what_a_handler_raises_leaves_run(self):
        pub, sub = self.ends(Point)
        waits, seen = lot.WaitSet(), []

        def handle():
            seen.append(sub.pull(0).x)
            if seen[-1] == 0:
                raise KeyError
        waits.add(sub, handle)
        for x in range(2):
            pub.push(pub.loan(x=x))
        with self.assertRaises(KeyError):
            waits.run()
        waits.run_once()
        self.assertEqual(seen, [0, 1])

    def test_ends_may_go_before_their_set(self):
        pub, sub = self.ends(Point)
        waits = lot.WaitSet()
        waits.add(sub, lambda end=sub: waits.stop() or end.pull(0))
        del sub
        pub.push(pub.loan())
        waits.run()

    def test_one_thread_waits(self):
        pub, sub = self.ends(Point)
        waits, refused = lot.WaitSet(), []
        waits.add(sub, lambda: sub.pull(0))

        def look():
            for call in (lambda: waits.run_once(0), lambda: sub.pull(0)):
                try:
                    call()
                except lot.Error as error:
                    refused.append(error.errno)
        timer = threading.Timer(0.1, look)
        timer.start()
        waits.run_once(0.5)
        timer.join()
        self.assertEqual(refused, [errno.EBUSY] * 2)

    def test_ctrl_c_ends_run(self):
        waits = lot.WaitSet()
        threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGINT)).start()
        with self.assertRaises(KeyboardInterrupt):
            waits.run()


def answer(job, frame):
    if job.number < 0:
        raise ValueError('no frame is so small')
    frame.width = len(job.text)
    frame.data = np.full(job.number, 7, np.uint8)


class Services(Case):
    def test_a_client_asks_a_server(self):
        client = self.engine.client('/frame', Job, Frame)
        self.assertFalse(client.wait_for_server(0.02))
        self.assertIsNone(client.call(number=3, timeout=0.02))
        self.assertEqual(client.status, lot.Status.SERVER_GONE)
        with self.engine.serve('/frame', Job, Frame, answer):
            self.assertTrue(client.wait_for_server())
            self.assertEqual(client.servers(), 1)
            frame = client.call(number=3, text='ab')
            self.assertEqual((frame.width, np.asarray(frame.data).tolist()), (2, [7, 7, 7]))
            self.assertEqual(client.status, lot.Status.OK)
            with self.assertRaisesRegex(lot.Error, 'no frame is so small') as caught:
                client.call(number=-1)
            self.assertEqual(caught.exception.errno, errno.EREMOTEIO)
            request = client.loan(number=100)
            request.text = 'x' * 100
            self.assertEqual(len(client.call(request, timeout=60).data), 100)
            with self.assertRaises(ValueError):
                client.call(request)
            self.raises(errno.EPROTOTYPE, self.engine.client, '/frame', Job, Job)
        self.assertIsNone(client.call(number=3, timeout=0.02))
        self.assertEqual(frame.width, 2)

    def test_what_a_handler_leaves_is_no_answer(self):
        kept = []
        with self.engine.serve('/frame', Job, Frame, lambda job, frame: (answer(job, frame), kept.append(np.asarray(frame.data)))):
            client = self.engine.client('/frame', Job, Frame)
            with self.assertRaisesRegex(lot.Error, 'views of this loan'):
                client.call(number=3)
        kept.clear()

    def test_a_server_outlives_what_its_handler_raises(self):
        def leave(job, frame):
            if job.number < 0:
                sys.exit('cannot do that')
            answer(job, frame)
        server = self.engine.serve('/frame', Job, Frame, leave)
        with server:
            client = self.engine.client('/frame', Job, Frame)
            with self.assertRaisesRegex(lot.Error, 'SystemExit: cannot do that'):
                client.call(number=-1)
            self.assertEqual(len(client.call(number=3).data), 3)
            server.close()
        server.close()

    def test_a_call_without_a_limit_ends_where_there_is_no_server(self):
        client = self.engine.client('/frame', Job, Frame)
        self.assertIsNone(client.call(number=3))
        self.assertEqual(client.status, lot.Status.SERVER_GONE)

    def test_a_late_answer_is_dropped(self):
        go = threading.Event()

        def late(job, frame):
            go.wait()
            answer(job, frame)
        with self.engine.serve('/frame', Job, Frame, late):
            client = self.engine.client('/frame', Job, Frame)
            self.assertIsNone(client.call(number=1, timeout=0.1))
            self.assertEqual(client.status, lot.Status.TIMEOUT)
            go.set()
            self.assertEqual(len(client.call(number=2).data), 2)

    def test_a_client_asks_cpp(self):
        client = self.engine.client('/frame', Job, Frame)
        with subprocess.Popen([PEER, 'serve'], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as peer:
            self.assertTrue(client.wait_for_server())
            frame = client.call(number=3, text='ab')
            self.assertEqual((frame.width, np.asarray(frame.data).tolist()), (2, [7, 7, 7]))
            with self.assertRaisesRegex(lot.Error, 'no frame is so small'):
                client.call(number=-1)
            peer.kill()
        self.assertIsNone(client.call(number=3, timeout=0.02))

    def test_cpp_asks_a_server(self):
        with self.engine.serve('/frame', Job, Frame, answer):
            said = subprocess.run([PEER, 'call'], check=True, capture_output=True, text=True).stdout
        self.assertEqual(said, '46 3\n1\n')

    def test_a_server_ends_with_its_program(self):
        program = (f"import sys; sys.path.insert(0, {sys.path[0]!r}); import lot; Job = lot.message(type('Job', (), dict("
                   "__annotations__=dict(number=lot.i32)))); lot.Engine().serve('/job', Job, Job, print); print('end')")
        said = subprocess.run([sys.executable, '-c', program], check=True, capture_output=True, text=True,
                              env=dict(os.environ, LD_PRELOAD=RUNTIME)).stdout
        self.assertEqual(said, 'end\n')


PROGRAM = """
import signal, sys, threading, time
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.path.insert(0, sys.argv[1])
import lot
@lot.message
class Job:
    number: lot.i32
engine = lot.Engine()
sub, jobs, waits = engine.subscribe('/topic', Job), engine.queue('jobs', Job), lot.WaitSet()
waits.add(sub, print)
begun = threading.Event()
def loop():
    for _ in sub:
        pass
def often():
    while True:
        sub.pull(0.1)
def stubborn():
    while True:
        try:
            sub.pull(0.01)
        except BaseException:
            pass
def start(work, daemon=True):
    def run():
        begun.set()
        work()
    thread = threading.Thread(target=run, daemon=daemon)
    thread.start()
    begun.wait()
    time.sleep(0.1)
    return thread
def ready_in_join():  # a Ctrl-C before that leaves a thread for which Python waits
    main = threading.main_thread().ident
    while sys._current_frames()[main].f_code.co_name != '_wait_for_tstate_lock':
        time.sleep(0.01)
    time.sleep(0.1)
    print('ready', flush=True)
"""


class Ends(Case):
    """Programs that end while a thread of theirs waits, or by a signal."""

    def run_program(self, text, number=None):
        """Its exit status, whether its segment is still there, and what it said of errors."""
        segment = f"{os.environ['LOT_SEGMENT']}_ends"
        environment = dict(os.environ, LD_PRELOAD=RUNTIME, LOT_SEGMENT=segment)
        path = os.path.join(os.path.dirname(self.path), segment)
        with subprocess.Popen([sys.executable, '-c', PROGRAM + text, sys.path[0]], env=environment, stdout=subprocess.PIPE,
                              stderr=subprocess.PIPE, text=True) as program:
            if number is not None:
                program.stdout.readline()
                program.send_signal(number)
            try:
                said = program.communicate(timeout=90)[1]
            except subprocess.TimeoutExpired:
                program.kill()
                raise
        stays = os.path.exists(path)
        for name in (path, path + '.lock'):
            if os.path.exists(name):
                os.unlink(name)
        return program.returncode, stays, said

    def test_a_program_ends_while_a_daemon_thread_waits(self):
        for work, status in (('sub.pull', 3), ('loop', 0), ('jobs.pop', 3), ('waits.run', 0), ('often', 3)):
            with self.subTest(work=work):
                self.assertEqual(self.run_program(f'start({work}); sys.exit({status})' if status else f'start({work})'),
                                 (status, False, ''))

    def test_a_program_ends_while_a_thread_will_not(self):
        status, _, said = self.run_program('start(stubborn); sys.exit(3)')
        self.assertEqual((status, said), (3, ''))

    def test_ctrl_c_ends_a_program_that_joins_a_waiting_thread(self):
        for daemon in (True, False):
            text = f'its = start(sub.pull, {daemon}); threading.Thread(target=ready_in_join, daemon=True).start(); its.join()'
            status, stays, said = self.run_program(text, number=signal.SIGINT)
            self.assertEqual((status, stays, said.splitlines()[-1:]), (-signal.SIGINT, False, ['KeyboardInterrupt']))

    def test_signals_leave_no_file(self):
        for number in (signal.SIGTERM, signal.SIGHUP):
            self.assertEqual(self.run_program("lot.end_cleanly_on_signals(); print('ready', flush=True); sub.pull()", number=number),
                             (-number, False, ''))


class Recordings(Case):
    def setUp(self):
        super().setUp()
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.file = os.path.join(folder.name, 'some.mcap')
        pub = self.engine.advertise('/topic', Note)

        def push(number):
            self.assertTrue(pub.push(pub.loan(label=f'note {number}', scores=[number, 0.5], points=[{'x': number}], names=['a'],
                                              is_good=True)))
        push(0)
        with subprocess.Popen([PEER, 'record', self.file], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as peer:
            self.assertEqual(peer.stdout.readline(), b'ready\n')  # it has the first one
            push(1)
            push(2)
            peer.stdin.close()
        self.assertEqual(peer.returncode, 0)

    def test_messages_are_read(self):
        recording = lot.Recording(self.file)
        topic, = recording.topics
        self.assertEqual((topic.name, topic.messages, topic.objection), ('/topic', 3, ''))
        seen = []
        for message in recording:
            its = message.message
            seen.append((its.label, its.scores.tolist(), its.points['x'].tolist(), its.names, its.is_good))
            self.assertEqual((message.topic, message.sequence % 2**31), ('/topic', len(seen) - 1))
            self.assertTrue(recording.begin_ns <= message.log_time_ns <= recording.end_ns)
            last = message
        self.assertEqual(seen, [(f'note {n}', [n, 0.5], [n], ['a'], True) for n in range(3)])
        for use in (lambda: last.payload, lambda: last.message):
            with self.assertRaises(ValueError):
                use()
        self.assertEqual(recording.damage().first, '')

    def test_what_is_asked_for_comes(self):
        recording = lot.Recording([self.file])
        times = [message.log_time_ns for message in recording.messages(['/top*'])]
        self.assertEqual(len(times), 3)
        self.assertEqual([m.log_time_ns for m in recording.messages(from_ns=times[1], until_ns=times[1])], times[1:2])
        self.assertEqual(list(recording.messages(['/other'])), [])
        self.raises(errno.ENOENT, lot.Recording, self.file + '.none')
        self.assertEqual(len(list(recording.messages('/topic'))), 3)
        self.assertEqual(lot.Recording(pathlib.Path(self.file)).type_of('/topic'), lot.type_of(Note))
        self.raises(errno.ENOENT, recording.type_of, '/other')
        for wrong, text in ((lambda: lot.Recording(3), 'path: a path or a list of paths, not 3'),
                            (lambda: recording.messages([3]), 'topics: a name or a list of names, not 3'),
                            (lambda: recording.type_of(3), 'topic: a RecordedTopic or a name, not 3')):
            with self.assertRaisesRegex(TypeError, text):
                wrong()

    def test_messages_are_published_again(self):
        recording = lot.Recording(self.file)
        pub = self.engine.advertise('/again', recording.type_of(recording.topics[0]))
        sub = self.engine.subscribe('/again')
        for message in recording:
            loan = pub.loan()
            message.copy_to(loan)
            self.assertTrue(pub.push(loan))
        self.assertEqual([sub.pull(0).label for _ in range(3)], [f'note {number}' for number in range(3)])


class Program:
    """A random program of loans, pushes, pulls, borrows, views, slices, deletes and exceptions."""

    def __init__(self, case, chance):
        self.case, self.chance = case, chance
        self.pub, self.sub = case.ends(Frame, depth=chance.randint(1, 8))
        self.loans, self.kept, self.views = [], [], []
        self.number = 0

    def step(self):
        self.chance.choice((self.loan, self.push, self.push, self.pull, self.pull, self.borrow, self.look, self.grow,
                            self.forget, self.forget))()
        for view, value in self.views:
            self.case.assertTrue((view == value).all())

    def loan(self):
        self.number += 1
        loan = self.pub.loan(width=self.number % 251)
        loan.data.resize(self.chance.choice((1, 100, 5000, 100000)))
        np.asarray(loan.data)[:] = loan.width
        self.loans.append(loan)

    def push(self):
        if self.loans:
            loan = self.loans.pop(self.chance.randrange(len(self.loans)))
            view = np.asarray(loan.data) if self.chance.random() < 0.2 else None
            if view is not None:
                with self.case.assertRaises(BufferError):
                    self.pub.push(loan)
                del view
            self.case.assertTrue(self.pub.push(loan))
            with self.case.assertRaises(ValueError):
                loan.width

    def pull(self):
        frame = self.sub.pull(0)
        if frame is not None:
            self.kept.append(frame)

    def borrow(self):
        try:
            with self.sub.borrow(0) as frame:
                if frame is not None and self.chance.random() < 0.5:
                    self.views.append((np.asarray(frame.data)[self.chance.randrange(3)::2], frame.width))
                if self.chance.random() < 0.3:
                    raise KeyError
        except KeyError:
            pass
        if frame is not None:
            with self.case.assertRaises(ValueError):
                frame.width

    def look(self):
        if self.kept:
            frame = self.chance.choice(self.kept)
            self.views.append((np.asarray(frame.data)[::3], frame.width))

    def grow(self):
        if self.loans:
            loan = self.chance.choice(self.loans)
            data = loan.data
            data.resize(self.chance.randint(1, 9999))
            np.asarray(data)[:] = loan.width

    def forget(self):
        some = self.chance.choice((self.loans, self.kept, self.views))
        if some:
            some.pop(self.chance.randrange(len(some)))


class RandomPrograms(Case):
    """LOT_PYTHON_PROGRAMS=10000: so many, where there is time."""

    def setUp(self):
        super().setUp()
        self._seed = random.SystemRandom().getrandbits(32)

    def test_random_programs_see_what_was_sent_and_leave_nothing(self):
        for number in range(int(os.environ.get('LOT_PYTHON_PROGRAMS', '100'))):
            with self.subTest(seed=self._seed, number=number):
                program = Program(self, random.Random(f'{self._seed} {number}'))
                for _ in range(60):
                    program.step()
                del program

    def test_killed_programs_leave_nothing(self):
        chance = random.Random(self._seed)
        for number in range(int(os.environ.get('LOT_PYTHON_PROGRAMS', '100')) // 10):
            ready, told = os.pipe()
            child = os.fork()
            if child == 0:
                try:
                    self.engine = lot.Engine()
                    program = Program(self, random.Random(f'{self._seed} {number}'))
                    os.write(told, b'.')
                    while True:
                        program.step()
                finally:
                    os._exit(1)
            self.assertEqual(os.read(ready, 1), b'.', f'seed {self._seed}, program {number}')
            time.sleep(chance.uniform(0, 0.02))
            os.kill(child, signal.SIGKILL)
            self.assertEqual(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), -signal.SIGKILL,
                             f'seed {self._seed}, program {number}')
            os.close(ready)
            os.close(told)
        # What they had is free again: half of the segment goes into one message.
        loan = self.engine.advertise('/large', Frame).loan()
        patience = time.monotonic() + 60
        while len(loan.data) == 0:
            try:
                loan.data.resize(30 << 20)
            except lot.OutOfMemory:
                if time.monotonic() > patience:
                    raise
                time.sleep(0.01)


class Waits(Case):
    def test_a_full_queue_leaves_the_loan(self):
        pub, sub = self.ends(Point, policy=lot.Policy.REFUSE, depth=2)
        for x in range(2):
            self.assertTrue(pub.push(pub.loan(x=x)))
        loan = pub.loan(x=5)
        self.assertFalse(pub.push(loan))
        self.assertEqual(sub.pull(0).x, 0)
        sub.pull(0)
        self.assertTrue(pub.push(loan))

    def test_timeouts_and_the_last_publisher(self):
        pub, sub = self.ends(Point)
        self.assertIsNone(sub.pull(0.12))
        self.assertEqual(sub.status, lot.Status.TIMEOUT)
        self.assertFalse(pub.wait_for_readers(2, 0.06))
        self.assertTrue(pub.wait_for_readers(1))
        leaver = threading.Timer(0.1, lambda ends: ends.clear(), ([pub],))
        leaver.start()
        del pub
        self.assertIsNone(sub.pull())
        leaver.join()
        self.assertEqual(sub.status, lot.Status.PUBLISHER_GONE)

    def test_another_thread_runs_while_one_waits(self):
        pub, sub = self.ends(Point)
        sender = threading.Timer(0.1, lambda: pub.push(pub.loan(x=3)))
        sender.start()
        self.assertEqual(sub.pull().x, 3)
        sender.join()

    def test_one_thread_at_a_time_looks(self):
        pub, sub = self.ends(Point)
        refused = []

        def look():
            try:
                sub.pull(0)
            except lot.Error as error:
                refused.append(error.errno)

        timer = threading.Timer(0.1, look)
        timer.start()
        self.assertIsNone(sub.pull(0.5))
        timer.join()
        self.assertEqual(refused, [errno.EBUSY])

    def test_ctrl_c_ends_a_wait(self):
        pub, sub = self.ends(Point)
        for call in (lambda: sub.pull(), lambda: sub.borrow(), lambda: pub.wait_for_readers(9)):
            threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGINT)).start()
            with self.assertRaises(KeyboardInterrupt):
                call()

    def test_the_descriptor_and_the_envelope(self):
        pub, sub = self.ends(Point, stamp=True)
        self.assertIsNone(sub.pull(0))
        self.assertEqual(select.select([sub], [], [], 0)[0], [])
        before = time.monotonic_ns()
        pub.push(pub.loan(x=3))
        self.assertEqual(select.select([sub], [], [], 60)[0], [sub])
        self.assertEqual(sub.size(), 1)
        sub.pull(0)
        envelope = sub.envelope()
        self.assertEqual((envelope.sequence, envelope.missed), (0, 0))
        self.assertGreaterEqual(envelope.pushed_ns, before)
        self.assertEqual((sub.publishers(), pub.readers(), sub.missed_total), (1, 1, 0))

    def test_loops(self):
        pub, sub = self.ends(Point)

        def send():
            for x in range(5):
                pub.push(pub.loan(x=x))
        sender = threading.Thread(target=send)
        sender.start()
        seen = []
        for point in sub:
            seen.append(point.x)
            if len(seen) == 5:
                break
        sender.join()
        self.assertEqual(seen, [0, 1, 2, 3, 4])
        del point

    def test_asyncio(self):
        pub, sub = self.ends(Point)
        seen = []

        async def read():
            async for point in sub:
                seen.append(point.x)
                if len(seen) == 5:
                    return

        async def send():
            for x in range(5):
                await asyncio.sleep(0.01)
                pub.push(pub.loan(x=x))

        async def both():
            await asyncio.wait_for(asyncio.gather(read(), send()), 60)

        asyncio.run(both())
        self.assertEqual(seen, [0, 1, 2, 3, 4])


class Options(Case):
    def test_an_engine_takes_the_options_of_cpp(self):
        with unittest.mock.patch.dict(os.environ):
            name = os.environ.pop('LOT_SEGMENT') + '_small'  # these come before options
            del os.environ['LOT_SIZE']
            engine = lot.Engine(segment=name, size_bytes=32 << 20, processes=4, topics=2, name='some')
        self.assertEqual(os.path.basename(engine.path), name)
        ends = [engine.advertise(f'/{number}', Point) for number in range(2)]
        self.raises(errno.ENOSPC, engine.advertise, '/2', Point)
        with self.assertRaisesRegex(TypeError, 'colour'):
            lot.Engine(colour=3)
        del ends

    def test_each_option_of_an_engine_counts(self):
        with tempfile.TemporaryDirectory(dir='/dev/shm', prefix='lot_python_') as folder, \
                unittest.mock.patch.dict(os.environ):
            del os.environ['LOT_SEGMENT'], os.environ['LOT_SIZE']
            own = dict(segment='own', directory=folder, size_bytes=32 << 20, permissions=0o606)
            engine = lot.Engine(**own)
            self.assertEqual(engine.path, os.path.join(folder, 'own'))
            seen = os.stat(engine.path)
            self.assertEqual((seen.st_size, seen.st_mode & 0o777), (32 << 20, 0o606))
            del engine, seen
            for name in 'processes', 'blocks', 'topics', 'channels', 'readers':
                with self.subTest(name), self.assertRaisesRegex(lot.Error, f'EngineOptions::{name}'):
                    lot.Engine(**own, **{name: 0xffffffff})
            for name in 'group', 'user':
                with self.subTest(name), self.assertRaisesRegex(lot.Error, 'nobody at all'):
                    lot.Engine(**own, **{name: 'nobody at all'})
            for wrong, text in (({'persist': 'x'}, "persist: takes True or False, not 'x'"),
                                ({'name': 3}, 'name: takes a str, not 3'),
                                ({'topics': -1}, 'topics: takes a number of 0 or more, not -1'),
                                ({'colour': 1}, "an engine has no option 'colour'")):
                with self.subTest(wrong), self.assertRaises(TypeError) as caught:
                    lot.Engine(**own, **wrong)
                self.assertEqual(str(caught.exception), text)

            def locked():
                return int(pathlib.Path('/proc/self/status').read_text().split('VmLck:')[1].split()[0])
            before = locked()
            try:
                engine = lot.Engine(**own, lock_memory=True)
                self.assertGreater(locked(), before)
                del engine
            except lot.Error as error:  # a process may not lock so much
                self.assertIn(error.errno, (errno.ENOMEM, errno.EPERM, errno.EAGAIN))
            engine = lot.Engine(**own, persist=True)
            path = engine.path
            del engine
            gc.collect()
            self.assertTrue(os.path.exists(path))

    def test_no_publisher_waits_for_an_observer(self):
        pub = self.engine.advertise('/topic', Point, policy=lot.Policy.REFUSE, depth=2)
        sub = self.engine.subscribe('/topic', observer=True)
        for x in range(5):
            self.assertTrue(pub.push(pub.loan(x=x)))
        self.assertEqual(pub.readers(), 0)
        first = sub.pull(0).x
        self.assertGreater(first, 0)
        self.assertEqual((sub.missed, sub.missed_total), (first, first))

    def test_history_comes_first(self):
        pub = self.engine.advertise('/topic', Point)
        for x in range(5):
            pub.push(pub.loan(x=x))
        late = self.engine.subscribe('/topic', history=2)
        self.assertEqual([late.pull(0).x, late.pull(0).x, late.pull(0)], [3, 4, None])

    def test_a_quota_ends_pulls_until_messages_go(self):
        pub = self.engine.advertise('/topic', Frame)
        sub = self.engine.subscribe('/topic', Frame, max_held_bytes=1 << 20)
        for _ in range(6):
            frame = pub.loan()
            frame.data.resize(800_000)
            pub.push(frame)
        kept = []
        while (frame := sub.pull(0)) is not None:
            kept.append(frame)
        self.assertIn(len(kept), range(1, 4))
        self.assertEqual(sub.status, lot.Status.HOLDS_TOO_MUCH)
        self.raises(errno.EDQUOT, next, iter(sub))
        with sub.borrow(0) as frame:
            view = np.asarray(frame.data)  # it may not be kept: the borrow goes on with its view
        self.raises(errno.EBUSY, sub.borrow, 0)
        del view, kept
        self.assertIsNotNone(sub.pull(0))


class Stubs(unittest.TestCase):
    def test_stubs_say_what_there_is(self):
        with open(os.path.join(os.path.dirname(lot.__file__), '__init__.pyi')) as file:
            known = {its.name: its for its in ast.parse(file.read()).body if isinstance(its, (ast.ClassDef, ast.FunctionDef))}
        for name in lot.__all__:
            its = getattr(lot, name)
            if isinstance(its, lot.Type):  # lot.f32
                continue
            self.assertIn(name, known)
            if not isinstance(its, type):
                continue
            said = {item.name for item in known[name].body if isinstance(item, ast.FunctionDef)}
            there = {key for key in vars(its) if not key.startswith('_')}
            if not issubclass(its, OSError) and not hasattr(its, '__members__'):
                self.assertEqual({key for key in said if not key.startswith('_')}, there, name)


class Faults(Case):
    def test_memory_that_is_not_there(self):
        pub = self.engine.advertise('/topic', Frame)
        frame = pub.loan()
        with self.assertRaises(MemoryError) as caught:
            frame.data.resize(1 << 40)
        self.assertIsInstance(caught.exception, lot.OutOfMemory)
        self.assertEqual(caught.exception.errno, errno.ENOBUFS)

    def test_a_forked_child_has_inert_objects(self):
        pub, sub = self.ends(Point)
        pub.push(pub.loan(x=1))
        kept, loan = sub.pull(0), pub.loan(x=5)
        child = os.fork()
        if child == 0:
            code = 1
            try:
                for call in (lambda: sub.pull(0), lambda: pub.loan(), lambda: self.engine.advertise('/x', Point),
                             lambda: setattr(loan, 'x', 6), lambda: loan.counts.assign([1, 2, 3])):
                    self.raises(errno.ECHILD, call)
                self.assertEqual((loan.x, memoryview(loan).readonly), (5, True))
                lot.Engine().advertise('/mine', Point)
                code = 0
            finally:
                os._exit(code)
        self.assertEqual(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), 0)
        self.assertEqual(kept.x, 1)
        self.assertEqual(loan.x, 5)
        self.assertTrue(pub.push(loan))

    def test_a_killed_process_leaves_what_it_has_pushed(self):
        sub = self.engine.subscribe('/topic', Point)
        ready, told = os.pipe()
        child = os.fork()
        if child == 0:
            pub, own = lot.Engine().advertise('/topic', Point), lot.Engine().subscribe('/topic', Point)
            for x in (11, 12):
                pub.push(pub.loan(x=x))
            kept, borrow, loan = own.pull(0), own.borrow(0), pub.loan()
            view = np.asarray(kept)
            os.write(told, b'.')
            signal.pause()
            os._exit(kept is borrow or loan is view)
        self.assertEqual(os.read(ready, 1), b'.')
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        self.assertEqual([sub.pull().x, sub.pull().x], [11, 12])
        self.assertIsNone(sub.pull())
        self.assertEqual(sub.status, lot.Status.PUBLISHER_GONE)
        os.close(ready)
        os.close(told)


if __name__ == '__main__':
    unittest.main()
