#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""lot::ros over minutes: many topics, a dead master, slow callbacks, 1 kHz, flat memory.

    tests/lot_ros/long_test.py [Long.test_...]       about 14 minutes; LOT_ROS_LONG=0.1 in the environment: a tenth
"""

import os
import pathlib
import signal
import time
import unittest

os.environ.setdefault('LOT_ROS_NODE', 'build/release/tests/lot_ros/ros_node')
os.environ.setdefault('LOT_TOOL', 'build/release/src/tool/lot')

from graph import Graph  # noqa: E402
from ros_test import Case  # noqa: E402

SHARE = float(os.environ.get('LOT_ROS_LONG', 1))
KIB = 1024
LONG = ('--for', '2000')  # seconds, after which a node ends by itself


def share(number):
    return max(1, int(number * SHARE))


def resident(process):
    """Bytes that a process has in memory, those of the segment left out."""
    status = pathlib.Path(f'/proc/{process.pid}/status').read_text()
    return KIB * int(next(line for line in status.splitlines() if line.startswith('RssAnon')).split()[1])


class Long(Case):
    def test_fifty_topics_of_twenty_nodes(self):
        """Each topic has a publisher and three subscribers; each node has a part in ten of them."""
        count, nodes, topics = share(600), 20, 50
        with Graph() as graph:
            ends = [[] for _ in range(nodes)]
            for t in range(topics):
                ends[t % nodes].append(f'pub:lot:/t{t}:{count}:10:20000:wait=3')
                for k in 1, 7, 12:
                    ends[(t + k) % nodes].append(f'sub:lot:/t{t}:{count}')
            started = [graph.run([os.environ['LOT_ROS_NODE'], *mine, f'__name:=node{n}', '--spin', 'async', *LONG])
                       for n, mine in enumerate(ends)]
            serialised = 0
            for n, node in enumerate(started):
                for i, report in enumerate(graph.report(node, 120 + count)):
                    if report['end'] == 'pub':
                        serialised += report['serialised']
                    else:
                        t = int(report['topic'][2:])
                        self.assert_all([report], 0, [f'/node{t % nodes}'], count)
            # A node that starts may take longer than a second until it reads a ring.
            self.assertLess(serialised, topics * count / 10)

    def test_the_master_is_killed(self):
        """What is linked goes on: no message is missed, none is serialised."""
        count = share(3000)
        with Graph() as graph:
            listeners = [graph.node(f'listener{i}', f'sub:lot:/t:{count}', *LONG) for i in range(3)]
            talker = graph.node('talker', f'pub:lot:/t:{count}:100:100000:wait=3', *LONG)
            graph.wait_for(lambda: graph.published() > count / 10, 'messages')
            graph.master.send_signal(signal.SIGKILL)
            for listener in listeners:
                self.assert_all(graph.report(listener, 120), 0, ['/talker'], count)
            self.assertEqual(graph.report(talker, 60)[0]['serialised'], 0)

    def test_callbacks_of_a_second(self):
        """What queues hold is not missed, and the others are not held up."""
        count = share(3000)
        with Graph() as graph:
            slow = graph.node('slow', f'sub:lot:/t:{count}:queue=500:slow', *LONG)
            quick = graph.node('quick', f'sub:lot:/t:{count}', *LONG)
            began = time.monotonic()
            talker = graph.node('talker', f'pub:lot:/t:{count}:100:20000:wait=2', *LONG)
            self.assert_all(graph.report(quick, 120), 0, ['/talker'], count)
            self.assertLess(time.monotonic() - began, count / 100 * 2 + 20)
            self.assert_all(graph.report(slow, 120), 0, ['/talker'], count)
            self.assertEqual(graph.report(talker, 60)[0]['serialised'], 0)

    def test_a_thousand_a_second_for_a_minute(self):
        count = share(60_000)
        with Graph() as graph:
            listeners = [graph.node(f'listener{i}', f'sub:lot:/t:{count}:queue=5000', *LONG) for i in range(2)]
            talker = graph.node('talker', f'pub:lot:/t:{count}:1000:200:wait=2:queue=1000', *LONG)
            for listener in listeners:
                self.assert_all(graph.report(listener, 240), 0, ['/talker'], count)
            self.assertEqual(graph.report(talker, 60)[0]['serialised'], 0)

    def test_memory_stays_as_it_is_for_ten_minutes(self):
        """1 MiB at 30 Hz: after the first tenth neither a process nor the segment grows."""
        count = share(18_000)
        with Graph() as graph:
            listeners = [graph.node(f'listener{i}', f'sub:{how}:/t:{count}', *LONG) for i, how in enumerate(('lot', 'lotptr'))]
            talker = graph.node('talker', f'pub:lot:/t:{count}:30:1048576:wait=2:queue=30', *LONG)
            everybody = [*listeners, talker]

            def state():
                blocks = graph.look()['blocks']['used']
                return [resident(process) for process in everybody], blocks

            graph.wait_for(lambda: graph.published() > count / 10, 'the first tenth', 120)
            before, blocks_before = state()
            graph.wait_for(lambda: graph.published() > count * 0.97, 'nearly all', 900)
            after, blocks_after = state()
            for name, then, now in zip(('listener0', 'listener1', 'talker'), before, after):
                self.assertLess(now, then + 4 * KIB * KIB, f'{name} has grown')
            self.assertLess(blocks_after, blocks_before + 8)
            for listener in listeners:
                self.assert_all(graph.report(listener, 120), 0, ['/talker'], count)
            self.assertEqual(graph.report(talker, 60)[0]['serialised'], 0)


if __name__ == '__main__':
    unittest.main(verbosity=2)
