#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""How late did the messages of a recording reach the recorder? Cells (# %%) as a notebook has them: run it whole, or
cell by cell in an editor.

    delays.py FILE [PLOT.png]      draws into PLOT.png where matplotlib is installed, else prints a histogram
"""

# %% What is in the recording?
import importlib.util
import sys

import lot
import numpy as np

recording = lot.Recording(sys.argv[1])
for topic in recording.topics:
    print(f'{topic.name}: {topic.messages} of {topic.type_name}, {topic.missed} missed')

# %% Delays in microseconds, by topic. No message is decoded for that. Of a publisher that does not stamp its messages
# (advertise(..., stamp=True)) the recorder writes its own time twice.
delays = {topic.name: [] for topic in recording.topics}
for message in recording:
    if message.log_time_ns != message.publish_time_ns:
        delays[message.topic].append((message.log_time_ns - message.publish_time_ns) / 1000)
for topic in [topic for topic, its in delays.items() if not its]:
    print(f'{topic}: unknown, no message has a stamp')
    del delays[topic]

# %% Figures
for topic, its in delays.items():
    middle, late, last = np.percentile(its, [50, 99, 100])
    print(f'{topic}: median {middle:.0f} us, p99 {late:.0f} us, max {last:.0f} us')

# %% A picture
if len(sys.argv) > 2 and importlib.util.find_spec('matplotlib'):
    import matplotlib
    matplotlib.use('Agg')
    from matplotlib import pyplot
    for topic, its in delays.items():
        pyplot.plot(its, '.', label=topic)
    pyplot.xlabel('message')
    pyplot.ylabel('delay, us')
    pyplot.legend()
    pyplot.savefig(sys.argv[2])
else:
    for topic, its in delays.items():
        counts, edges = np.histogram(its, bins=10)
        for count, edge in zip(counts, edges):
            print(f'{edge:10.0f} us {"#" * round(60 * count / max(counts))}')
