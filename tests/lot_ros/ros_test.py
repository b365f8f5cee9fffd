#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""lot::ros against the real thing: rosmaster, roscpp, rospy, rostopic, rosbag."""

import itertools
import json
import os
import pathlib
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import unittest

from graph import NODE, TOOL, Graph

COUNT = 200
RELAY = os.environ.get('LOT_RELAY', 'lot_relay')
HANDLES = os.environ.get('LOT_ROS_HANDLES', 'ros_handles_test')
CHOSEN = os.environ.get('LOT_ROS_CHOSEN', '').split()  # options of doctest: which cases of a node
FILTERS = os.environ.get('LOT_ROS_FILTERS')
CAMERA = os.environ.get('LOT_ROS_CAMERA')
KILLING_S = float(os.environ.get('LOT_ROS_KILLING_S', 20))


def brief(seen):
    return {what: n for what, n in seen.items() if what != 'places'}


class Case(unittest.TestCase):
    def assert_all(self, report, end, publishers, count=COUNT, relayed=False):
        """That end has got every message of each publisher once and in order."""
        seen = report[end]['from']
        self.assertEqual(sorted(seen), sorted(publishers))
        for name in publishers:
            s = seen[name]
            for wrong in ('twice', 'disorder', 'torn', 'gaps', *(() if relayed else ('misnamed',))):
                self.assertEqual(s[wrong], 0, f'{name}: {wrong}: {brief(s)}')
            self.assertEqual(s['last'], count - 1, brief(s))
            self.assertEqual(s['received'], count, brief(s))


class Pairs(Case):
    def test_two_lot_nodes_serialise_nothing(self):
        with Graph() as graph:
            listener = graph.node('listener', f'sub:lot:/t:{COUNT}')
            talker = graph.node('talker', f'pub:lot:/t:{COUNT}:500:100000:wait=1')
            self.assert_all(graph.report(listener), 0, ['/talker'])
            self.assertEqual(graph.report(talker)[0]['serialised'], 0)
            self.assertEqual(graph.files(), [])

    def test_two_lot_nodes_copy_no_payload(self):
        """In several processes: every one reads the bytes where the publisher has written them."""
        with Graph() as graph:
            listeners = [graph.node(f'listener{i}', f'sub:{how}:/t:{COUNT}')
                         for i, how in enumerate(('lot', 'lotptr', 'event'))]
            talker = graph.node('talker', f'pub:lot:/t:{COUNT}:100:200000:wait=3')
            reports = [graph.report(listener) for listener in listeners]
            written = graph.report(talker)[0]
            self.assertEqual(written['serialised'], 0)
            self.assertEqual(len(written['places']), COUNT)
            self.assertNotIn(-1, written['places'])
            for report in reports:
                self.assertEqual(report[0]['from']['/talker']['places'], written['places'])

    def test_every_spinner(self):
        for spinner in 'single', 'multi':
            with self.subTest(spinner), Graph() as graph:
                listener = graph.node('listener', f'sub:lot:/t:{COUNT}', f'sub:event:/t:{COUNT}', '--spin', spinner)
                talker = graph.node('talker', f'pub:lot:/t:{COUNT}:500:10000:wait=1')
                report = graph.report(listener)
                for end in 0, 1:
                    self.assert_all(report, end, ['/talker'])
                self.assertEqual(graph.report(talker)[0]['serialised'], 0)

    def test_every_pair_of_kinds_in_either_order(self):
        for publisher, subscriber, first in itertools.product(
                ('lot', 'std', 'plain'), ('lot', 'lotptr', 'event', 'plain'), ('talker', 'listener')):
            with self.subTest(publisher=publisher, subscriber=subscriber, first=first), Graph() as graph:
                nodes = {}
                for name in (first, 'listener' if first == 'talker' else 'talker'):
                    nodes[name] = graph.node(name, f'sub:{subscriber}:/t:{COUNT}' if name == 'listener' else
                                             f'pub:{publisher}:/t:{COUNT}:500:1000:wait=1')
                    time.sleep(0.3)
                self.assert_all(graph.report(nodes['listener']), 0, ['/talker'])
                report = graph.report(nodes['talker'])[0]
                self.assertEqual(report['serialised'],
                                 0 if subscriber != 'plain' or publisher == 'plain' else COUNT)
                self.assertEqual(graph.files(), [])

    def test_lot_and_plain_subscribers_of_one_publisher(self):
        with Graph() as graph:
            nodes = [graph.node(f's{i}', f'sub:{how}:/t:{COUNT}')
                     for i, how in enumerate(('lot', 'plain', 'lotptr', 'plain'))]
            talker = graph.node('talker', f'pub:lot:/t:{COUNT}:300:5000:wait=4')
            for node in nodes:
                self.assert_all(graph.report(node), 0, ['/talker'])
            self.assertEqual(graph.report(talker)[0]['serialised'], COUNT)

    def test_one_node_is_everything(self):
        with Graph() as graph:
            node = graph.node('self', f'sub:lot:/t:{COUNT}', f'sub:event:/t:{COUNT}',
                              f'pub:lot:/t:{COUNT}:500:1000:wait=1')
            report = graph.report(node)
            for end in (0, 1):
                self.assert_all(report, end, ['/self'])

    def test_lot_and_plain_subscribers_in_one_node(self):
        for ends in itertools.permutations((f'sub:lot:/t:{COUNT}', f'sub:plain:/t:{COUNT}')):
            with self.subTest(ends=ends), Graph() as graph:
                node = graph.node('both', *ends)
                talker = graph.node('talker', f'pub:lot:/t:{COUNT}:300:1000:wait=1')
                report = graph.report(node)
                for end in (0, 1):
                    self.assert_all(report, end, ['/talker'])
                graph.report(talker)

    def test_a_plain_subscriber_comes_late_to_a_lot_one(self):
        # With a message each 333 ms each one is asked about, so none is missed.
        with Graph() as graph:
            node = graph.node('both', 'sub:lot:/t:40', 'sub:plain:/t:1:after=2.5')
            talker = graph.node('talker', 'pub:lot:/t:40:3:1000:wait=1')
            lot, plain = graph.report(node)
            self.assert_all([lot], 0, ['/talker'], 40)
            seen = plain['from']['/talker']
            for wrong in ('twice', 'disorder', 'torn', 'gaps'):
                self.assertEqual(seen[wrong], 0, brief(seen))
            self.assertGreaterEqual(plain['base'], 0)
            self.assertGreaterEqual(seen['first'], plain['base'])
            self.assertEqual(seen['last'], 39)
            # The publisher serialises each message from the moment it knows of the subscriber.
            self.assertEqual(graph.report(talker)[0]['serialised'], seen['received'])

    def test_the_ring_again_when_a_plain_subscriber_has_left(self):
        for ends in itertools.permutations(('sub:lot:/t:1000', 'sub:plain:/t:100:leave')):
            with self.subTest(ends=ends), Graph() as graph:
                node = graph.node('both', *ends)
                talker = graph.node('talker', 'pub:lot:/t:1000:300:20000:wait=1')
                report = {end['how']: end for end in graph.report(node)}
                self.assert_all([report['lot']], 0, ['/talker'], 1000)
                serialised = graph.report(talker)[0]['serialised']
                self.assertGreaterEqual(serialised, 90)
                self.assertLess(serialised, 900)

    def test_a_node_that_was_held_up_reads_the_ring_all_the_same(self):
        with Graph() as graph:
            listener = graph.node('listener', 'sub:lot:/t:1700')
            talker = graph.node('talker', 'pub:lot:/t:1700:100:5000:wait=1')
            graph.wait_for(lambda: graph.published() >= 200, 'messages in the ring')
            listener.send_signal(signal.SIGSTOP)
            time.sleep(7)
            listener.send_signal(signal.SIGCONT)
            self.assert_all(graph.report(listener), 0, ['/talker'], 1700)
            self.assertEqual(graph.report(talker)[0]['serialised'], 0)

    def test_whoever_comes_is_greeted_and_reads_the_ring_then(self):
        """The publisher has connect callbacks: a greeting goes over the link of each one, before all else."""
        with Graph() as graph:
            talker = graph.node('talker', 'pub:lot:/t:1500:300:20000:wait=2:keep:greet')
            listeners = [graph.node(f'listener{i}', f'sub:{how}:/t:1501') for i, how in enumerate(('lot', 'lotptr'))]
            for listener in listeners:
                seen = graph.report(listener)[0]['from']
                greeting = seen.pop('/talker/greeting')
                self.assertEqual([greeting[what] for what in ('received', 'torn')], [1, 0])
                self.assert_all([{'from': seen}], 0, ['/talker'], 1500)
            graph.wait_for(lambda: graph.peers('/t')[1] == [], 'the ends of both')
            time.sleep(0.5)
            report = graph.stop(talker)[0]
            self.assertEqual(report['left'], 2)
            self.assertLess(report['last_serialised'], 1000)

    def test_several_publishers_and_subscribers(self):
        with Graph() as graph:
            talkers = [f'/talker{i}' for i in range(3)]
            listeners = [graph.node(f'listener{i}', f'sub:lot:/t:{3 * COUNT}') for i in range(3)]
            for name in talkers:
                graph.node(name[1:], f'pub:lot:/t:{COUNT}:200:2000:wait=3')
            for listener in listeners:
                self.assert_all(graph.report(listener), 0, talkers)


