"""Sending much in small portions: after each control period, or by the clock where ticks may stand still."""

import asyncio
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TypeVar

PORTION_S = 0.002

T = TypeVar("T")


def shares(most: int, wanting: Sequence[T], turn: int) -> list[tuple[T, int]]:
    """Divides a portion of `most` messages among those that want to send; where they are more, they take turns."""
    count = len(wanting)
    if count <= most:
        return [(one, most // count) for one in wanting]
    return [(wanting[(turn + k) % count], 1) for k in range(most)]


class PacedSender:
    """Calls `portion` until it returns False: nothing more to send.

    In real time `tick`, called after each control period, does; in lockstep the event loop every two milliseconds.
    """

    def __init__(self, portion: Callable[[], bool], lockstep: bool) -> None:
        self._portion = portion
        self._lockstep = lockstep
        self._busy = False

    def start(self) -> None:
        """There is something to send; in lockstep the first portion goes now."""
        if self._lockstep:
            if not self._busy:
                self._by_clock()
        else:
            self._busy = True

    def tick(self) -> None:
        """A control period has ended."""
        if self._busy and not self._lockstep:
            self._busy = self._portion()

    def _by_clock(self) -> None:
        self._busy = self._portion()
        if self._busy:
            with suppress(RuntimeError):  # outside an event loop `start` is called for each portion
                asyncio.get_running_loop().call_later(PORTION_S, self._by_clock)
                return
            self._busy = False
