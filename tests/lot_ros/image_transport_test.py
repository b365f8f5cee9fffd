#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Debian's programs for images, unmodified, with image_transport's transport `lot`: as it is installed."""

import hashlib
import os
import pathlib
import shutil
import signal
import subprocess
import tempfile
import unittest
import xmlrpc.client

from graph import Graph

BUILD = os.environ.get('LOT_BUILD', 'build/release')
PUBLISHER = '/usr/lib/image_publisher/image_publisher'
REPUBLISH = '/usr/lib/image_transport/republish'
SAVER = '/usr/lib/image_view/image_saver'
WIDTH, HEIGHT = 640, 480
PIXELS = bytes(i * 7 % 251 for i in range(3 * WIDTH * HEIGHT))  # red, green, blue

PRINT_DIGESTS = '''
import hashlib, sys, rospy
from sensor_msgs.msg import Image
def show(image):
    print(image.encoding, image.height, image.width, hashlib.md5(image.data).hexdigest(), flush=True)
rospy.init_node('digests', anonymous=True)
rospy.Subscriber(sys.argv[1], Image, show)
rospy.spin()
'''


class Images(Graph):
    def __init__(self, prefix):
        super().__init__()
        self.env['ROS_PACKAGE_PATH'] = f'{prefix}/share:/usr/share'

    def picture(self):
        picture = self.home / 'picture.ppm'
        picture.write_bytes(b'P6 %d %d 255\n' % (WIDTH, HEIGHT) + PIXELS)
        return picture

    def camera(self):
        """Publishes /camera/image_raw with every transport that there is."""
        camera = self.run([PUBLISHER, str(self.picture()), '__name:=camera', '_publish_rate:=30'])
        self.wait_for(lambda: self.peers('/camera/image_raw/lot')[0], 'the camera')
        return camera

    def sent(self, node, topic):
        """Bytes that a node has sent over TCPROS on a topic."""
        with xmlrpc.client.ServerProxy(self.ask('lookupNode', node)) as server:
            published = server.getBusStats('/test')[0]
        return sum(link[1] for name, links in published if name == topic for link in links)

    def readers(self, topic):
        """Names of those that read a topic's ring."""
        names = {process['index']: process['name'] for process in self.look()['processes']}
        return [names[subscriber['process']] for each in self.look().get('topics', []) if each['name'].endswith(topic)
                for subscriber in each['subscribers']]


class ImageTransport(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.prefix = pathlib.Path(tempfile.mkdtemp(prefix='lot_prefix_'))
        subprocess.run(['cmake', '--install', BUILD, '--prefix', str(cls.prefix)], check=True, stdout=subprocess.DEVNULL)

    @classmethod
    def tearDownClass(cls):
        shutil.rmtree(cls.prefix)

    def test_images_of_a_plain_camera_reach_plain_nodes_in_shared_memory(self):
        with Images(self.prefix) as graph:
            graph.camera()
            graph.run([REPUBLISH, 'lot', 'in:=/camera/image_raw', 'raw', 'out:=/again', '__name:=republish'])
            digests = graph.run(['/usr/bin/python3', '-c', PRINT_DIGESTS, '/again'])
            graph.wait_for(lambda: len(graph.output(digests).splitlines()) > 10, 'images')
            # image_publisher reads the picture as OpenCV does: blue, green, red.
            bgr = bytes(PIXELS[i + 2 - 2 * (i % 3)] for i in range(len(PIXELS)))
            self.assertEqual(set(graph.output(digests).splitlines()),
                             {f'bgr8 {HEIGHT} {WIDTH} {hashlib.md5(bgr).hexdigest()}'})
            self.assertEqual(graph.readers('/camera/image_raw/lot'), ['/republish'])
            self.assertLess(graph.sent('/camera', '/camera/image_raw/lot'), len(PIXELS))
            self.assertEqual(graph.sent('/camera', '/camera/image_raw'), 0)

    def test_a_node_is_told_by_its_parameter(self):
        with Images(self.prefix) as graph:
            graph.camera()
            graph.set_parameter('/saver/image_transport', 'lot')
            graph.run([SAVER, 'image:=/camera/image_raw', '__name:=saver', f'_filename_format:={graph.home}/%04i.ppm'])
            graph.wait_for(lambda: len(list(graph.home.glob('0*.ppm'))) > 3, 'pictures')
            self.assertEqual(sorted(graph.home.glob('0*.ppm'))[0].read_bytes()[-len(PIXELS):], PIXELS)
            self.assertEqual(graph.readers('/camera/image_raw/lot'), ['/saver'])

    def test_nodes_of_lot_have_the_same_topic(self):
        """As a subscriber of what a plain camera publishes so, and as a camera for plain nodes."""
        with Images(self.prefix) as graph:
            graph.camera()
            reader = graph.run([f'{self.prefix}/share/lot/ros_camera', 'viewer', '/camera/image:=/camera/image_raw/lot'])
            graph.wait_for(lambda: f'{len(PIXELS)} bytes' in graph.output(reader), 'images')
            graph.run([f'{self.prefix}/share/lot/ros_camera', 'camera', '/camera/image:=/ported/lot'])
            graph.run([REPUBLISH, 'lot', 'in:=/ported', 'raw', 'out:=/of_ported', '__name:=of_ported'])
            digests = graph.run(['/usr/bin/python3', '-c', PRINT_DIGESTS, '/of_ported'])
            graph.wait_for(lambda: 'rgba8 2048 2048' in graph.output(digests), 'images of 16 MiB')

    def test_a_pipeline_of_plain_programs_and_one_ported_node(self):
        """examples/ros/launch/pipeline.launch; and the node finds what it found before it was ported."""
        with Images(self.prefix) as graph:
            picture = graph.picture()
            launch = graph.run(['roslaunch', 'lot', 'pipeline.launch', f'picture:={picture}',
                                f'pictures:={graph.home}/edges%04i.png'])
            plain = graph.run([f'{self.prefix}/share/lot/ros_edges', '__name:=plain', 'image:=/camera/image_raw',
                               'edges:=/by_plain'])
            found = [graph.run(['/usr/bin/python3', '-c', PRINT_DIGESTS, topic]) for topic in ('/edges/plain', '/by_plain')]
            for node in found:
                graph.wait_for(lambda node=node: len(graph.output(node).splitlines()) > 10, 'edges')
            edges = [set(graph.output(node).splitlines()) for node in found]
            self.assertEqual(edges[0], edges[1])
            self.assertRegex(edges[0].pop(), f'^mono8 {HEIGHT} {WIDTH} ')
            graph.wait_for(lambda: len(list(graph.home.glob('edges*.png'))) > 1, 'pictures')
            self.assertEqual(graph.readers('/camera/image_raw/lot'), ['/find_edges'])
            self.assertEqual(sorted(graph.readers('/edges/lot')), ['/pictures', '/republish'])
            self.assertLess(graph.sent('/camera', '/camera/image_raw/lot'), len(PIXELS))
            self.assertLess(graph.sent('/find_edges', '/edges/lot'), len(PIXELS))
            for process in launch, plain:
                process.send_signal(signal.SIGINT)
                process.wait(60)
            self.assertEqual(graph.files(), [])


if __name__ == '__main__':
    unittest.main(verbosity=2)
