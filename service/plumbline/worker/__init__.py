"""The worker process: stations' pipelines between the bus's raw chunks and its results.

Worker          takes its share of the stations, feeds them in receive order, publishes, checkpoints, takes over
merging         chunks of many streams into the order of their receive times (pure)
ownership       rendezvous hashing (pure)
station         one station's pipeline and its numbered messages
shared_books    ephemeris and correction books with their snapshots
processing      the pipeline as the worker sees it
"""

import os

for _name in ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # a worker is one of several: before NumPy is loaded

from plumbline.worker.worker import Worker  # noqa: E402

__all__ = ["Worker"]
