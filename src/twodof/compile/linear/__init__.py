"""Linearization: the exact A, B, C, D of a diagram at an operating point."""
