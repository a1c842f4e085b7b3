"""Benchmarks of the flight stack: links, drones in processes of their own, latencies."""
