#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""A detector between two nodes in C++: camera -> this -> logger, three processes and not one copy.

    detector.py CHAIN       CHAIN: the program of ../chain.cpp, whose detector this is

No type is declared here: both come from the topics. A detection refers to the frame that it was made from.
"""

import os
import subprocess
import sys

import lot
import numpy as np


def place_of(engine, address):
    """Offset in the segment's file, which all processes share; addresses differ between them."""
    with open('/proc/self/maps') as maps:
        for line in maps:
            begin, end = (int(word, 16) for word in line.split()[0].split('-'))
            if begin <= address < end and engine.path in line:
                return address - begin + int(line.split()[2], 16)
    return 0  # not in shared memory


def type_of(engine, topic):
    """What the topic carries: when its first user has come."""
    while (found := engine.type_of(topic)) is None:
        os.sched_yield()
    return found


def detect():
    engine = lot.Engine()
    detections = engine.advertise('/detections', type_of(engine, '/detections'))
    detections.wait_for_readers()
    for frame in engine.subscribe('/frames', type_of(engine, '/frames')):  # until the camera has gone
        pixels = np.asarray(frame.pixels)
        detection = detections.loan(frame=frame, brightest=int(pixels.argmax()))
        detection.place = place_of(engine, pixels.ctypes.data)
        detections.push(detection)


def main(chain):
    os.environ.setdefault('LOT_SEGMENT', f'lot_detector_{os.getpid()}')
    with subprocess.Popen([chain, 'around']) as nodes:  # the camera and the logger
        try:
            detect()
        except BaseException:
            nodes.terminate()  # they would wait for a detector
            raise
    return nodes.returncode


if __name__ == '__main__':
    sys.exit(main(*sys.argv[1:]))