class Handles(Case):
    def test_handles_in_one_node(self):
        with Graph() as graph:
            node = graph.run([HANDLES, *CHOSEN])
            status = graph.ended(node, 200)
            self.assertEqual(status, 0, graph.output(node) + graph.said(node))
            self.assertEqual(graph.files(), [])


@unittest.skipUnless(FILTERS, 'there is no tf2_ros')
class Filters(Case):
    def test_filters_and_cameras_in_one_node(self):
        with Graph() as graph:
            node = graph.run([FILTERS, *CHOSEN])
            status = graph.ended(node, 200)
            self.assertEqual(status, 0, graph.output(node) + graph.said(node))
            self.assertEqual(graph.files(), [])


class Tools(Case):
    def test_rostopic_and_rosnode_see_what_is(self):
        with Graph() as graph:
            listener = graph.node('listener', 'sub:lot:/t')
            talker = graph.node('talker', 'pub:lot:/t:100000:50:1000:wait=1')
            graph.wait_for(lambda: all(graph.peers('/t')), 'both')
            info = subprocess.run(['rostopic', 'info', '/t'], env=graph.env, capture_output=True,
                                  text=True, timeout=60, check=True).stdout
            self.assertIn('Type: sensor_msgs/Image', info)
            self.assertIn('/talker', info.split('Subscribers:')[0])
            self.assertIn('/listener', info.split('Subscribers:')[1])
            def about():
                return subprocess.run(['rosnode', 'info', '/talker'], env=graph.env, text=True,
                                      capture_output=True, timeout=60, check=True).stdout
            self.assertIn(' * /t [sensor_msgs/Image]', about())
            # The master knows both before they have a connection.
            connection = r'to: /listener\n +\* direction: outbound.*\n +\* transport: TCPROS'
            graph.wait_for(lambda: re.search(connection, about()), 'the connection')
            echo = subprocess.run(['rostopic', 'echo', '-n', '20', '--noarr', '/t'], env=graph.env,
                                  capture_output=True, text=True, timeout=60, check=True).stdout
            self.assertEqual(echo.count('encoding: "/talker"'), 20)
            widths = [int(line.split()[1]) for line in echo.splitlines() if line.startswith('width:')]
            self.assertEqual(widths, list(range(widths[0], widths[0] + 20)))  # each once
            hz = graph.run(['rostopic', 'hz', '-w', '50', '/t'])
            bw = graph.run(['rostopic', 'bw', '/t'])
            graph.wait_for(lambda: 'average rate' in graph.output(hz), 'a rate')
            graph.wait_for(lambda: 'mean: ' in graph.output(bw), 'a bandwidth')
            self.assertRegex(graph.output(bw), 'mean: 1.0[0-9]KB')
            ping = subprocess.run(['rosnode', 'ping', '-c', '1', '/talker'], env=graph.env,
                                  capture_output=True, text=True, timeout=60, check=True).stdout
            self.assertIn('xmlrpc reply', ping)
            graph.stop(talker)
            graph.stop(listener)
            self.assertEqual(graph.files(), [])

    def test_rosnode_cleans_up_after_the_dead(self):
        with Graph() as graph:
            victim = graph.node('victim', 'sub:lot:/t')
            listener = graph.node('listener', 'sub:lot:/t:4000')
            talker = graph.node('talker', 'pub:lot:/t:4000:300:1000:wait=2')
            graph.wait_for(lambda: graph.published() != 0, 'both')
            killed_at = graph.published()
            victim.kill()
            victim.wait()
            cleanup = subprocess.run(['rosnode', 'cleanup'], input='y\n', env=graph.env, capture_output=True,
                                     text=True, timeout=60, check=True).stdout
            self.assertIn('/victim', cleanup)
            self.assertEqual(graph.peers('/t')[1], ['/listener'])
            cleaned_at = graph.published()
            self.assert_all(graph.report(listener), 0, ['/talker'], 4000)
            # The reaper may be quicker than roscpp with the end of the victim's link: what was published
            # meanwhile may be serialised for that, and nothing else.
            report = graph.report(talker)[0]
            if report['serialised'] != 0:
                self.assertGreaterEqual(report['last_serialised'], killed_at)
                self.assertLessEqual(report['last_serialised'], cleaned_at)
                self.assertLessEqual(report['serialised'], cleaned_at - killed_at)
            self.assertEqual(graph.files(), [])

    def test_who_expects_another_type_is_refused_by_ros_and_nobody_else_is(self):
        program = '''
import rospy, std_msgs.msg
rospy.init_node('py', disable_signals=True)
rospy.Subscriber('/t', std_msgs.msg.String, print)
while True: rospy.rostime.wallsleep(1)
'''
        with Graph() as graph:
            graph.run(['/usr/bin/python3', '-c', program])
            graph.wait_for(lambda: graph.peers('/t')[1] == ['/py'], 'the wrong one')
            listener = graph.node('listener', f'sub:lot:/t:{COUNT}')
            talker = graph.node('talker', f'pub:lot:/t:{COUNT}:200:1000:wait=1')
            self.assert_all(graph.report(listener), 0, ['/talker'])
            self.assertEqual(graph.report(talker)[0]['serialised'], 0)
            self.assertIn('datatype/md5sum', graph.said(talker))

    def test_two_types_of_one_name_do_not_mix(self):
        with Graph() as graph:
            relay = graph.run([RELAY, '/words', '/t', '__name:=relay'])
            words = graph.run(['rostopic', 'pub', '-r', '20', '/words', 'std_msgs/String', 'data: hello'])
            graph.wait_for(lambda: graph.peers('/t')[0] == ['/relay'], 'strings by LOT')
            listener = graph.node('listener', f'sub:lot:/t:{COUNT}')
            talker = graph.node('talker', f'pub:lot:/t:{COUNT}:200:1000:wait=1')
            self.assert_all(graph.report(listener), 0, ['/talker'])
            graph.report(talker)
            self.assertIn('datatype/md5sum', graph.said(relay))
            self.assertRegex(graph.said(listener), 'LOT: /t comes over TCPROS: .*std_msgs/String')
            self.assertRegex(graph.said(talker), 'LOT: /t goes over TCPROS: .*std_msgs/String')
            for process in words, relay:
                process.send_signal(signal.SIGINT)
                process.wait(20)
            self.assertEqual(graph.files(), [])

    def test_a_bag_is_an_ordinary_bag(self):
        import rosbag
        with Graph() as graph:
            path = graph.home / 'x.bag'
            record = graph.run(['rosbag', 'record', '-O', str(path), '/t'])
            listener = graph.node('listener', f'sub:lot:/t:{COUNT}')
            talker = graph.node('talker', f'pub:lot:/t:{COUNT}:200:3000:wait=2')
            self.assert_all(graph.report(listener), 0, ['/talker'])
            graph.report(talker)
            graph.stop_recording(record, path)
            with rosbag.Bag(str(path)) as bag:
                messages = [m for _, m, _ in bag.read_messages(topics=['/t'])]
            self.assertEqual([m.width for m in messages], list(range(COUNT)))
            for m in messages:
                self.assertEqual(len(m.data), 3000)
                self.assertEqual(list(m.data[::61]), [(m.width + i) % 256 for i in range(0, 3000, 61)])

    def test_a_bag_is_played_to_lot(self):
        with Graph() as graph:
            path = graph.home / 'x.bag'
            record = graph.run(['rosbag', 'record', '-O', str(path), '/t'])
            talker = graph.node('talker', f'pub:plain:/t:{COUNT}:200:3000:wait=1')
            graph.report(talker)
            graph.stop_recording(record, path)
            listener = graph.node('listener', f'sub:lot:/t:{COUNT}')
            graph.wait_for(lambda: graph.peers('/t')[1], 'the listener')
            play = graph.run(['rosbag', 'play', '-d', '4', '-r', '2', '--queue=1000', '--keep-alive', str(path)])
            self.assert_all(graph.report(listener), 0, ['/talker'])
            play.send_signal(signal.SIGINT)
            play.wait(60)

    def test_rospy_reads_lot(self):
        program = '''
import rospy, sensor_msgs.msg, sys
seen = []
rospy.init_node('py', disable_signals=True)
rospy.Subscriber('/t', sensor_msgs.msg.Image, lambda m: seen.append(m.width), queue_size=1000)
end = __import__('time').time() + 50
while len(seen) < int(sys.argv[1]) and __import__('time').time() < end:
    rospy.rostime.wallsleep(0.01)
print(seen == list(range(int(sys.argv[1]))))
'''
        with Graph() as graph:
            py = graph.run(['/usr/bin/python3', '-c', program, str(COUNT)])
            listener = graph.node('listener', f'sub:lot:/t:{COUNT}')
            talker = graph.node('talker', f'pub:lot:/t:{COUNT}:200:3000:wait=2')
            self.assert_all(graph.report(listener), 0, ['/talker'])
            graph.report(talker)
            self.assertEqual(py.wait(60), 0)
            self.assertEqual(graph.output(py).strip(), 'True')


    def test_lot_reads_rospy(self):
        program = '''
import rospy, sensor_msgs.msg, sys
rospy.init_node('py', disable_signals=True)
talker = rospy.Publisher('/t', sensor_msgs.msg.Image, queue_size=1000)
while talker.get_num_connections() != 2:
    rospy.rostime.wallsleep(0.01)
for n in range(int(sys.argv[1])):
    message = sensor_msgs.msg.Image(width=n, encoding='/py')
    message.data = bytes((n + i) % 256 if i % 61 == 0 else 0 for i in range(500))
    talker.publish(message)
    rospy.rostime.wallsleep(0.005)
rospy.rostime.wallsleep(1)
'''
        with Graph() as graph:
            nodes = [graph.node(f'listener{i}', f'sub:lot:/t:{COUNT}') for i in range(2)]
            py = graph.run(['/usr/bin/python3', '-c', program, str(COUNT)])
            for node in nodes:
                self.assert_all(graph.report(node), 0, ['/py'])
            self.assertEqual(py.wait(60), 0)


