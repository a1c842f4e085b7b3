"""Plain data: the numbers, texts and lists of Python that a declaration keeps and that JSON can write."""

from enum import IntEnum
from typing import Any

import numpy as np

from twodof.blocks.datatypes.bus import Bus
from twodof.blocks.datatypes.enumeration import Enumeration, enumeration_of
from twodof.errors import DiagramError

_KINDS = "biufU"  # of numpy's types: bool, integer, unsigned, real, text
MAX_DEPTH = 8  # of lists within lists
_SCALARS = frozenset((float, int, bool, str, type(None)))


def plain_data(value: Any, where: str, depth: int = 0) -> Any:
    """`value` with numpy's arrays and scalars turned into lists and numbers of Python, at any depth; the rest as it is.

    The numbers are the same ones: a float32 is a float64 too. Members of an enumeration become numbers, and an
    enumeration or a bus its plain form. Raises DiagramError, at `where`, for complex numbers and for arrays of what is
    not a number. It is also raised for lists within lists without end (`depth` counts them).
    """
    if type(value) in _SCALARS:
        return value
    if isinstance(value, (np.ndarray, np.generic)):
        if value.dtype.kind not in _KINDS:
            what = "an array" if isinstance(value, np.ndarray) else "a number"
            raise DiagramError(f"{what} of numpy's type {value.dtype} is given", where, "give real numbers")
        # A longdouble has no counterpart in Python.
        return (value.astype(np.float64) if value.dtype.kind == "f" else value).tolist()
    if isinstance(value, (list, tuple, range)):
        if _SCALARS.issuperset(map(type, value)):
            return list(value)
        if depth == MAX_DEPTH:
            raise DiagramError(f"lists within more than {MAX_DEPTH} lists", where, "give a number, a list or rows")
        return [plain_data(one, where, depth + 1) for one in value]
    if isinstance(value, IntEnum):
        return int(value)
    if isinstance(value, Bus):
        return value.form()
    if isinstance(value, (type, Enumeration)) and (enumeration := enumeration_of(value, where)) is not None:
        return enumeration.form()
    if isinstance(value, complex):
        raise DiagramError(f"the complex number {value} is given", where, "give real numbers")
    return value
