"""Fuzzing target: its first inputs, and the attempt with one input."""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path


@dataclass(frozen=True)
class Target:
    """One door of the product.

    `attempt` raises for a finding; `longest` is the length of the
    longest input [bytes].
    """

    name: str
    seeds: Callable[[], list[bytes]]
    attempt: Callable[[bytes], None]
    longest: int


@cache
def _folder() -> "tempfile.TemporaryDirectory[str]":
    return tempfile.TemporaryDirectory(prefix="twodof-fuzz-")


def file(name: str, data: bytes) -> Path:
    """A file with these bytes, until the next one of that name."""
    path = Path(_folder().name, name)
    path.write_bytes(data)
    return path
