"""Benchmarks against peers: `python -m bench` times the compiled closed loop, a fit and the start-up in one run."""