class Relay(Case):
    def test_a_bag_is_played_through_the_relay(self):
        """Every queue on the way is deeper than the bag, and the player stays until all is read: else who stands
        still for half a second, as on a busy machine, loses messages. Here two of them do stand still."""
        with Graph() as graph:
            path = graph.home / 'x.bag'
            record = graph.run(['rosbag', 'record', '-O', str(path), '/t'])
            graph.report(graph.node('talker', f'pub:plain:/t:{COUNT}:200:300000:wait=1'))
            graph.stop_recording(record, path)
            relay = graph.run([RELAY, '/t', '/shared', '__name:=relay', '_queue_size:=1000'])
            listeners = [graph.node(f'listener{i}', f'sub:lot:/shared:{COUNT}') for i in range(2)]
            plain = graph.node('plain', f'sub:plain:/shared:{COUNT}')
            graph.wait_for(lambda: len(graph.peers('/shared')[1]) == 3, 'the listeners')
            play = graph.run(['rosbag', 'play', '-d', '6', '--queue=1000', '--keep-alive', str(path)])
            graph.wait_for(lambda: graph.peers('/shared')[0], 'the relay')
            graph.wait_for(lambda: graph.published() > 20, 'the first messages')
            for slow in (relay, listeners[0]):
                slow.send_signal(signal.SIGSTOP)
            for slow in (relay, listeners[0]):
                time.sleep(0.8)
                slow.send_signal(signal.SIGCONT)
            for listener in (*listeners, plain):
                self.assert_all(graph.report(listener), 0, ['/talker'], relayed=True)
            play.send_signal(signal.SIGINT)
            play.wait(60)
            relay.send_signal(signal.SIGINT)
            self.assertEqual(relay.wait(20), 0, graph.said(relay))
            self.assertEqual(graph.files(), [])

    def test_what_lot_publishes_is_relayed_without_a_copy(self):
        with Graph() as graph:
            opener = graph.node('opener', 'pub:lot:/t:0:1:1:keep')  # so that the topic has a type
            relay = graph.run([RELAY, '/t', '/shared', '__name:=relay'])
            graph.wait_for(lambda: graph.peers('/shared')[0], 'the relay')
            listener = graph.node('listener', f'sub:lot:/shared:{COUNT}')
            plain = graph.node('plain', f'sub:plain:/shared:{COUNT}')
            graph.wait_for(lambda: len(graph.peers('/shared')[1]) == 2, 'the listeners')
            time.sleep(2)  # their links
            talker = graph.node('talker', f'pub:lot:/t:{COUNT}:100:100000:wait=1')
            seen = graph.report(listener)
            self.assert_all(seen, 0, ['/talker'], relayed=True)
            self.assert_all(graph.report(plain), 0, ['/talker'], relayed=True)
            written = graph.report(talker)[0]
            self.assertEqual(written['serialised'], 0)
            self.assertEqual(seen[0]['from']['/talker']['places'], written['places'])
            graph.stop(opener)
            relay.send_signal(signal.SIGTERM)
            self.assertEqual(relay.wait(20), 0, graph.said(relay))
            self.assertEqual(graph.files(), [])

    def test_it_ends_when_it_is_told_to_while_it_waits_for_a_publisher(self):
        for signal_ in (signal.SIGTERM, signal.SIGINT):
            with self.subTest(signal_), Graph() as graph:
                relay = graph.run([RELAY, '/t', '/shared', '__name:=relay'])
                graph.wait_for(lambda: graph.ask('lookupNode', '/relay'), 'the relay')
                relay.send_signal(signal_)
                self.assertEqual(relay.wait(20), 0, graph.said(relay))

    def test_what_lot_latches_is_latched_again(self):
        for order in ('talker', 'relay'), ('relay', 'talker'):
            with self.subTest(order=order), Graph() as graph:
                opener = graph.node('opener', 'pub:plain:/t:100000:20:1000')  # which does not latch
                for name in order:
                    if name == 'relay':
                        relay = graph.run([RELAY, '/t', '/shared', '__name:=relay'])
                        graph.wait_for(lambda: '/relay' in graph.peers('/t')[1], 'the relay')
                        time.sleep(0.5)  # until roscpp has the master's answer
                    else:
                        talker = graph.node('talker', 'pub:lot:/t:1:100:1000:latch:keep')
                graph.wait_for(lambda: graph.peers('/shared')[0], 'the relay')
                for _ in range(3):
                    for how in 'lot', 'plain':
                        late = graph.report(graph.node('late', f'sub:{how}:/shared:3'))[0]
                        self.assertEqual(late['from']['/talker']['received'], 1, late)
                for node in talker, opener:
                    graph.stop(node)
                relay.send_signal(signal.SIGINT)
                self.assertEqual(relay.wait(20), 0, graph.said(relay))

    def test_maps_frames_and_markers_which_latch(self):
        """Messages of other packages, nested ones: who comes late sees on OUT what is on IN."""
        messages = {
            'tf2_msgs/TFMessage': """{transforms: [{header: {frame_id: map}, child_frame_id: base,
                transform: {translation: {x: 1.5}, rotation: {w: 1}}}, {child_frame_id: arm}]}""",
            'nav_msgs/OccupancyGrid': """{header: {frame_id: map}, info: {resolution: 0.05, width: 3,
                height: 2, origin: {orientation: {w: 1}}}, data: [0, 100, -1, 7, 8, 9]}""",
            'visualization_msgs/MarkerArray': """{markers: [{ns: lanes, id: 3, text: a lane,
                points: [{x: 1}, {y: 2}], colors: [{r: 1, a: 1}, {g: 1, a: 1}]}, {id: 4}]}""",
        }
        with Graph() as graph:
            for i, (kind, message) in enumerate(messages.items()):
                graph.run(['rostopic', 'pub', f'/in{i}', kind, message])
                graph.run([RELAY, f'/in{i}', f'/out{i}'])
            for i, kind in enumerate(messages):
                with self.subTest(kind):
                    graph.wait_for(lambda i=i: graph.peers(f'/out{i}')[0], 'the relay')
                    seen = {}
                    for topic in f'/in{i}', f'/out{i}':
                        echo = subprocess.run(['rostopic', 'echo', '-n', '1', topic], env=graph.env, text=True,
                                              capture_output=True, timeout=60, check=True).stdout
                        # rospy numbers a latched message for each link anew.
                        seen[topic] = [line for line in echo.splitlines() if 'seq:' not in line]
                    self.assertEqual(*seen.values())
                    self.assertGreater(len(seen[f'/in{i}']), 10)

    def test_a_type_that_it_does_not_know(self):
        with Graph() as graph:
            relay = graph.run([RELAY, '/rosout', '/shared'])
            self.assertEqual(relay.wait(20), 1)
            self.assertIn('rosgraph_msgs/Log, which this relay does not know', graph.said(relay))
            itself = graph.run([RELAY, '/t', 't'])
            self.assertEqual(itself.wait(20), 2)
            self.assertIn('/t cannot be relayed to itself', graph.said(itself))


