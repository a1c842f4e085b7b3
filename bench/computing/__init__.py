"""Benchmarks of compiled programs, of fits and of the start-up."""
