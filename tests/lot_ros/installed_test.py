#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""LOT as it is installed, as a package of ROS: installed_test.py PREFIX."""

import signal
import sys
import unittest

from graph import Graph


class Installed(unittest.TestCase):
    def test_what_is_installed_is_launched_by_its_package(self):
        with Graph() as graph:
            graph.env['ROS_PACKAGE_PATH'] = f'{sys.argv[1]}/share'
            launch = graph.run(['roslaunch', 'lot', 'camera.launch'])
            graph.wait_for(lambda: graph.output(launch).count('16777216 bytes') > 20, 'images')
            relay = graph.run(['roslaunch', 'lot', 'relay.launch', 'in:=/camera/image'])
            graph.wait_for(lambda: graph.peers('/shared/camera/image')[0], 'the relay')
            for process in relay, launch:
                process.send_signal(signal.SIGINT)
                process.wait(60)
            self.assertEqual(graph.files(), [])


if __name__ == '__main__':
    unittest.main(argv=sys.argv[:1])