@unittest.skipUnless(CAMERA, 'the examples are not built')
class Launch(Case):
    def test_the_example_is_launched(self):
        with Graph() as graph:
            package = graph.home / 'lot'
            package.mkdir()
            source = pathlib.Path(__file__).resolve().parents[2]
            for name in ('package.xml', 'examples/ros/launch/camera.launch'):
                shutil.copy(source / name, package)
            (package / 'ros_camera').symlink_to(CAMERA)
            launch = graph.run(['roslaunch', str(package / 'camera.launch')], ROS_PACKAGE_PATH=str(graph.home))
            graph.wait_for(lambda: graph.output(launch).count('16777216 bytes') > 20, 'images')
            launch.send_signal(signal.SIGINT)
            launch.wait(60)
            self.assertEqual(graph.files(), [])


@unittest.skipUnless(os.geteuid() == 0, 'containers with networks of their own need root')
class Containers(Case):
    """Two containers with PIDs, IPC, host names, mounts and networks of their own."""

    @classmethod
    def setUpClass(cls):
        """Makes their networks, and tries to make a container in one of them."""
        cls.addresses = [f'10.{os.getpid() % 199 + 1}.{os.getpid() // 199 % 250}.{i}' for i in (1, 2)]
        try:
            cls.connect()
            run(*cls.inside(0, '/tmp'), 'true')
        except subprocess.CalledProcessError as refusal:
            print(refusal)
            raise unittest.SkipTest('no containers here') from refusal

    @classmethod
    def connect(cls):
        # Each network lives as long as a process in it, which dies with this one.
        cls.networks = [subprocess.Popen(['setpriv', '--pdeathsig', 'KILL', 'unshare', '--net', 'sleep', 'infinity'])
                        for _ in 'ab']
        for network in cls.networks:
            cls.addClassCleanup(network.wait)
            cls.addClassCleanup(network.kill)
        own = os.readlink('/proc/self/ns/net')
        while any(cls.network_of(n) in (own, None) for n in cls.networks):
            for n in cls.networks:
                if n.poll() is not None:
                    raise subprocess.CalledProcessError(n.returncode, n.args)
            time.sleep(0.01)
        a, b = (str(n.pid) for n in cls.networks)
        run('ip', 'link', 'add', 'lot', 'netns', a, 'type', 'veth', 'peer', 'name', 'lot', 'netns', b)
        for side, address in enumerate(cls.addresses):
            run(*cls.in_network(side), 'ip', 'address', 'add', f'{address}/24', 'dev', 'lot')
            run(*cls.in_network(side), 'ip', 'link', 'set', 'lot', 'up')
            run(*cls.in_network(side), 'ip', 'link', 'set', 'lo', 'up')

    @staticmethod
    def network_of(process):
        try:
            is_there = b'sleep' in pathlib.Path(f'/proc/{process.pid}/cmdline').read_bytes().split(b'\0')[0]
            return os.readlink(f'/proc/{process.pid}/ns/net') if is_there else None
        except OSError:
            return None

    @classmethod
    def in_network(cls, side):
        return ['nsenter', f'--net=/proc/{cls.networks[side].pid}/ns/net']

    @staticmethod
    def innermost(pid):
        """What runs in a container in the end: bwrap hands no signal on to it."""
        while children := pathlib.Path(f'/proc/{pid}/task/{pid}/children').read_text().split():
            pid = int(children[0])
        return pid

    @classmethod
    def inside(cls, side, shared):
        """What a command in that container begins with."""
        return [*cls.in_network(side), 'bwrap', '--dev-bind', '/', '/', '--tmpfs', '/dev/shm',
                '--bind', str(shared), '/mnt', '--unshare-pid', '--unshare-ipc', '--unshare-uts',
                '--die-with-parent', '--proc', '/proc', '--hostname', f'robot-{side}',
                '--setenv', 'ROS_IP', cls.addresses[side], '--setenv', 'LOT_DIR', '/mnt']

    def talk(self, other):
        with tempfile.TemporaryDirectory(dir='/dev/shm', prefix='lot_ros_shared_') as shared, \
                Graph(shm=shared, inside=self.inside(0, shared), host=self.addresses[0]) as graph:
            other = graph.home / 'elsewhere' if other else shared
            os.makedirs(other, exist_ok=True)
            places = [shared, other]
            listeners = [graph.start([*self.inside(i, place), NODE, f'sub:lot:/t:{2 * COUNT}', f'__name:=listener{i}'])
                         for i, place in enumerate(places)]
            talkers = [graph.start([*self.inside(i, place), NODE, f'pub:lot:/t:{COUNT}:300:100000:wait=2',
                                    f'__name:=talker{i}']) for i, place in enumerate(places)]
            for listener in listeners:
                self.assert_all(graph.report(listener), 0, ['/talker0', '/talker1'])
            serialised = [graph.report(talker)[0]['serialised'] for talker in talkers]
            self.assertEqual(graph.files(), [])
            return serialised

    def test_they_share_the_segments_directory(self):
        self.assertEqual(self.talk(other=False), [0, 0])

    def test_who_has_another_directory_gets_all_over_tcpros(self):
        self.assertEqual(self.talk(other=True), [COUNT, COUNT])

    def test_a_container_dies_and_comes_again(self):
        with tempfile.TemporaryDirectory(dir='/dev/shm', prefix='lot_ros_shared_') as shared, \
                Graph(shm=shared, inside=self.inside(0, shared), host=self.addresses[0]) as graph:
            near = graph.start([*self.inside(0, shared), NODE, 'sub:lot:/t', '__name:=near'])
            talker = graph.start([*self.inside(0, shared), NODE, 'pub:lot:/t:100000:200:20000:wait=1',
                                  '__name:=talker'])
            for stay, lives_s in (2, 1), (2, 1), (1, 4):
                victim = graph.start([*self.inside(1, shared), NODE, 'sub:lot:/t', 'pub:lot:/u:100000:100:20000',
                                      '__name:=victim'])
                graph.wait_for(lambda: len(graph.look()['processes']) == 3, 'its place in the segment')
                time.sleep(lives_s)
                if stay == 1:  # before the last death: what goes to who has just died may be serialised
                    os.kill(self.innermost(talker.pid), signal.SIGINT)
                    sent = graph.report(talker)[0]
                victim.kill()
                victim.wait()
                graph.wait_for(lambda: len(graph.look()['processes']) == stay, 'its end')
            os.kill(self.innermost(near.pid), signal.SIGINT)
            seen = graph.report(near)[0]['from']['/talker']
            for wrong in ('twice', 'disorder', 'torn', 'gaps', 'misnamed'):
                self.assertEqual(seen[wrong], 0, brief(seen))
            self.assertGreater(sent['sent'], 600)
            # On a busy machine its link may bring the first ones; two seconds later nothing has for long.
            self.assertLess(sent['serialised'], sent['sent'] / 3)
            self.assertGreater(sent['sent'] - sent['last_serialised'], 2 * 200)
            self.assertEqual(graph.files(), [])


