#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""A service that smooths curves. The server fills the answer in shared memory, and the client reads it there.

    service.py
"""

import os
import sys

import lot
import numpy as np


@lot.message
class Curve:
    window: lot.u32
    values: lot.vector[lot.f64]


@lot.message
class Smooth:
    values: lot.vector[lot.f64]


def smooth(curve, answer):
    if curve.window == 0:
        raise ValueError('a window has one value or more')
    values = np.asarray(curve.values)
    answer.values = np.convolve(values, np.ones(curve.window) / curve.window, 'valid')


def main():
    os.environ.setdefault('LOT_SEGMENT', f'lot_service_{os.getpid()}')
    engine = lot.Engine()
    with engine.serve('smooth', Curve, Smooth, smooth):  # as a rule in another process
        client = engine.client('smooth', Curve, Smooth)
        answer = client.call(window=3, values=[0, 3, 6, 3, 0], timeout=10)
        print(np.asarray(answer.values))
        try:
            client.call(window=0, values=[], timeout=10)
        except lot.Error as error:
            print(error.strerror)
    return 0 if np.allclose(answer.values, [3, 4, 3]) else 1


if __name__ == '__main__':
    sys.exit(main())
