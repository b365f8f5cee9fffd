#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""A queue of tasks for three processes, of which one is killed at work: another one gets its task.

    tasks.py
"""

import multiprocessing
import os
import signal
import sys

import lot
import numpy as np

TASKS = 12


@lot.message
class Task:
    number: lot.u32
    samples: lot.vector[lot.f32]


@lot.message
class Result:
    number: lot.u32
    worker: lot.u32
    mean: lot.f32


def work(worker):
    """Takes tasks until one says that there are no more."""
    engine = lot.Engine(name=f'worker {worker}')
    tasks, results = engine.queue('tasks', Task, redeliver=True), engine.queue('results', Result)
    while True:
        with tasks.take() as task:  # an exception here, or a death, gives the task to another worker
            number = task.item.number
            if number == TASKS:
                tasks.put(tasks.loan(number=TASKS))  # for the next worker
                return
            if number == 3 and task.deliveries == 1:
                os.kill(os.getpid(), signal.SIGKILL)
            results.put(results.loan(number=number, worker=worker, mean=float(np.asarray(task.item.samples).mean())))


def main():
    os.environ.setdefault('LOT_SEGMENT', f'lot_tasks_{os.getpid()}')
    processes = multiprocessing.get_context('spawn')  # a child has an engine of its own
    workers = [processes.Process(target=work, args=(worker,)) for worker in range(3)]
    engine = lot.Engine()
    tasks, results = engine.queue('tasks', Task, redeliver=True), engine.queue('results', Result)
    for worker in workers:
        worker.start()
    for number in range(TASKS):
        task = tasks.loan(number=number)
        task.samples = np.full(1000, number, np.float32)
        tasks.put(task)
    means = {}
    for _ in range(TASKS):
        result = results.pop()
        means[result.number] = result.mean
        print(f'task {result.number}: {result.mean:g}, by worker {result.worker}', flush=True)
    tasks.put(tasks.loan(number=TASKS))  # not before: the task of a dead worker needs a live one
    for worker in workers:
        worker.join()
    print(f'{sum(worker.exitcode == -signal.SIGKILL for worker in workers)} worker was killed, {len(means)} tasks are done')
    return 0 if means == {number: number for number in range(TASKS)} else 1


if __name__ == '__main__':
    sys.exit(main())
