"""Lowering of a diagram to a program: check, flatten, order, lay out in memory."""
