"""SummaryCache: what the list says of each log, computed once for each state of its file."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Awaitable, Callable
from typing import Any

MOST = 4000

Key = tuple[str, int, int]
"""Path, time of the last change [ns], bytes."""


class SummaryCache:
    """The last `MOST` summaries."""

    def __init__(self) -> None:
        self._kept: OrderedDict[Key, dict[str, Any]] = OrderedDict()

    async def get(self, key: Key, make: Callable[[], Awaitable[dict[str, Any]]]) -> dict[str, Any]:
        """The summary, by `make` where it is not known yet. Raises what that raises."""
        if key not in self._kept:
            self._kept[key] = await make()
            while len(self._kept) > MOST:
                self._kept.popitem(last=False)
        return self._kept[key]
