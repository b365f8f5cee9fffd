# SPDX-License-Identifier: Apache-2.0
"""A program of somebody else that uses the installed package for Python."""

import lot
import numpy as np


@lot.message
class Frame:
    width: lot.u32
    data: lot.vector[lot.u8]


engine = lot.Engine()
pub, sub = engine.advertise('/frames', Frame), engine.subscribe('/frames')
frame = pub.loan(width=3)
frame.data = np.arange(3)
assert pub.push(frame)
with sub.borrow(1) as seen:
    print(f'{lot.__file__}: {seen.width} {np.asarray(seen.data).tolist()}')
    assert seen.data[2] == 2
