"""A constant added to a signal: the trim moment a record was flown about, the bias of a sensor."""

from __future__ import annotations

from typing import Any

from twodof.blocks.block import Block, Clock, library_block
from twodof.blocks.declarations import Param, Port


@library_block("models.Offset")
class Offset(Block):
    """y = u + sign * offset, in `unit`."""

    def __init__(self, unit: str = "", sign: float = 1.0) -> None:
        self.sign = sign
        self.inputs = (Port("u", unit=unit),)
        self.outputs = (Port("y", unit=unit),)
        self.params = (Param("offset", 0.0, unit=unit, text="constant part"),)

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """The sum."""
        return u.u + self.sign * p.offset