class Deaths(Case):
    def test_a_listener_is_killed_and_comes_again_under_its_name(self):
        with Graph() as graph:
            stays = graph.node('stays', 'sub:lot:/t:6000')
            talker = graph.node('talker', 'pub:lot:/t:6000:300:1000:wait=2')
            for _ in range(4):
                victim = graph.node('victim', 'sub:lot:/t')
                time.sleep(1.5)
                victim.kill()
                victim.wait()
            again = graph.node('victim', 'sub:lot:/t')
            self.assert_all(graph.report(stays), 0, ['/talker'], 6000)
            graph.report(talker)
            last = graph.stop(again)[0]['from']['/talker']
            for wrong in ('twice', 'disorder', 'torn', 'gaps'):
                self.assertEqual(last[wrong], 0, last)
            self.assertEqual(last['last'], 5999)
            self.assertEqual(graph.files(), [])

    def test_a_talker_is_killed_and_comes_again_under_its_name(self):
        with Graph() as graph:
            listener = graph.node('listener', 'sub:lot:/t')
            for _ in range(4):
                talker = graph.node('talker', 'pub:lot:/t:100000:300:1000:wait=1')
                time.sleep(1.5)
                talker.kill()
                talker.wait()
            talker = graph.node('talker', f'pub:lot:/t:{COUNT}:300:1000:wait=1')
            graph.report(talker)
            seen = graph.stop(listener)[0]['from']['/talker']
            self.assertEqual((seen['twice'], seen['torn'], seen['gaps']), (0, 0, 0), seen)
            self.assertEqual(seen['disorder'], 4, 'each life begins at 0 again')
            self.assertEqual(seen['last'], COUNT - 1)
            self.assertEqual(graph.files(), [])

    def test_random_kills_leak_nothing(self):
        """Any of them at any time, under their names again: those that stay miss nothing of each other,
        and nothing of the dead is left."""
        choice = random.Random(int(os.environ.get('LOT_ROS_SEED', os.getpid())))
        victims = {
            'talker': ['pub:lot:/t:1000000:200:20000:queue=16', 'pub:std:/u:1000000:50:20000:queue=16'],
            'listener': ['sub:lot:/t:0:queue=16', 'sub:lotptr:/u:0:queue=16'],
            'both': ['sub:event:/t:0:queue=16', 'sub:plain:/u:0:queue=16', 'pub:lot:/t:1000000:100:20000:queue=16'],
            'plain': ['sub:plain:/t:0:queue=16', 'pub:plain:/u:1000000:50:20000:queue=16'],
            'latching': ['pub:lot:/u:1000000:5:20000:queue=16:latch'],
        }

        def of_the_dead():
            who = json.loads(subprocess.run([TOOL, '--json', '-s', graph.segment, 'who', '--all'], env=graph.env,
                                            text=True, capture_output=True, timeout=60, check=False).stdout)
            living = [p['index'] for p in graph.look()['processes']]
            return [m for m in who['segments'][0]['messages'] if m['made_by'] not in living]

        with Graph() as graph:
            stays = graph.node('stays', 'sub:lot:/t:0:queue=1000', 'sub:lot:/u:0:queue=1000', '--for', '10000')
            speaks = graph.node('speaks', 'pub:lot:/t:1000000:100:20000:wait=1', '--for', '10000')
            time.sleep(2)
            alive, kills = {}, 0
            until = time.monotonic() + KILLING_S
            while time.monotonic() < until:
                name = choice.choice(list(victims))
                if name in alive:
                    alive[name].kill()
                    alive.pop(name).wait()
                    kills += 1
                if choice.random() < 0.8:
                    # It may be killed while it starts.
                    alive[name] = graph.run([NODE, *victims[name], '--for', '10000', f'__name:={name}'])
                time.sleep(choice.uniform(0, 0.4))
            for process in alive.values():
                process.kill()
                process.wait()
            self.assertGreater(kills, KILLING_S / 4)
            graph.wait_for(lambda: len(graph.look()['processes']) == 2, 'the end of the dead')
            # Until then ROS, too, keeps what those have latched whom the master still knows.
            subprocess.run(['rosnode', 'cleanup'], input='y\n', env=graph.env, stdout=subprocess.DEVNULL,
                           stderr=subprocess.DEVNULL, text=True, timeout=60, check=True)
            graph.wait_for(lambda: not of_the_dead(), 'their memory')
            # A ring's messages, and what those that live have at hand.
            self.assertLess(graph.look()['blocks']['used'], 1200)
            self.assertEqual(graph.stop(speaks)[0]['end'], 'pub')
            report = graph.stop(stays)
            seen = report[0]['from']['/speaks']
            for wrong in ('twice', 'disorder', 'torn', 'gaps', 'misnamed'):
                self.assertEqual(seen[wrong], 0, brief(seen))
            for end in report:
                for publisher, seen in end['from'].items():
                    self.assertEqual((seen['torn'], seen['misnamed']), (0, 0), publisher)
            self.assertEqual(graph.files(), [])

    def test_a_graph_that_is_interrupted_in_any_order_leaves_nothing(self):
        for order in itertools.permutations(range(3)):
            with self.subTest(order=order), Graph() as graph:
                nodes = [graph.node('listener', 'sub:lot:/t'),
                         graph.node('talker', 'pub:lot:/t:100000:100:1000:wait=2'),
                         graph.node('both', 'sub:lot:/t', 'pub:lot:/u:100000:100:1000')]
                graph.wait_for(lambda: len(graph.peers('/t')[1]) == 2 and graph.peers('/u')[0], 'all')
                time.sleep(0.3)
                for i in order:
                    nodes[i].send_signal(signal.SIGINT)
                    time.sleep(random.choice((0, 0.05, 0.5)))
                for node in nodes:
                    graph.report(node)
                self.assertEqual(graph.files(), [])
                for topic in '/t', '/u':
                    self.assertEqual(graph.peers(topic), ([], []))


