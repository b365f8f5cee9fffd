#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""lot_gateway beside @foxglove/ros2, an implementation of ROS 2 that shares no code with CycloneDDS.

    ros2_test.py GATEWAY NODE LOT MODULES [unittest's arguments]

NODE is gateway_node; LOT the command `lot`; MODULES the node_modules that scripts/setup makes. The hosts are network
namespaces with a cable between them; the program of ROS 2 runs on host 1.
"""

import json
import pathlib
import shutil
import sys
import time
import unittest

import hosts

GATEWAY, NODE, LOT, MODULES = sys.argv[1:5]
del sys.argv[1:5]
HERE = pathlib.Path(__file__).resolve().parent
LISTS = HERE.parents[1] / 'examples' / 'ros2_node.mjs'
PEER = HERE / 'ros2_peer.mjs'
# @foxglove/ros2 asks each writer for what it has written before.
SETTINGS = '''
node: robot
out:
  - {topics: "/*", durability: transient_local, depth: 1}
in:
  - /back
  - /cmd_vel
'''


class Ros2(unittest.TestCase):
    def setUp(self):
        if not (shutil.which('node') and pathlib.Path(MODULES, '@foxglove', 'ros2').is_dir()):
            print('skipped: no packages of npm here (scripts/setup test)')
            self.skipTest('there is no @foxglove/ros2')
        self.hosts = hosts.Hosts.of_test(self)
        settings = pathlib.Path(self.hosts.folder.name, 'gateway.yaml')
        settings.write_text(SETTINGS, encoding='utf-8')
        self.hosts.run(0, GATEWAY, '--interface', hosts.CABLE, '--config', settings)

    def peer(self, *words):
        return self.hosts.run(1, 'node', PEER, hosts.address(1), *words)

    def test_it_lists_the_nodes_of_both_hosts_with_their_topics(self):
        self.hosts.run(0, NODE, 'send', '/forth', '1000', '50')
        self.hosts.run(1, GATEWAY, '--interface', hosts.CABLE, '--in', '/forth')
        self.hosts.run(1, NODE, 'receive', '/forth', '1000000')
        expected = '''/lot_gateway
    subscribes to /forth: robot/msg/Frame
/robot
    publishes /forth: robot/msg/Frame
'''
        until = time.monotonic() + hosts.PATIENCE_S
        said = ''
        while said != expected and time.monotonic() < until:
            listed = self.hosts.run(1, 'node', LISTS, hosts.address(1))
            listed.finish()
            said = listed.said()
        self.assertEqual(said, expected)

    def test_it_reads_each_byte_that_lot_publishes(self):
        for size in 0, 1000, 65536:
            with self.subTest(size=size):
                sent = self.hosts.run(0, NODE, 'send', f'/forth{size}', str(size), '50')
                seen = self.peer('receive', f'/forth{size}', 'robot/msg/Frame', '3')
                seen.finish()
                sent.kill()
                for line in seen.said().splitlines():
                    frame = json.loads(line)
                    number = frame['number']
                    self.assertEqual(frame['label'], f'frame {number}')
                    self.assertEqual(frame['data'], [number * 31 + i * 7 + i // 251 & 255 for i in range(size)])

    def test_lot_reads_each_byte_that_it_publishes(self):
        seen = self.hosts.run(0, NODE, 'receive', '/back', '20')
        self.peer('frames', '/back', '900')  # it writes no fragments
        seen.finish()

    def test_a_common_message_that_it_publishes_needs_no_subscriber(self):
        self.peer('send', '/cmd_vel', 'geometry_msgs/msg/Twist', '{"linear": {"x": 1.5}, "angular": {"z": -2}}')
        seen = self.hosts.run(0, LOT, 'echo', '/cmd_vel', '--count', '1', '--json')
        seen.finish()
        self.assertIn('"x":1.5', seen.said().replace(' ', ''))
        self.assertIn('"z":-2', seen.said().replace(' ', ''))


if __name__ == '__main__':
    unittest.main(verbosity=2)
