"""Repetitions: which commands were carried out a moment ago, so that one that comes again is not done again."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable

LATEST_TICKS = 125
"""Half a second: what comes again later is another command."""
MOST_REMEMBERED = 64


class DuplicateFilter:
    """Remembers what was accepted.

    A command is repeated if its sender says so (`confirmation` above 0), or if the network doubled its frame, which the
    frame's sequence number tells. In lockstep, where time may stand still between two sessions of a client that are
    equal to the frame, only the former counts.
    """

    def __init__(self, lockstep: bool) -> None:
        self._lockstep = lockstep
        self._accepted: OrderedDict[Hashable, int] = OrderedDict()  # what came -> tick

    def known(self, what: Hashable, confirmation: int, sequence: int, tick: int) -> bool:
        """Whether `what` was accepted a moment before `tick`, and this is it again."""
        copies = (what, confirmation > 0), ((what, sequence), not self._lockstep)
        return any(counts and 0 <= tick - self._accepted.get(key, tick + 1) <= LATEST_TICKS for key, counts in copies)

    def accepted(self, what: Hashable, sequence: int, tick: int) -> None:
        """Remembers that `what` was carried out."""
        for key in (what, (what, sequence)):
            self._accepted[key] = tick
            self._accepted.move_to_end(key)
        while len(self._accepted) > MOST_REMEMBERED:
            self._accepted.popitem(last=False)

    def clear(self) -> None:
        """Forgets everything: time begins anew."""
        self._accepted.clear()
