#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Nodelets of several libraries in managers of stock ROS: they share one copy of LOT."""

import os
import pathlib
import signal
import sys
import time
import unittest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent.parent))
from graph import Graph  # noqa: E402

PACKAGES = os.environ.get('LOT_ROS_NODELETS', 'nodelets')  # where the package lot_test lies
NODELET = '/usr/lib/nodelet/nodelet'
COUNT = 600


class Manager:
    """A nodelet manager of Debian's, and what is loaded into it."""

    def __init__(self, graph, name='manager'):
        self.graph = graph
        self.name = name
        self.process = graph.run([NODELET, 'manager', f'__name:={name}'])
        graph.wait_for(lambda: self.graph.ask('lookupService', f'/{name}/load_nodelet'), 'the manager')

    def load(self, kind, name=None):
        """The process that has loaded it; when that ends by SIGINT it unloads it."""
        name = name or kind.lower()
        loader = self.graph.run([NODELET, 'load', f'lot_test/{kind}', self.name, f'__name:={name}'])
        self.graph.wait_for(lambda: loader.poll() is not None or self.graph.parameter(name, 'ready'),
                            f'{name} in {self.name}')
        assert loader.poll() is None, self.graph.said(loader) + self.graph.said(self.process)
        return loader


class Nodelets(Graph):
    def __init__(self):
        super().__init__()
        self.env['ROS_PACKAGE_PATH'] = f'{PACKAGES}:/usr/share'

    def parameter(self, nodelet, what):
        return self.ask('getParam', f'/{nodelet}/{what}')

    def unload(self, loader, name):
        loader.send_signal(signal.SIGINT)
        loader.wait(20)
        for what in 'ready', 'first', 'received':
            self.ask('deleteParam', f'/{name}/{what}')

    def go(self):
        self.set_parameter('/camera/go', True)

    def saw(self, nodelet, of=('first', 'received', 'wrong', 'elsewhere'), until=COUNT):
        """What a viewer has seen when the message before number `until` has come, or 40 s have passed."""
        def last():
            return (self.parameter(nodelet, 'first') or 0) + (self.parameter(nodelet, 'received') or 0)
        patience = time.monotonic() + 40
        while last() < until and time.monotonic() < patience:
            time.sleep(0.1)
        return {what: self.parameter(nodelet, what) for what in of}

    def serialised(self):
        self.wait_for(lambda: self.parameter('camera', 'serialised') is not None, 'the end of the camera')
        return self.parameter('camera', 'serialised')


ALL = {'first': 0, 'received': COUNT, 'wrong': 0, 'elsewhere': 0}
WHEREVER = {'first': 0, 'received': COUNT, 'wrong': 0}
SHARED = {**WHEREVER, 'apart': 0}