class Latching(Case):
    def test_who_comes_late_gets_the_last_one(self):
        for how in ('lot', 'lotptr', 'plain'):
            with self.subTest(how=how), Graph() as graph:
                talker = graph.node('talker', 'pub:lot:/t:5:100:1000:latch:keep')
                time.sleep(1)
                report = graph.report(graph.node('late', f'sub:{how}:/t:1'))
                seen = report[0]['from']['/talker']
                self.assertEqual((seen['received'], seen['last']), (1, 4))
                again = graph.report(graph.node('later', f'sub:{how}:/t:1', f'sub:{how}:/t:1'))
                for end in again:
                    self.assertEqual(end['from']['/talker']['received'], 1)
                sent = graph.stop(talker)[0]
                if how != 'plain':
                    self.assertEqual(sent['serialised'], 0)


    def test_a_plain_subscriber_comes_late_beside_a_lot_one(self):
        with Graph() as graph:
            both = graph.node('both', 'sub:lot:/t:5', 'sub:plain:/t:1:after=2.5:quietly')
            talker = graph.node('talker', 'pub:lot:/t:5:100:1000:latch:keep:wait=1')
            lot, plain = (end['from']['/talker'] for end in graph.report(both))
            self.assertEqual((lot['received'], lot['last'], lot['twice']), (5, 4, 0))
            self.assertEqual((plain['received'], plain['last']), (1, 4))
            graph.stop(talker)


class Observers(Case):
    """An observer of a topic in the segment, as tools are, is no subscriber that ROS or a publisher knows."""

    def assert_seen(self, report, end, count=COUNT):
        """The observer has got every message of /talker once and in order."""
        self.assertEqual((report[end]['error'], report[end]['missed']), ('', 0))
        self.assert_all(report, end, ['/talker'], count)

    def test_it_sees_each_message_once_where_it_lies_and_costs_none_a_copy(self):
        for how in 'any', 'typed':
            with self.subTest(how), Graph() as graph:
                talker = graph.node('talker', f'pub:lot:/t:{COUNT}:100:100000:wait=1')
                observer = graph.node('observer', f'look:{how}:{graph.ring("/t")}:{COUNT}')
                time.sleep(0.5)
                self.assertEqual(graph.published(), 0)  # an observer is not the subscriber that is waited for
                listener = graph.node('listener', f'sub:lot:/t:{COUNT}')
                seen = graph.report(observer)
                self.assert_seen(seen, 0)
                heard = graph.report(listener)
                self.assert_all(heard, 0, ['/talker'])
                written = graph.report(talker)[0]
                self.assertEqual(written['serialised'], 0)
                self.assertEqual(seen[0]['from']['/talker']['places'], written['places'])
                self.assertEqual(heard[0]['from']['/talker']['places'], written['places'])
                self.assertEqual(graph.files(), [])

    def test_it_may_be_in_the_process_of_a_subscriber_or_of_the_publisher(self):
        with Graph() as graph:
            opener = graph.node('opener', 'pub:lot:/t:0:1:1:keep')  # so that the topic has a name in the segment
            name = graph.ring('/t')
            before = graph.node('before', f'look:any:{name}:{COUNT}', f'sub:lot:/t:{COUNT}')
            behind = graph.node('behind', f'sub:lot:/t:{COUNT}', f'look:any:{name}:{COUNT}')
            # One observer has the name of a reader.
            twin = graph.node('twin', f'look:any:{name}:0:as=/behind')
            talker = graph.node('talker', f'look:any:{name}:{COUNT}', f'pub:lot:/t:{COUNT}:100:1000:wait=2')
            for node in before, behind:
                report = graph.report(node)
                self.assert_all(report, 0, ['/talker'])
                self.assert_all(report, 1, ['/talker'])
            look, written = graph.report(talker)
            self.assert_seen([look], 0)
            self.assertEqual(written['serialised'], 0)
            self.assert_seen(graph.stop(twin), 0)
            graph.stop(opener)

    def test_it_sees_each_message_once_beside_plain_subscribers(self):
        with Graph() as graph:
            talker = graph.node('talker', f'pub:lot:/t:{COUNT}:100:1000:wait=3')
            observer = graph.node('observer', f'look:any:{graph.ring("/t")}:{COUNT}')
            nodes = [graph.node(f's{i}', f'sub:{how}:/t:{COUNT}') for i, how in enumerate(('plain', 'lot', 'plain'))]
            for node in nodes:
                self.assert_all(graph.report(node), 0, ['/talker'])
            self.assert_seen(graph.report(observer), 0)
            self.assertEqual(graph.report(talker)[0]['serialised'], COUNT)

    def test_what_no_lot_subscriber_reads_it_does_not_see(self):
        """What goes over TCPROS alone, or to subscribers of the publisher's own process."""
        for how in 'plain', 'lot':
            with self.subTest(how), Graph() as graph:
                opener = graph.node('opener', 'pub:lot:/t:0:1:1:keep')
                name = graph.ring('/t')
                observer = graph.node('observer', f'look:any:{name}')
                ends = (f'pub:lot:/t:{COUNT}:200:1000:wait=1', f'sub:{how}:/t:{COUNT}')
                if how == 'plain':
                    listener = graph.node('listener', ends[1])
                    talker = graph.node('talker', ends[0])
                    self.assert_all(graph.report(listener), 0, ['/talker'])
                    self.assertEqual(graph.report(talker)[0]['serialised'], COUNT)
                else:
                    report = graph.report(graph.node('talker', *ends))
                    self.assert_all(report, 1, ['/talker'])
                    self.assertEqual(report[0]['serialised'], 0)
                self.assertEqual(graph.published(), 0)
                seen = graph.stop(observer)[0]
                self.assertEqual((seen['seen'], seen['missed'], seen['error']), (0, 0, ''))
                graph.stop(opener)

    def test_it_sees_what_the_ring_carries_and_none_twice_while_links_carry_some(self):
        with Graph() as graph:
            talker = graph.node('talker', 'pub:lot:/t:1000:300:20000:wait=1')
            observer = graph.node('observer', f'look:any:{graph.ring("/t")}')
            # The talker begins when it has one of them, which is the first.
            node = graph.node('both', 'sub:lot:/t:1000', 'sub:plain:/t:100:leave')
            self.assert_all(graph.report(node)[:1], 0, ['/talker'], 1000)
            serialised = graph.report(talker)[0]['serialised']
            report = graph.stop(observer)[0]
            seen = report['from']['/talker']
            for wrong in 'twice', 'disorder', 'torn':
                self.assertEqual(seen[wrong], 0, brief(seen))
            self.assertEqual((report['missed'], report['error']), (0, ''))
            self.assertEqual(seen['last'], 999)
            self.assertGreaterEqual(seen['received'], 1000 - serialised)
            self.assertLess(seen['received'], 950)

    def test_one_that_stands_still_or_dies_holds_none_up(self):
        with Graph() as graph:
            talker = graph.node('talker', 'pub:lot:/t:1000:300:10000:wait=2:queue=100')
            name = graph.ring('/t')
            observers = [graph.node(f'observer{i}', f'look:any:{name}') for i in range(3)]
            listeners = [graph.node(f'listener{i}', 'sub:lot:/t:1000') for i in range(2)]
            graph.wait_for(lambda: graph.published() > 100, 'messages in the ring')
            observers[0].send_signal(signal.SIGSTOP)
            observers[1].kill()
            for listener in listeners:
                self.assert_all(graph.report(listener), 0, ['/talker'], 1000)
            self.assertEqual(graph.report(talker)[0]['serialised'], 0)
            observers[0].send_signal(signal.SIGCONT)
            graph.wait_for(lambda: len(graph.look()['processes']) == 2, 'the end of the others')
            time.sleep(0.5)  # it reads what the ring still has
            slow = graph.stop(observers[0])[0]
            seen = slow['from']['/talker']
            for wrong in 'twice', 'disorder', 'torn':
                self.assertEqual(seen[wrong], 0, brief(seen))
            self.assertEqual((seen['last'], slow['missed']), (999, seen['gaps']))
            self.assertGreater(slow['missed'], 500)
            self.assert_seen([graph.stop(observers[2])[0]], 0, 1000)
            self.assertEqual(graph.files(), [])

    def test_it_gets_what_is_latched_though_there_is_no_subscriber(self):
        with Graph() as graph:
            talker = graph.node('talker', 'pub:lot:/t:5:100:1000:latch:keep')
            name = graph.ring('/t')
            graph.wait_for(lambda: graph.published() == 5, 'all messages')
            seen = graph.report(graph.node('observer', f'look:any:{name}:1:history=1'))[0]['from']['/talker']
            self.assertEqual((seen['received'], seen['last'], seen['torn']), (1, 4, 0))
            late = graph.report(graph.node('late', 'sub:lot:/t:1'))[0]['from']['/talker']
            self.assertEqual((late['received'], late['last']), (1, 4))
            self.assertEqual(graph.stop(talker)[0]['serialised'], 0)

    def test_it_reads_the_fields_of_messages_of_other_packages(self):
        messages = {
            'std_msgs/String': ('{data: hello}', '{data: "hello"}'),
            'std_msgs/Float64': ('{data: -2.5}', '{data: -2.5}'),
            'sensor_msgs/Image': (
                '{header: {stamp: {secs: 7, nsecs: 9}, frame_id: map}, height: 2, width: 3, encoding: mono8, step: 3, '
                'data: [1, 2, 3, 4, 5, 6]}',
                '{header: {seq: 1, stamp: {sec: 7, nsec: 9}, frame_id: "map"}, height: 2, width: 3, '
                'encoding: "mono8", is_bigendian: 0, step: 3, data: [1, 2, 3, 4, 5, 6]}'),
            'tf2_msgs/TFMessage': (
                '{transforms: [{header: {frame_id: map}, child_frame_id: base, '
                'transform: {translation: {x: 1.5}, rotation: {w: 1}}}]}',
                '{transforms: [{header: {seq: 0, stamp: {sec: 0, nsec: 0}, frame_id: "map"}, child_frame_id: "base", '
                'transform: {translation: {x: 1.5, y: 0, z: 0}, rotation: {x: 0, y: 0, z: 0, w: 1}}}]}'),
        }
        with Graph() as graph:
            for i, (kind, (message, _)) in enumerate(messages.items()):
                graph.run(['rostopic', 'pub', f'/in{i}', kind, message])  # it latches, and so does the relay
                graph.run([RELAY, f'/in{i}', f'/out{i}'])
            for i, (kind, (_, text)) in enumerate(messages.items()):
                with self.subTest(kind):
                    name = graph.ring(f'/out{i}')
                    report = graph.report(graph.node('observer', f'look:any:{name}:1:history=1'))[0]
                    self.assertEqual((report['type'], report['last'], report['error']), (kind, text, ''))


