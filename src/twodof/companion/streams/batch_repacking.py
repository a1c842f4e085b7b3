"""Full-rate batches for several clients: the vehicle sends the channels of all of them, each gets its own.

What a client gets is what the vehicle would have sent to it alone: its channels at its ticks, as many rows in a message
as fit. Numbers are copied as bytes, so that they stay the very same, NaN included.
"""

import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from twodof.companion.client import CompanionClient, Wish
from twodof.companion.frame_fields import BATCH
from twodof.companion.streams.rate_profiles import OFF
from twodof.link.mavlink.framing import Frame
from twodof.link.mavlink.messages import BATCH_VALUES, message
from twodof.signals import TICK_US

# The vehicle lets no row wait longer than .1 s for a message to be full.
LATEST_TICKS = 25
MOST_EVERY = 255
_HEAD = struct.Struct("<QI")
_TAIL = struct.Struct("<BB")
_SIZE = _HEAD.size + 4 * BATCH_VALUES + _TAIL.size


def ticks(interval: int) -> int:
    """Ticks from a sample to the next for an interval [us], 1 to 255."""
    return min(max(round(interval / TICK_US), 1), MOST_EVERY)


def together(wishes: Sequence[Wish]) -> Wish:
    """What the vehicle must send so that every one of these can be had of it exactly."""
    wanted = [wish for wish in wishes if wish.interval != OFF and wish.mask]
    mask = 0
    for wish in wanted:
        mask |= wish.mask
    if not wanted or mask.bit_count() > BATCH_VALUES:
        return Wish(OFF)
    return Wish(math.gcd(*(ticks(wish.interval) for wish in wanted)) * TICK_US, mask)


@lru_cache(maxsize=256)  # who asks chooses the masks
def _columns(theirs: int, ours: int) -> struct.Struct:
    """Cuts the channels of mask `ours` out of a row of mask `theirs`."""
    bits = [1 << place for place in range(theirs.bit_length()) if theirs >> place & 1]
    return struct.Struct("<" + "".join("4s" if bit & ours else "4x" for bit in bits))


@dataclass(slots=True)
class _Packing:
    """Rows that wait until a message of a client is full."""

    mask: int
    every: int
    tick: int = 0
    rows: list[bytes] = field(default_factory=list)


class BatchRepacker:
    """Packs anew. `send(client, message)` sends in the vehicle's name, `deliver(client, frame)` a frame as it is."""

    def __init__(
        self, send: Callable[[CompanionClient, Any], None], deliver: Callable[[CompanionClient, Frame], None]
    ) -> None:
        self._send = send
        self._deliver = deliver
        self._packings: dict[CompanionClient, _Packing] = {}

    def take(self, frame: Frame, clients: Sequence[CompanionClient], own_words: bool) -> None:
        """A batch of the vehicle. Without `own_words` (it is signed, and we have no key) all get it as it is."""
        payload = frame.payload[:_SIZE].ljust(_SIZE, b"\0")
        mask, tick = _HEAD.unpack_from(payload)
        rows, every = _TAIL.unpack_from(payload, _SIZE - _TAIL.size)
        width = mask.bit_count()
        if not 1 <= width <= BATCH_VALUES or not every:
            return
        values = payload[_HEAD.size : _HEAD.size + 4 * width * min(rows, BATCH_VALUES // width)]
        for client in clients:
            wish = client.wishes.get(BATCH)
            if wish is None or wish.interval == OFF:
                continue
            chosen = wish.mask & mask
            packing = self._packings.get(client)
            waits = packing is not None and bool(packing.rows)
            same = chosen == mask and ticks(wish.interval) == every and not waits
            if same or not own_words:
                self._deliver(client, frame)
            elif chosen:
                self._repack(client, chosen, max(ticks(wish.interval), every), mask, tick, every, values)

    def flush(self, client: CompanionClient) -> None:
        """Send what waits for a client."""
        packing = self._packings.get(client)
        if packing is None or not packing.rows:
            return
        raw = b"".join(packing.rows)
        numbers = struct.unpack(f"<{len(raw) // 4}f", raw)
        fields = {"channels": packing.mask, "tick": packing.tick, "every": packing.every, "rows": len(packing.rows)}
        packing.rows = []
        self._send(client, message("TWODOF_BATCH", values=numbers, **fields))

    def flush_all(self) -> None:
        """Send what waits: time stands still until somebody grants more."""
        for client in self._packings:
            self.flush(client)

    def forget(self, client: CompanionClient) -> None:
        """A client has gone."""
        self._packings.pop(client, None)

    def _repack(
        self, client: CompanionClient, chosen: int, every: int, mask: int, tick: int, step: int, values: bytes
    ) -> None:
        packing = self._packings.get(client)
        if packing is None or (packing.mask, packing.every) != (chosen, every):
            self.flush(client)
            packing = self._packings[client] = _Packing(chosen, every)
        full = max(1, min(BATCH_VALUES // chosen.bit_count(), LATEST_TICKS // every + 1))
        for place, row in enumerate(_columns(mask, chosen).iter_unpack(values)):
            now = (tick + place * step) & 0xFFFFFFFF
            if now % every:  # the vehicle's rows are at multiples of `every`, and so are ours
                continue
            if packing.rows and now != packing.tick + len(packing.rows) * every:  # one was lost: a gap stays a gap
                self.flush(client)
            if not packing.rows:
                packing.tick = now
            packing.rows.append(b"".join(row))
            if len(packing.rows) == full:
                self.flush(client)
