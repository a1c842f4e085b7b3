"""Channels: the space between two columns of a layout, in which each wire changes its height on a track of its own."""

from dataclasses import dataclass, field

TRACK = 11.0  # between two tracks
EDGE = 13.0  # between a column and the first track; an arrow's head must fit

Segment = tuple[float, float, float, float]
"""Piece of a wire: x1, y1, x2, y2; horizontal or vertical."""


Pin = tuple[int, float]
"""Index of a net, and the height at which it enters a channel."""


class _Trunk:
    """A net's vertical piece from `low` to `high`, or one of two where a net has to sidestep."""

    def __init__(self, net: int, left: list[float], right: list[float]) -> None:
        self.net = net
        self.left = left
        self.right = right
        self.low = min([*left, *right])
        self.high = max([*left, *right])
        self.track = 0


@dataclass(eq=False)
class WireChannel:
    """Channel with pins on its left and right side. Call `route`, then set `x`, its left edge, before `segments`."""

    left: list[Pin] = field(default_factory=list)
    right: list[Pin] = field(default_factory=list)
    x: float = 0.0
    trunks: list[_Trunk] = field(default_factory=list)
    straight: list[tuple[int, float]] = field(default_factory=list)
    tracks: int = 0

    def route(self) -> None:
        """Assign a track to each net that changes its height in the channel."""
        waiting = []
        for net in sorted({net for net, _ in (*self.left, *self.right)}):
            left, right = (sorted({y for k, y in pins if k == net}) for pins in (self.left, self.right))
            if len({*left, *right}) == 1:
                self.straight.append((net, left[0] if left else right[0]))
            else:
                waiting.append(_Trunk(net, left, right))
        self._assign(waiting)

    def _assign(self, waiting: list[_Trunk]) -> None:
        """Place the trunks from left to right: of those that may come next, the one with the fewest crossings."""
        costs, earlier = _costs(waiting), _earlier(waiting)
        while waiting:
            free = [t for t in waiting if not earlier[t]]
            if not free:
                self._sidestep(waiting)
                costs, earlier = _costs(waiting), _earlier(waiting)
                continue
            chosen = min(free, key=lambda t: (costs[t], t.low, t.net))
            waiting.remove(chosen)
            for t in waiting:
                earlier[t].discard(chosen)
                if _overlap(t, chosen):
                    costs[t] -= _crossed(t, chosen) - _crossed(chosen, t)
            beside = [t.track + 1 for t in self.trunks if _overlap(t, chosen) or _must_precede(t, chosen)]
            chosen.track = max(beside, default=0)
            self.trunks.append(chosen)
        self.tracks = max((t.track + 1 for t in self.trunks), default=0)

    def _sidestep(self, waiting: list[_Trunk]) -> None:
        """Two nets that swap their heights: one goes to a free height first."""
        taken = {y for t in (*waiting, *self.trunks) for y in (*t.left, *t.right)} | {y for _, y in self.straight}
        splittable = [t for t in waiting if t.left and t.right]
        trunk = min(splittable, key=lambda t: (t.high - t.low, t.net))
        via = 0.5 * (trunk.low + trunk.high)
        while any(abs(via - y) < 3.0 for y in taken):
            via += 1.5
        waiting.remove(trunk)
        waiting += [_Trunk(trunk.net, trunk.left, [via]), _Trunk(trunk.net, [via], trunk.right)]

    def width(self, outer: bool) -> float:
        """Return the channel's width; 0 for an outer channel without wires."""
        if outer and not self.tracks and not self.straight:
            return 0.0
        return 2.0 * EDGE + TRACK * max(self.tracks - 1, 0)

    def segments(self) -> dict[int, list[Segment]]:
        """Return the wire's pieces of each net, by its index."""
        found: dict[int, list[Segment]] = {}
        start, end = self.x, self.x + self.width(outer=True)
        sides = {net for net, _ in self.left} & {net for net, _ in self.right}
        for net, y in self.straight:
            if net in sides:
                found.setdefault(net, []).append((start, y, end, y))
        for t in self.trunks:
            x = self._track(t)
            pieces = found.setdefault(t.net, [])
            pieces.append((x, t.low, x, t.high))
            mates = [o for o in self.trunks if o.net == t.net and o is not t]
            for y in t.left:
                other = [o for o in mates if y in o.right]
                pieces.append((self._track(other[0]) if other else start, y, x, y))
            for y in t.right:
                if not any(y in o.left for o in mates):
                    pieces.append((x, y, end, y))
        return found

    def joints(self) -> list[tuple[float, float]]:
        """Return the points at which wires branch."""
        found = []
        for t in self.trunks:
            for y in sorted({*t.left, *t.right}):
                through = y not in (t.low, t.high)
                if through or (y in t.left and y in t.right):
                    found.append((self._track(t), y))
        return found

    def _track(self, t: _Trunk) -> float:
        return self.x + EDGE + TRACK * t.track


def _costs(trunks: list[_Trunk]) -> dict[_Trunk, int]:
    """For each trunk how many more crossings there are if it is left of all others than if it is right of them."""
    return {t: sum(_crossed(t, o) - _crossed(o, t) for o in trunks if o is not t and _overlap(t, o)) for t in trunks}


def _earlier(trunks: list[_Trunk]) -> dict[_Trunk, set[_Trunk]]:
    """For each trunk those that must be left of it."""
    return {t: {o for o in trunks if o is not t and _overlap(o, t) and _must_precede(o, t)} for t in trunks}


def _overlap(a: _Trunk, b: _Trunk) -> bool:
    return a.low - 4.0 < b.high and b.low - 4.0 < a.high


def _must_precede(a: _Trunk, b: _Trunk) -> bool:
    """Return True if a's trunk must be left of b's: otherwise pieces of the two would overlap."""
    if a.net == b.net:
        return any(y in b.left for y in a.right)
    return any(abs(y - z) < 3.0 for y in a.left for z in b.right)


def _crossed(a: _Trunk, b: _Trunk) -> int:
    """How many crossings there are if a's trunk is left of b's."""
    return sum(b.low < y < b.high for y in a.right) + sum(a.low < y < a.high for y in b.left)
