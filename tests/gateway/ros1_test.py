#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Topics of lot::ros through lot_gateway, as ROS 2 reads them.

    ros1_test.py GATEWAY NODE MODULES [unittest's arguments]

NODE is gateway_ros1_node; MODULES the node_modules that scripts/setup makes. Host 0 has a master of ROS 1 and two nodes
of it; on host 1 @foxglove/ros2 reads their messages by the definitions of Humble, encodes them again, and compares.
"""

import json
import pathlib
import shutil
import sys
import unittest

import hosts

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / 'lot_ros'))
import graph  # noqa: E402

GATEWAY, NODE, MODULES = sys.argv[1:4]
del sys.argv[1:4]
PEER = pathlib.Path(__file__).resolve().parent / 'ros2_peer.mjs'
SETTINGS = 'out:\n  - {topics: "/*", durability: transient_local, depth: 1}\n'
BYTES = [7 * i & 255 for i in range(3000)]


def header(frame):
    return {'stamp': {'sec': 1700000000, 'nanosec': 123456789}, 'frame_id': frame}


def vector(x=0, y=0, z=0):
    return {'x': x, 'y': y, 'z': z}


QUATERNION = {'x': 0, 'y': 0, 'z': 0, 'w': 1}


def field(name, offset):
    return {'name': name, 'offset': offset, 'datatype': 7, 'count': 1}


def transform(child, y):
    return {'header': header('map'), 'child_frame_id': child,
            'transform': {'translation': vector(y=y), 'rotation': QUATERNION}}


EXPECTED = {
    ('/camera/image', 'sensor_msgs/msg/Image'): {
        'header': header('camera'), 'height': 10, 'width': 100, 'encoding': 'rgb8', 'is_bigendian': 0, 'step': 300,
        'data': BYTES},
    ('/lidar/points', 'sensor_msgs/msg/PointCloud2'): {
        'header': header('lidar'), 'height': 1, 'width': 250,
        'fields': [field('x', 0), field('y', 4), field('z', 8)], 'is_bigendian': False, 'point_step': 12,
        'row_step': 3000, 'data': BYTES, 'is_dense': True},
    ('/cmd_vel', 'geometry_msgs/msg/Twist'): {'linear': vector(x=0.5), 'angular': vector(z=-0.25)},
    ('/odom', 'nav_msgs/msg/Odometry'): {
        'header': header('odom'), 'child_frame_id': 'base',
        'pose': {'pose': {'position': vector(x=1), 'orientation': QUATERNION}, 'covariance': list(range(36))},
        'twist': {'twist': {'linear': vector(), 'angular': vector(z=2)}, 'covariance': [-i for i in range(36)]}},
    ('/tf', 'tf2_msgs/msg/TFMessage'): {
        'transforms': [transform('odom', 0), transform('a longer name of a frame', 1)]},
}


class Ros1(unittest.TestCase):
    def test_common_messages_of_ros_1_are_those_of_ros_2(self):
        if not (shutil.which('node') and pathlib.Path(MODULES, '@foxglove', 'ros2').is_dir()):
            print('skipped: no packages of npm here (scripts/setup test)')
            self.skipTest('there is no @foxglove/ros2')
        both = hosts.Hosts.of_test(self)
        inside = ['setpriv', '--pdeathsig', 'KILL', *both.inside(0)]
        with graph.Graph(inside=inside, host=hosts.address(0)) as ros:
            settings = ros.home / 'gateway.yaml'
            settings.write_text(SETTINGS, encoding='utf-8')
            for verb in 'subscribe', 'publish':  # what goes over links alone, no observer sees
                ros.run([*inside, NODE, verb])
            gateway = ros.run([*inside, GATEWAY, '--interface', hosts.CABLE, '--config', settings],
                              CYCLONEDDS_URI='')
            for (topic, name), expected in EXPECTED.items():
                with self.subTest(topic=topic):
                    seen = both.run(1, 'node', PEER, hosts.address(1), 'receive', topic, name, '1')
                    try:
                        seen.finish()
                    except AssertionError as error:
                        raise AssertionError(f'{error}\n{ros.said(gateway)}') from error
                    self.assertEqual(json.loads(seen.said()), expected)


if __name__ == '__main__':
    unittest.main(verbosity=2)