class Recordings(Case):
    """lot record beside nodes, and lot play for a program that has the type."""

    @staticmethod
    def record(graph, path):
        recorder = graph.run([TOOL, 'record', '/t', '-o', str(path)])
        graph.wait_for(lambda: 'writes' in graph.said(recorder), 'the file')
        return recorder

    def end(self, graph, recorder):
        recorder.send_signal(signal.SIGINT)
        self.assertEqual(recorder.wait(60), 0, graph.output(recorder) + graph.said(recorder))

    def info(self, graph, path):
        told = subprocess.run([TOOL, 'info', '--json', str(path)], env=graph.env, text=True, capture_output=True,
                              timeout=60, check=True).stdout
        (topic,) = json.loads(told)['files'][0]['topics']
        return {key: topic[key] for key in ('name', 'type', 'messages', 'missed', 'objection')}

    def test_images_are_recorded_as_ros_calls_them_and_played_to_another_program(self):
        with Graph() as graph:
            path, again = (graph.home / name for name in ('x.mcap', 'again.mcap'))
            listener = graph.node('listener', f'sub:lot:/t:{COUNT}')
            recorder = self.record(graph, path)
            talker = graph.node('talker', f'pub:lot:/t:{COUNT}:100:100000:wait=1')
            self.assert_all(graph.report(listener), 0, ['/talker'])
            self.assertEqual(graph.report(talker)[0]['serialised'], 0)  # nor for the recorder
            self.end(graph, recorder)
            expected = {'name': '/t', 'type': 'sensor_msgs/msg/Image', 'messages': COUNT, 'missed': 0, 'objection': ''}
            self.assertEqual(self.info(graph, path), expected)
            text = path.read_bytes()
            for line in (b'\nuint32 height\n', b'\nuint8[] data\n', b'\nMSG: std_msgs/Header\n'):
                self.assertIn(line, text)

            viewer = graph.node('viewer', f'look:typed:/t:{COUNT}')
            recorder = self.record(graph, again)
            play = graph.run([TOOL, 'play', str(path)])
            self.assertEqual(play.wait(60), 0, graph.output(play) + graph.said(play))
            self.assert_all(graph.report(viewer), 0, ['/talker'])
            self.end(graph, recorder)
            self.assertEqual(self.info(graph, again), expected)
            self.assertEqual(graph.files(), [])


