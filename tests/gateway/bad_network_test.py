#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""lot_gateway between two hosts whose network loses frames, delays them, or is slow.

    bad_network_test.py GATEWAY NODE

The cable is forwarder.py, or one whose rate is limited. What comes is compared byte by byte; what does not come is
counted.
"""

import os
import pathlib
import re
import signal
import sys
import unittest

import hosts

GATEWAY, NODE = sys.argv[1:]
del sys.argv[1:]
SEEN = re.compile(r'seen (\d+) from (\d+) to (\d+), missed (\d+)')
SEED = os.environ.get('LOT_TEST_SEED', '7')


def table(gateway, direction, topic):
    """The line of a gateway's table: {column: number}. It ends the gateway."""
    gateway.process.terminate()
    gateway.finish()
    names = ['carried', 'bytes', 'missed', 'before', 'lost', 'refused', 'damaged', 'looped', 'unheard']
    found = re.findall(rf'^{direction}((?: +\d+){{9}})  {topic}$', gateway.said(), re.MULTILINE)
    return dict(zip(names, map(int, found[-1].split())))


class Case(unittest.TestCase):
    def begin(self, bad=None):
        self.hosts = hosts.Hosts.of_test(self, bad)

    def gateway(self, host, direction, topic, **settings):
        file = pathlib.Path(self.hosts.folder.name, f'gateway{host}.yaml')
        words = ''.join(f', {name}: {value}' for name, value in settings.items())
        file.write_text(f'interface: {hosts.CABLE}\n{direction}:\n  - {{topics: {topic}{words}}}\n', encoding='utf-8')
        return self.hosts.run(host, GATEWAY, '--config', file)

    def pair(self, **settings):
        return self.gateway(0, 'out', '/frames', **settings), self.gateway(1, 'in', '/frames', **settings)

    def follow(self, last):
        follower = self.hosts.run(1, NODE, 'follow', '/frames', last)
        follower.wait_for('ready')
        return follower

    def seen_by(self, follower):
        """Of a follower that has ended: how many frames, from which to which."""
        seen, first, last, missed = map(int, SEEN.search(follower.said()).groups())
        self.assertEqual(missed, 0)
        return seen, first, last

    def test_reliable_frames_all_come_where_the_network_loses_and_delays(self):
        self.begin((SEED, '2', '3'))
        _, receiver = self.pair(depth=1000)
        follower = self.follow(300)
        self.hosts.run(0, NODE, 'send', '/frames', '40000', '10', '300')
        follower.finish()
        seen, first, last = self.seen_by(follower)
        self.assertEqual(seen, last - first + 1)
        line = table(receiver, 'in', '/frames')
        self.assertEqual(line['lost'] + line['damaged'] + line['refused'], 0)

    def test_what_best_effort_loses_is_counted_and_nothing_is_damaged(self):
        self.begin((SEED, '2', '0'))
        _, receiver = self.pair(reliability='best_effort')
        follower = self.follow(1000000)
        sender = self.hosts.run(0, NODE, 'send', '/frames', '10000', '5')
        follower.wait_for_lines(200)
        self.hosts.heal()
        follower.wait_for_lines(30)  # so the last frame that was lost has one behind it
        sender.kill(signal.SIGTERM)
        follower.process.terminate()
        follower.finish()
        seen, first, last = self.seen_by(follower)
        line = table(receiver, 'in', '/frames')
        self.assertNotEqual(line['lost'], 0)
        self.assertEqual(line['lost'], last - first + 1 - seen)
        self.assertEqual(line['damaged'] + line['refused'], 0)

    def test_a_latched_frame_comes_over_a_network_that_loses(self):
        self.begin((SEED, '5', '2'))
        self.hosts.run(0, NODE, 'latch', '/map', '200000').wait_for('ready')
        self.gateway(0, 'out', '/map', durability='transient_local', depth=1).wait_for('out /map -> rt/map')
        self.gateway(1, 'in', '/map')
        self.hosts.run(1, NODE, 'receive', '/map', '1').finish()

    def test_frames_come_in_order_over_a_slow_network_and_the_others_are_counted(self):
        self.begin()
        for host in range(2):
            self.hosts.limit(host, '40mbit')
        sender, receiver = self.pair(depth=8)
        follower = self.follow(200)
        self.hosts.run(0, NODE, 'send', '/frames', '60000', '5', '200')  # 96 Mbit a second
        follower.finish()
        seen, first, last = self.seen_by(follower)
        out, into = table(sender, 'out', '/frames'), table(receiver, 'in', '/frames')
        self.assertEqual(into['damaged'] + into['refused'], 0)
        self.assertEqual(seen + into['lost'] + out['missed'] + out['lost'], last - first + 1)

    def test_a_deadline_that_the_network_misses_is_told(self):
        self.begin()
        _, receiver = self.pair(deadline_ms=500)
        follower = self.follow(1000000)
        self.hosts.run(0, NODE, 'send', '/frames', '100', '5')
        follower.wait_for_lines(10)
        self.hosts.plug(0, False)
        receiver.wait_for('/frames: no message came within its deadline')


if __name__ == '__main__':
    unittest.main(verbosity=2)
