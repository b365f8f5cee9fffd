#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The package `lot`: types, views, lifetimes, errors, threads, signals, fork, asyncio.

    lot_test.py PACKAGES PEER [unittest's arguments]    PACKAGES: the folder that has lot/; PEER: peer.cpp's program
"""

import asyncio
import enum
import errno
import gc
import os
import pickle
import random
import select
import signal
import subprocess
import sys
import threading
import time
import unittest

sys.path.insert(0, sys.argv.pop(1))
PEER = sys.argv.pop(1)
os.environ.pop('LD_PRELOAD', None)  # of a sanitizer: the peer has its own

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


def setUpModule():
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
    def test_random_programs_see_what_was_sent_and_leave_nothing(self):
        seed = random.SystemRandom().getrandbits(32)
        for number in range(100):
            with self.subTest(seed=seed, number=number):
                program = Program(self, random.Random(f'{seed} {number}'))
                for _ in range(60):
                    program.step()
                del program


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
        kept = sub.pull(0)
        child = os.fork()
        if child == 0:
            code = 1
            try:
                for call in (lambda: sub.pull(0), lambda: pub.loan(), lambda: self.engine.advertise('/x', Point)):
                    self.raises(errno.ECHILD, call)
                lot.Engine().advertise('/mine', Point)
                code = 0
            finally:
                os._exit(code)
        self.assertEqual(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), 0)
        self.assertEqual(kept.x, 1)
        self.assertTrue(pub.push(pub.loan(x=2)))

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