class Settings(Case):
    def test_lot_is_off(self):
        with Graph() as graph:
            graph.set_parameter('/talker/lot/enable', False)
            listener = graph.node('listener', f'sub:lot:/t:{COUNT}')
            talker = graph.node('talker', f'pub:lot:/t:{COUNT}:300:1000:wait=1')
            self.assert_all(graph.report(listener), 0, ['/talker'])
            self.assertEqual(graph.report(talker)[0]['serialised'], COUNT)

    def test_a_pointer_into_shared_memory_where_lot_is_off(self):
        """There is none to give: the node says so, and does not end."""
        with Graph() as graph:
            graph.set_parameter('/listener/lot/enable', False)
            listener = graph.node('listener', 'sub:lotptr:/t')
            talker = graph.node('talker', f'pub:lot:/t:{COUNT}:300:1000:wait=1')
            self.assertEqual(graph.report(talker)[0]['serialised'], COUNT)
            self.assertEqual(graph.stop(listener)[0]['from'], {})
            self.assertIn('a message is dropped: ', graph.said(listener))

    def test_a_wrong_setting_is_said_and_messages_go_over_tcpros(self):
        for name, value, words in (('queue', 'heap', 'write ring or mutex'),
                                   ('size', '12 potatoes', 'not a size'),
                                   ('size', '-64M', 'not a size'),
                                   ('segment', 'no/such', 'LOT is off')):
            with self.subTest(name=name, value=value), Graph() as graph:
                graph.env.pop('LOT_SEGMENT')
                graph.set_parameter(f'/talker/lot/{name}', value)
                graph.set_parameter('/listener/lot/segment', graph.segment)
                listener = graph.node('listener', f'sub:lot:/t:{COUNT}')
                talker = graph.node('talker', f'pub:lot:/t:{COUNT}:300:1000:wait=1')
                self.assert_all(graph.report(listener), 0, ['/talker'])
                graph.report(talker)
                self.assertIn(words, graph.said(talker))

    def test_another_definition_of_the_type_is_said(self):
        """Two LOT nodes that were built with different definitions: ROS refuses the link, and LOT the ring."""
        ends = {'listener': f'sub:lot:/t:{COUNT}', 'other': 'pub:other:/t:1000000:200:1000'}
        for order in itertools.permutations(ends):
            with self.subTest(order=order), Graph() as graph:
                nodes = {}
                for name in order:
                    nodes[name] = graph.node(name, ends[name])
                    graph.wait_for(lambda graph=graph, name=name: f'/{name}' in sum(graph.peers('/t'), []), name)
                talker = graph.node('talker', f'pub:lot:/t:{COUNT}:200:1000:wait=1')
                self.assert_all(graph.report(nodes['listener']), 0, ['/talker'])
                graph.report(talker)
                graph.stop(nodes['other'])
                self.assertRegex(graph.said(nodes[order[1]]), 'LOT: /t (goes|comes) over TCPROS: .*sensor_msgs/Image')
                self.assertIn('md5sum', graph.said(nodes['other']) + graph.said(nodes['listener']))

    def test_a_segment_of_another_layout_is_said(self):
        with Graph() as graph:
            old = graph.node('old', 'pub:lot:/other:100000:50:1000')
            graph.wait_for(lambda: (graph.shm / graph.segment).exists(), 'a segment')
            time.sleep(0.5)
            with (graph.shm / graph.segment).open('r+b') as segment:
                segment.seek(8)  # behind the magic: docs/layout.md
                version = int.from_bytes(segment.read(4), 'little')
                segment.seek(8)
                segment.write((version + 1).to_bytes(4, 'little'))
            listener = graph.node('listener', f'sub:lot:/t:{COUNT}')
            talker = graph.node('talker', f'pub:lot:/t:{COUNT}:300:1000:wait=1')
            self.assert_all(graph.report(listener), 0, ['/talker'])
            self.assertEqual(graph.report(talker)[0]['serialised'], COUNT)
            for node in (listener, talker):
                self.assertIn('LOT is off in this node', graph.said(node))
                self.assertIn('layout', graph.said(node))
            graph.stop(old)

    @unittest.skipUnless(os.geteuid() == 0, 'only root can be another user')
    def test_who_may_not_open_the_segment_says_so(self):
        nobody = ['setpriv', '--reuid', '65534', '--clear-groups']
        if subprocess.run([*nobody, 'true'], check=False).returncode != 0:
            self.skipTest('no other users here')
        with Graph() as graph:
            theirs = shutil.copy(NODE, graph.home / 'node')  # the build may be where nobody else may read
            talker = graph.node('talker', f'pub:lot:/t:{COUNT}:300:1000:wait=1')
            graph.wait_for(lambda: (graph.shm / graph.segment).exists(), 'a segment')
            graph.home.chmod(0o777)
            listener = graph.start([*nobody, theirs, f'sub:lot:/t:{COUNT}', '__name:=listener'])
            self.assert_all(graph.report(listener), 0, ['/talker'])
            self.assertEqual(graph.report(talker)[0]['serialised'], COUNT)
            self.assertIn('LOT is off in this node', graph.said(listener))
            self.assertIn('ermission', graph.said(listener))

    def test_time_is_simulated(self):
        for ticks in (False, True):
            with self.subTest(ticks=ticks), Graph() as graph:
                graph.set_parameter('/use_sim_time', True)
                if ticks:
                    clock = graph.run(['rostopic', 'pub', '-r', '10', '/clock', 'rosgraph_msgs/Clock',
                                       '{clock: {secs: 42}}'])
                    graph.wait_for(lambda: graph.peers('/clock')[0], 'time')
                listener = graph.node('listener', f'sub:lot:/t:{COUNT}')
                talker = graph.node('talker', f'pub:lot:/t:{COUNT}:100:1000:wait=1')
                report = graph.report(listener)
                self.assert_all(report, 0, ['/talker'])
                self.assertEqual(report[0]['from']['/talker']['stamp'], 42 if ticks else 0)
                self.assertEqual(graph.report(talker)[0]['serialised'], 0)
                if ticks:
                    self.assertIsNone(clock.poll())

    def test_the_queue_the_segment_and_its_size(self):
        for queue, first in ('mutex', '0.0625G'), ('ring', 64 << 20), ('mutex', '65536K'), ('ring', '64M'):
            with self.subTest(queue=queue, first=first), Graph() as graph:
                graph.env.pop('LOT_SEGMENT')
                for node, size in ('listener', first), ('talker', '128M'):  # the first one makes the segment
                    graph.set_parameter(f'/{node}/lot/segment', graph.segment + '_own')
                    graph.set_parameter(f'/{node}/lot/size', size)
                graph.set_parameter('/talker/lot/queue', queue)
                listener = graph.node('listener', f'sub:lot:/t:{COUNT}')
                talker = graph.node('talker', f'pub:lot:/t:{COUNT}:100:1000:wait=1')
                graph.wait_for(lambda: all(graph.peers('/t')), 'both')
                size = (graph.shm / (graph.segment + '_own')).stat().st_size
                self.assertEqual(size >> 20, 64)
                seen = subprocess.run([TOOL, '-s', graph.segment + '_own', 'ls', '--json'], env=graph.env, text=True,
                                      capture_output=True, timeout=60, check=True).stdout
                engines = [publisher['engine'] for segment in json.loads(seen)['segments'] for topic in segment['topics']
                           if topic['name'].endswith('/t') for publisher in topic['publishers']]
                self.assertEqual(engines, [queue])
                self.assert_all(graph.report(listener), 0, ['/talker'])
                self.assertEqual(graph.report(talker)[0]['serialised'], 0)

    def test_how_lots_thread_waits(self):
        for word in 'adaptive', 'spin', 'idle':
            with self.subTest(word), Graph() as graph:
                graph.set_parameter('/listener/lot/wait', word)
                listener = graph.node('listener', f'sub:lot:/t:{COUNT}')
                talker = graph.node('talker', f'pub:lot:/t:{COUNT}:300:1000:wait=1')
                self.assert_all(graph.report(listener), 0, ['/talker'])
                self.assertEqual(graph.report(talker)[0]['serialised'], 0)
                said = '~lot/wait: idle is no way to wait' in graph.said(listener)
                self.assertEqual(said, word == 'idle')

    def test_two_graphs_in_one_segment(self):
        with Graph() as one, Graph() as two:
            two.env['LOT_SEGMENT'] = one.segment
            nodes = [(graph, graph.node('listener', f'sub:lot:/t:{COUNT}'),
                      graph.node('talker', f'pub:lot:/t:{COUNT}:300:1000:wait=1'))
                     for graph in (one, two)]
            for graph, listener, talker in nodes:
                self.assert_all(graph.report(listener), 0, ['/talker'])
                self.assertEqual(graph.report(talker)[0]['serialised'], 0)
            self.assertEqual(one.files(), [])

    def test_private_names_and_the_talkers_remapped(self):
        with Graph() as graph:
            listener = graph.start([NODE, f'sub:lot:~in:{COUNT}', '__name:=listener',
                                    '~in:=/robot/image'])
            talker = graph.start([NODE, f'pub:lot:~out:{COUNT}:300:1000:wait=1', '__name:=talker',
                                  '__ns:=robot', '~out:=image'])
            self.assert_all(graph.report(listener), 0, ['/robot/talker'])
            self.assertEqual(graph.report(talker)[0]['serialised'], 0)

    def test_names_are_remapped_and_in_namespaces(self):
        with Graph() as graph:
            listener = graph.start([NODE, f'sub:lot:image:{COUNT}', '__name:=listener', '__ns:=robot',
                                    'image:=camera/image'])
            talker = graph.start([NODE, f'pub:lot:/robot/camera/image:{COUNT}:300:1000:wait=1',
                                  '__name:=talker'])
            self.assert_all(graph.report(listener), 0, ['/talker'])
            self.assertEqual(graph.report(talker)[0]['serialised'], 0)


def run(*words):
    subprocess.run(words, check=True, timeout=20)


def in_parts():
    """All of them, two at a time: most of their time they wait for each other's nodes."""
    names = [name for name, value in globals().items() if isinstance(value, type) and issubclass(value, Case)]
    first = [name for name in names if name in ('Pairs', 'Deaths')]
    parts = [subprocess.Popen([sys.executable, __file__, *part], text=True, stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT)
             for part in (first, [name for name in names if name not in first])]
    for part in parts:
        print(part.communicate()[0])
    return any(part.returncode != 0 for part in parts)


if __name__ == '__main__':
    if len(sys.argv) == 1:
        sys.exit(in_parts())
    results = unittest.main(exit=False).result
    for _, reason in results.skipped:
        print('skipped:', reason)
    sys.exit(not results.wasSuccessful())
