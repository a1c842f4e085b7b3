"""Benchmarks against peers: `python -m bench` times the compiled closed loop, a fit and the start-up in one run."""

import os

# Before numpy is loaded: the threads of its linear algebra wait for each other where a benchmark keeps to one core.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
