#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""lot_gateway between two hosts, and beside programs of CycloneDDS and Fast DDS.

    hosts_test.py GATEWAY NODE CYCLONE_PEER [FASTDDS_PEER]

The hosts are network namespaces with a cable between them. Frames of 128 B to 16 MiB cross it in both directions;
each receiver compares every byte.
"""

import os
import pathlib
import signal
import sys
import unittest

import hosts

GATEWAY, NODE, CYCLONE, *FAST = sys.argv[1:]
del sys.argv[1:]
SIZES = [('128', '5'), ('65536', '20'), ('2097152', '60'), ('16777216', '400')]  # bytes, milliseconds between two
FAST_NEEDS = 4 << 20  # bytes of a socket's buffer


def count_for(size):
    return '4' if int(size) > 1 << 23 else '20'


class Case(unittest.TestCase):
    def setUp(self):
        self.hosts = hosts.Hosts.of_test(self)

    def gateway(self, host, *words):
        return self.hosts.run(host, GATEWAY, '--interface', hosts.CABLE, *words)

    def finish(self, program):
        """As the program's own; where it does not, with what all programs have said."""
        try:
            program.finish()
        except AssertionError as wrong:
            raise AssertionError('\n-- '.join([str(wrong), *(f'{p.name}:\n{p.said()}' for p in self.hosts.programs)])) from wrong

    def both_ways(self, there, name, sizes=SIZES):
        """Frames of all sizes between NODE on host 0, behind a gateway, and what `there` runs on host 1."""
        for size, period in sizes:
            with self.subTest(size=size):
                seen = [self.hosts.run(0, NODE, 'receive', '/back', count_for(size)),
                        self.hosts.run(1, there, 'receive', name('/forth'), count_for(size))]
                sent = [self.hosts.run(0, NODE, 'send', '/forth', size, period),
                        self.hosts.run(1, there, 'send', name('/back'), size, period)]
                for program in seen:
                    self.finish(program)
                for program in sent:
                    program.kill(signal.SIGTERM)


class Lot(Case):
    def test_frames_cross_between_two_hosts_of_lot(self):
        self.gateway(0, '--out', '/*', '--in', '/*')
        self.gateway(1, '--out', '/*', '--in', '/*')
        self.both_ways(NODE, lambda topic: topic)

    def test_gateways_and_programs_come_in_any_order(self):
        programs = [lambda h: h.run(0, NODE, 'send', '/forth', '1000', '10'),
                    lambda h: self.gateway(0, '--out', '/forth'),
                    lambda h: self.gateway(1, '--in', '/forth'),
                    lambda h: h.run(1, NODE, 'receive', '/forth', '20')]
        for order in [0, 1, 2, 3], [3, 2, 1, 0], [1, 3, 0, 2], [2, 0, 3, 1]:
            with self.subTest(order=order):
                running = {}
                for i in order:
                    running[i] = programs[i](self.hosts)
                    if i in (0, 3):
                        running[i].wait_for('ready')
                running[3].finish()
                for program in running.values():
                    program.kill()

    def test_a_cable_that_was_pulled_is_put_in_again(self):
        self.gateway(0, '--out', '/forth')
        self.gateway(1, '--in', '/forth')
        self.hosts.run(0, NODE, 'send', '/forth', '65536', '10')
        for end in 0, 1:
            self.hosts.run(1, NODE, 'receive', '/forth', '20').finish()
            self.hosts.plug(end, False)
            self.hosts.plug(1 - end, True)
            self.hosts.run(0, 'sleep', '2').finish()
            self.hosts.plug(end, True)
        self.hosts.run(1, NODE, 'receive', '/forth', '20').finish()

    def test_a_gateway_ends_while_the_cable_is_out(self):
        gateway = self.gateway(0, '--out', '/forth')
        self.hosts.run(0, NODE, 'send', '/forth', '100', '10')
        gateway.wait_for('out /forth -> rt/forth')
        self.hosts.plug(0, False)
        gateway.process.terminate()
        gateway.finish()
        self.assertIn('carried', gateway.said())

    def test_a_killed_gateway_is_started_again(self):
        out = self.gateway(0, '--out', '/forth')
        into = self.gateway(1, '--in', '/forth')
        self.hosts.run(0, NODE, 'send', '/forth', '65536', '10')
        seen = self.hosts.run(1, NODE, 'receive', '/forth', '500')
        for _ in range(3):
            self.hosts.run(1, NODE, 'receive', '/forth', '10').finish()
            out.kill()
            out = self.gateway(0, '--out', '/forth')
            self.hosts.run(1, NODE, 'receive', '/forth', '10').finish()
            into.kill()
            into = self.gateway(1, '--in', '/forth')
        seen.finish()

    def test_a_latched_frame_reaches_the_other_host_later(self):
        settings = os.path.join(self.hosts.folder.name, 'gateway.yaml')
        with open(settings, 'w', encoding='utf-8') as file:
            file.write('out:\n  - {topics: /map, durability: transient_local, depth: 1}\n')
        self.hosts.run(0, NODE, 'latch', '/map', '2097152').wait_for('ready')
        self.gateway(0, '--config', settings).wait_for('out /map -> rt/map')
        self.gateway(1, '--in', '/map')
        self.hosts.run(1, NODE, 'receive', '/map', '1').finish()


class Others(Case):
    def test_frames_cross_to_a_program_of_cyclonedds_and_back(self):
        self.gateway(0, '--out', '/forth', '--in', '/back')
        self.both_ways(CYCLONE, lambda topic: 'rt' + topic)

    def test_frames_cross_to_a_program_of_fast_dds_and_back(self):
        if not FAST:
            print('skipped: no fastddsgen and Fast CDR here')
            self.skipTest('there is no Fast DDS')
        self.gateway(0, '--out', '/forth', '--in', '/back')
        sizes = SIZES
        if int(pathlib.Path('/proc/sys/net/core/rmem_max').read_text()) < FAST_NEEDS:
            print('skipped: no large socket buffers here')  # Fast DDS loses fragments again and again
            sizes = SIZES[:2]
        self.both_ways(FAST[0], lambda topic: 'rt' + topic, sizes)


if __name__ == '__main__':
    unittest.main(verbosity=2)
