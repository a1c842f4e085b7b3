"""Emission of readable C99 from a program."""