class InOneManager(unittest.TestCase):
    def test_camera_and_viewers_of_three_libraries_in_any_order(self):
        for order in (('Camera', 'Viewer', 'OtherViewer'), ('Viewer', 'OtherViewer', 'Camera'),
                      ('OtherViewer', 'Camera', 'Viewer')):
            with self.subTest(order=order), Nodelets() as graph:
                manager = Manager(graph)
                for kind in order:
                    manager.load(kind)
                graph.go()
                for viewer in 'viewer', 'otherviewer':
                    self.assertEqual(graph.saw(viewer), ALL, graph.said(manager.process))
                self.assertEqual(graph.serialised(), 0)
                self.assertEqual(len(graph.look()['processes']), 1)  # one copy, one participant

    def test_plain_ones_beside_them(self):
        """They share one standard message, made once; the others get it where it lies."""
        for order in (('Camera', 'PlainViewer', 'Viewer'), ('PlainViewer', 'Viewer', 'Camera')):
            with self.subTest(order=order), Nodelets() as graph:
                manager = Manager(graph)
                for kind in order:
                    manager.load(kind)
                manager.load('PlainViewer', 'otherplain')
                graph.go()
                self.assertEqual(graph.saw('viewer'), ALL, graph.said(manager.process))
                for plain in 'plainviewer', 'otherplain':
                    self.assertEqual(graph.saw(plain, SHARED), SHARED, graph.said(manager.process))
                self.assertEqual(graph.serialised(), 0)

    def test_a_standard_image_goes_to_plain_ones_by_pointer(self):
        """To LOT's as a copy."""
        with Nodelets() as graph:
            manager = Manager(graph)
            manager.load('PlainViewer')
            manager.load('StandardCamera', 'camera')
            manager.load('PlainViewer', 'otherplain')
            manager.load('Viewer')
            graph.go()
            for plain in 'plainviewer', 'otherplain':
                self.assertEqual(graph.saw(plain, {**SHARED, **ALL}), {**SHARED, **ALL}, graph.said(manager.process))
            self.assertEqual(graph.saw('viewer', WHEREVER), WHEREVER, graph.said(manager.process))
            self.assertEqual(graph.serialised(), 0)

    def test_a_standard_image_goes_to_another_process_too(self):
        with Nodelets() as graph:
            manager, other = Manager(graph), Manager(graph, 'other')
            manager.load('StandardCamera', 'camera')
            other.load('OtherViewer')
            manager.load('PlainViewer')
            graph.go()
            self.assertEqual(graph.saw('plainviewer', ALL), ALL, graph.said(manager.process))
            later = graph.saw('otherviewer', WHEREVER)  # the camera does not wait for its link
            self.assertEqual((later['first'] + later['received'], later['wrong']), (COUNT, 0), graph.said(other.process))

    def test_unloading_and_reloading(self):
        """The libraries that are not unloaded go on meanwhile, and who comes back gets what comes then."""
        with Nodelets() as graph:
            manager = Manager(graph)
            viewer = manager.load('Viewer')
            manager.load('OtherViewer')
            camera = manager.load('Camera')
            graph.go()
            self.assertEqual(graph.saw('viewer', ('wrong', 'elsewhere'), 50), {'wrong': 0, 'elsewhere': 0})
            graph.unload(viewer, 'viewer')
            manager.load('Viewer')
            self.assertEqual(graph.saw('otherviewer'), ALL, graph.said(manager.process))
            again = graph.saw('viewer', ALL)
            self.assertGreater(again['first'], 50)
            self.assertEqual({**again, 'first': 0}, {**ALL, 'received': COUNT - again['first']})
            self.assertEqual(graph.serialised(), 0)
            # And the camera: its next messages are the first ones again.
            for what in 'go', 'serialised':
                graph.ask('deleteParam', f'/camera/{what}')
            graph.unload(camera, 'camera')
            manager.load('Camera')
            manager.load('Viewer', 'late')
            graph.go()
            self.assertEqual(graph.saw('late'), ALL, graph.said(manager.process))


class OfTwoCopies(unittest.TestCase):
    def test_what_the_first_copy_needs_is_its_own(self):
        """The one that is off is the first to say what an image is."""
        with Nodelets() as graph:
            manager = Manager(graph)
            for kind in 'PlainViewer', 'TwinViewer', 'Viewer', 'Camera':
                manager.load(kind)
            graph.go()
            for viewer in 'plainviewer', 'twinviewer', 'viewer':
                self.assertEqual(graph.saw(viewer, WHEREVER), WHEREVER, graph.said(manager.process))

    def test_whose_library_has_another_copy(self):
        """Two versions of liblot_ros.so, say: the second one is off, and says what to do."""
        for order in ('Camera', 'TwinViewer'), ('TwinViewer', 'Camera'):
            with self.subTest(order=order), Nodelets() as graph:
                manager = Manager(graph)
                for kind in order:
                    manager.load(kind)
                graph.go()
                self.assertEqual(graph.saw('twinviewer', WHEREVER), WHEREVER, graph.said(manager.process))
                lines = [line for line in graph.said(manager.process).splitlines() if 'another copy' in line]
                self.assertEqual(len(lines), 1, graph.said(manager.process))
                self.assertIn('link all nodes of a process with the same liblot_ros.so', lines[0])


class InTwoManagers(unittest.TestCase):
    def test_viewers_of_two_libraries_and_a_camera_elsewhere(self):
        with Nodelets() as graph:
            viewing, filming = Manager(graph, 'viewing'), Manager(graph, 'filming')
            viewing.load('Viewer')
            filming.load('Camera')
            viewing.load('OtherViewer')
            graph.go()
            for viewer in 'viewer', 'otherviewer':
                self.assertEqual(graph.saw(viewer, WHEREVER), WHEREVER, graph.said(viewing.process))
            self.assertEqual(graph.serialised(), 0)


if __name__ == '__main__':
    unittest.main(verbosity=2)
