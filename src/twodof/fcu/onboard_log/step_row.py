"""A step as one row of bytes: what the control loop hands to the on-board log, and how it stands in the ULog."""

from dataclasses import fields
from operator import attrgetter
from struct import Struct
from typing import get_type_hints

import numpy as np

from twodof.fcu.control.control_input import ControlInput
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.control.hardware import SensorSample
from twodof.flightlog.steps import ASKED, STEP_TOPIC
from twodof.signals import TICK_US

__all__ = ["FORMAT", "ROW", "STEP_TOPIC", "pack", "row_names"]

_CODES = {float: ("d", "double", "<f8"), bool: ("?", "bool", "u1"), int: ("i", "int32_t", "<i4")}
_PARTS = ("tick", "sample", "asked")


def _columns() -> list[tuple[str, type]]:
    """Name and type of each number of a step, in order; what was asked for is `asked_...`, as x0 is an output too."""
    sample, asked, step = get_type_hints(SensorSample), get_type_hints(ControlInput), get_type_hints(ControlStep)
    return [
        *((name, sample[name]) for name in SensorSample._fields),
        *((ASKED + name, asked[name]) for name in ControlInput._fields),
        *((field.name, step[field.name]) for field in fields(ControlStep) if field.name not in _PARTS),
    ]


COLUMNS = _columns()
FORMAT = "uint64_t timestamp;uint32_t tick;" + "".join(f"{_CODES[kind][1]} {name};" for name, kind in COLUMNS)
"""How ULog describes a row: every number in the precision in which it was computed."""
ROW = np.dtype([("timestamp", "<u8"), ("tick", "<u4"), *((name, _CODES[kind][2]) for name, kind in COLUMNS)])
"""The same for numpy, without padding."""

_PACK = Struct("<QI" + "".join(_CODES[kind][0] for _, kind in COLUMNS))
_TICK_BITS = 0xFFFFFFFF  # it runs over after 198 days, the timestamp does not
_MADE = attrgetter(*(field.name for field in fields(ControlStep) if field.name not in _PARTS))


def pack(step: ControlStep) -> bytes:
    """The row of a step. Raises struct.error for a number that does not fit, which no step has."""
    return _PACK.pack(TICK_US * step.tick, step.tick & _TICK_BITS, *step.sample, *step.asked, *_MADE(step))


def row_names() -> tuple[str, ...]:
    """Names of the columns behind `timestamp` and `tick`."""
    return tuple(name for name, _ in COLUMNS)
