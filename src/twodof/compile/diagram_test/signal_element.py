"""A signal, or one element of it, as a test names it: `y`, `part.port`, `v[2]`, `A[0, 1]` (row, column)."""

import re
from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray

from twodof.errors import DiagramError, shown

PATTERN = r"[A-Za-z][\w.]*(?:\[\s*\d{1,7}\s*(?:,\s*\d{1,7}\s*)?\])?"
_READ = re.compile(PATTERN, re.ASCII)

Index = tuple[int, ...]
"""() of a scalar, (i,) of a vector, (row, column) of a matrix; from 0 on."""


def parse_element(text: str, where: str) -> tuple[str, Index]:
    """The name (or path) and the index in `text`. Raises DiagramError if it is not such a text."""
    if not _READ.fullmatch(text):
        raise DiagramError(f"{shown(text)} is not the name of a signal", where, "write y, part.port, v[0] or A[0, 1]")
    name, _, index = text.partition("[")
    return name, tuple(int(i) for i in index.rstrip("]").split(",")) if index else ()


def check_index(index: Index, axes: tuple[int, ...], name: str, where: str) -> None:
    """Raise DiagramError if `index` is not that of one number in a value with these axes."""
    if len(index) != len(axes) or any(i >= n for i, n in zip(index, axes, strict=True)):
        size = " x ".join(map(str, axes))
        first = f"{name}[{', '.join('0' * len(axes))}]"
        raise DiagramError(
            f"it is an array of {size}" if axes else "it is not an array",
            where,
            f"name an element, {first}, from 0 on" if axes else f"write {name}",
        )


def element_of(signals: Mapping[str, NDArray[Any]], text: str, where: str) -> NDArray[Any]:
    """The values of the named signal's element, of shape (n,); the arrays have the steps as their first axis."""
    name, index = parse_element(text, where)
    values = signals[name]
    check_index(index, values.shape[1:], name, where)
    place: tuple[Any, ...] = (slice(None), *index)
    found: NDArray[Any] = values[place]
    return found
