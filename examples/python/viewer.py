#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Shows a topic of frames, whichever program sends them: their type comes from the topic.

    viewer.py TOPIC [COUNT]

It looks for fields `height`, `width` and `data`, prints what it sees of COUNT frames (for ever), and opens a window
where OpenCV and a screen are there. It is an observer: no publisher waits for it.
"""

import importlib.util
import itertools
import os
import sys

import lot
import numpy as np


def image_of(frame):
    """A view of the pixels: no copy."""
    pixels = np.asarray(frame.data)
    if 'height' not in frame.fields():
        return pixels
    return pixels.reshape(frame.height, frame.width, -1)


def main(topic, count=None):
    frames = lot.Engine().subscribe(topic, observer=True)
    has_screen = 'DISPLAY' in os.environ and importlib.util.find_spec('cv2') is not None
    for number in itertools.count() if count is None else range(int(count)):
        with frames.borrow() as frame:
            if frame is None:  # the last publisher has gone
                return
            image = image_of(frame)
            print(f'{number}: {image.shape} {image.dtype}, mean {image.mean():.1f}, {frames.missed_total} missed', flush=True)
            if has_screen:
                import cv2
                cv2.imshow(topic, image)
                cv2.waitKey(1)
            del image  # a view that is alive here would keep the frame


if __name__ == '__main__':
    main(*sys.argv[1:])
