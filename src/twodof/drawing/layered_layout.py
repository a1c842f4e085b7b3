"""Layered layout of a block diagram: boxes in columns, and wires of horizontal and vertical pieces.

Sugiyama's method (Sugiyama, Tagawa, Toda, IEEE Trans. SMC 11-2, 1981) for boxes with pins. Feedback wires are left out
first. A box's column is the length of the longest path to it; crossings are reduced by barycentres; heights are chosen
so that wires are straight. Feedback wires then run below the boxes that they pass. `wire_channels` draws the wires
between two columns.

The library `grandalf` is not used because it has no pins and right angles: it draws 19 of the flight core's 42 wires
through boxes, in two to four times the time. `dot` of Graphviz ignores pins when it draws right angles.
"""

from bisect import bisect_right, insort
from collections.abc import Sequence
from dataclasses import dataclass, field
from graphlib import TopologicalSorter

import numpy as np

from twodof.drawing.wire_channels import Segment, WireChannel

SWEEPS = 12  # of crossing reduction, and of aligning heights
APART = 22.0  # between boxes of a column
TERMINALS_APART = 4.0
NEAR = 30.0  # how far a box may be from where its author put it, to make a wire straight
LANE = 12.0  # between a wire that passes and what is beside it; with half a terminal the distance of two ports
MARGIN = 16.0


@dataclass
class Box:
    """A box of the layout. `left` and `right` are the distances of its pins below its top, whole numbers.

    `side` "in" or "out" marks a terminal; `preferred` is the position (x, y) in the author's diagram, None without one.
    """

    width: float
    height: float
    left: list[float] = field(default_factory=list)
    right: list[float] = field(default_factory=list)
    side: str = ""
    preferred: tuple[float, float] | None = None


@dataclass(frozen=True)
class Net:
    """A net: the indices (box, right pin) of its source, and (box, left pin) of each pin that it drives."""

    source: tuple[int, int]
    sinks: tuple[tuple[int, int], ...]


@dataclass
class GraphLayout:
    """A layout: upper left corner of each box, pieces of each net's wire, branching points, and size of the drawing."""

    corners: list[tuple[float, float]]
    wires: list[list[Segment]]
    joints: list[tuple[float, float]]
    width: float
    height: float


@dataclass(eq=False)
class _Item:
    """A box or a passing wire in a column."""

    box: int = -1
    y: float = 0.0
    height: float = 0.0


_Link = tuple[_Item, float, _Item, float]
"""A wire between two columns: item and pin's distance below its top, on the left and on the right."""


def layout(boxes: Sequence[Box], nets: Sequence[Net], border: bool = False) -> GraphLayout:
    """Place `boxes` and route `nets`; the same arguments give the same layout.

    With `border` all terminals are at the left and right edge, as for the frame of a sub-diagram.
    """
    if not boxes:
        return GraphLayout([], [], [], 2 * MARGIN, 2 * MARGIN)
    return _Layered(boxes, nets, border).run()


class _Layered:
    def __init__(self, boxes: Sequence[Box], nets: Sequence[Net], border: bool) -> None:
        self.boxes = boxes
        self.nets = nets
        self.border = border
        self.edges = sorted({(n.source[0], b) for n in nets for b, _ in n.sinks if n.source[0] != b})
        self.rank: list[int] = []
        self.columns: list[list[_Item]] = []
        self.item_of = [_Item(i, height=b.height) for i, b in enumerate(boxes)]
        self.author = {self.item_of[i]: b.preferred[1] for i, b in enumerate(boxes) if b.preferred is not None}
        self.preferred: dict[_Item, float] = {}  # the author's heights, and those that they mean for the others
        self.lanes: dict[tuple[int, int], _Item] = {}  # (net, column) -> passing wire, forward
        self.returns: dict[int, range] = {}  # net -> columns that it passes on its way back
        self.passing: dict[tuple[int, int], float] = {}  # (net, column) -> height of a passing wire

    def run(self) -> GraphLayout:
        self.rank = self._preferred_ranks() if self.author else self._ranks()
        self._fill_columns()
        if self.author:
            self._order_by_preference()
        else:
            self._reduce_crossings()
        self._heights()
        self._return_lanes()
        return self._draw()

    # Columns

    def _ranks(self) -> list[int]:
        inner = [i for i, b in enumerate(self.boxes) if not b.side]
        component = _components(len(self.boxes), self.edges)
        before: dict[int, list[int]] = {i: [] for i in inner}
        after: dict[int, list[int]] = {i: [] for i in inner}
        for a, b in self.edges:
            forward = component[a] != component[b] or a < b
            if forward and a in after and b in before:
                before[b].append(a)
                after[a].append(b)
        rank = dict.fromkeys(inner, 0)
        order = list(TopologicalSorter(before).static_order())
        for i in order:
            rank[i] = 1 + max((rank[j] for j in before[i]), default=-1)
        for i in reversed(order):  # what is needed late only, such as a constant, stands late
            if after[i] and len(after[i]) >= len(before[i]):
                rank[i] = max(rank[i], min(rank[j] for j in after[i]) - 1)
        return self._with_terminals(rank)

    def _with_terminals(self, rank: dict[int, int]) -> list[int]:
        """Return the columns with each terminal beside the box that it serves, or at the edges."""
        last = max(rank.values(), default=0)
        fed: dict[int, list[int]] = {}
        feeding: dict[int, list[int]] = {}
        for a, b in self.edges:
            feeding.setdefault(a, []).append(b)
            fed.setdefault(b, []).append(a)
        for i, box in enumerate(self.boxes):
            if box.side == "in":
                users = [rank[j] for j in feeding.get(i, ()) if j in rank]
                rank[i] = -1 if self.border else min(users, default=0) - 1
        for i, box in enumerate(self.boxes):
            if box.side == "out":
                (source,) = fed.get(i, [-1])[:1]
                beside = rank.get(source, last) + 1
                rank[i] = last + 1 if self.border or last + 1 - beside <= 2 else beside
        least = min(rank.values())
        return [rank[i] - least for i in range(len(self.boxes))]

    def _preferred_ranks(self) -> list[int]:
        """Columns from the author's places: boxes whose widths overlap share one."""
        placed = sorted((b.preferred[0], i) for i, b in enumerate(self.boxes) if b.preferred is not None)
        rank: dict[int, int] = {}
        column, right = -1, float("-inf")
        for x, i in placed:
            if x >= right:
                column, right = column + 1, x + 0.5 * self.boxes[i].width
            rank[i] = column
        for _ in range(len(self.boxes)):
            found = {}
            for i, box in enumerate(self.boxes):
                if i not in rank and not box.side:
                    before = [rank[a] for a, b in self.edges if b == i and a in rank]
                    after = [rank[b] for a, b in self.edges if a == i and b in rank]
                    if before or after:
                        found[i] = max(before) + 1 if before else min(after) - 1
            if not found:
                break
            rank |= found
        for i, box in enumerate(self.boxes):
            if i not in rank and not box.side:
                rank[i] = 0
        return self._with_terminals(rank)

    def _fill_columns(self) -> None:
        self.columns = [[] for _ in range(max(self.rank) + 1)]
        for i in range(len(self.boxes)):
            self.columns[self.rank[i]].append(self.item_of[i])
        for k, net in enumerate(self.nets):
            start = self.rank[net.source[0]]
            ends = [self.rank[b] for b, _ in net.sinks]
            for r in range(start + 1, max([e for e in ends if e > start], default=start)):
                self.lanes[k, r] = _Item()
                self.columns[r].append(self.lanes[k, r])
            back = [e for e in ends if e <= start]
            if back:
                self.returns[k] = range(min(back), start + 1)

    # Order within columns

    def _links(self, column: int) -> list[_Link]:
        """Wires from column - 1 to `column`, feedback apart."""
        found = []
        for k, net in enumerate(self.nets):
            box, pin = net.source
            if self.rank[box] == column - 1:
                left, at = self.item_of[box], self.boxes[box].right[pin]
            elif (k, column - 1) in self.lanes:
                left, at = self.lanes[k, column - 1], 0.0
            else:
                continue
            if (k, column) in self.lanes:
                found.append((left, at, self.lanes[k, column], 0.0))
            for b, p in net.sinks:
                if self.rank[b] == column:
                    found.append((left, at, self.item_of[b], self.boxes[b].left[p]))
        return found

    def _reduce_crossings(self) -> None:
        links = [self._links(c) for c in range(len(self.columns))]
        place = {item: float(j) for column in self.columns for j, item in enumerate(column)}
        best, least = [list(c) for c in self.columns], _crossings(links, place)
        for sweep in range(SWEEPS):
            forward = sweep % 2 == 0
            columns = range(1, len(self.columns)) if forward else range(len(self.columns) - 2, -1, -1)
            for c in columns:
                pulls: dict[_Item, list[float]] = {}
                for a, pa, b, pb in links[c] if forward else links[c + 1]:
                    mine, other, at = (b, a, pa) if forward else (a, b, pb)
                    pulls.setdefault(mine, []).append(place[other] + at / (other.height + 1.0))
                key = {i: sum(pulls[i]) / len(pulls[i]) if i in pulls else place[i] for i in self.columns[c]}
                self.columns[c].sort(key=key.__getitem__)
                place |= {item: float(j) for j, item in enumerate(self.columns[c])}
            now = _crossings(links, place)
            if now < least:
                best, least = [list(c) for c in self.columns], now
        self.columns = best

    def _order_by_preference(self) -> None:
        """Order columns by the author's heights; a box without one takes its neighbours'."""
        preferred = dict(self.author)
        links = [link for c in range(len(self.columns)) for link in self._links(c)]
        for _ in range(len(self.columns) + 1):
            pulls: dict[_Item, list[float]] = {}
            for a, pa, b, pb in links:
                for mine, at_mine, other, at_other in ((a, pa, b, pb), (b, pb, a, pa)):
                    if mine not in preferred and other in preferred:
                        pulls.setdefault(mine, []).append(preferred[other] + at_other - at_mine)
            preferred |= {item: sum(found) / len(found) for item, found in pulls.items()}
        self.preferred = preferred
        for column in self.columns:
            column.sort(key=lambda item: preferred.get(item, 0.0))

    # Heights

    def _heights(self) -> None:
        links = [self._links(c) for c in range(len(self.columns))]
        for column in self.columns:
            offsets = self._offsets(column)
            for item, y in zip(column, offsets, strict=True):
                item.y = self.preferred.get(item, y)
            if self.author:
                _settle(column, offsets, {item: [(item.y, 1.0)] for item in column})
        for sweep in range(SWEEPS):
            columns = range(len(self.columns)) if sweep % 2 == 0 else range(len(self.columns) - 1, -1, -1)
            last = sweep >= SWEEPS - 2 or self.author
            for c in columns:
                wants: dict[_Item, list[tuple[float, float]]] = {}
                if sweep % 2 == 0 or last:
                    for a, pa, b, pb in links[c]:
                        wants.setdefault(b, []).append((a.y + pa - pb, self._weight(a, b)))
                if (sweep % 2 == 1 or last) and c + 1 < len(links):
                    for a, pa, b, pb in links[c + 1]:
                        wants.setdefault(a, []).append((b.y + pb - pa, self._weight(a, b)))
                for item in (i for i in self.columns[c] if i in self.author):
                    # Near the author's place; as far off it as makes a wire straight.
                    near = [(y, w) for y, w in wants.get(item, []) if abs(y - self.author[item]) <= NEAR]
                    wants[item] = near or [(self.author[item], 1.0)]
                _settle(self.columns[c], self._offsets(self.columns[c]), wants)

    def _offsets(self, column: Sequence[_Item]) -> list[float]:
        """How far below the column's top each item is when all stand as near as they may."""
        offset, offsets = 0.0, []
        for above, item in zip([None, *column], column, strict=False):
            offset += self._gap(above, item) + (above.height if above else 0.0)
            offsets.append(offset)
        return offsets

    def _gap(self, above: _Item | None, below: _Item) -> float:
        if above is None:
            return 0.0
        if above.box < 0 or below.box < 0:
            return LANE
        sides = [bool(self.boxes[item.box].side) for item in (above, below)]
        return TERMINALS_APART if all(sides) else LANE if any(sides) else APART

    def _weight(self, a: _Item, b: _Item) -> float:
        """Wires that only pass are kept straightest, then those between boxes; terminals go where there is room."""
        sides = sum(1.0 for item in (a, b) if item.box < 0)
        if any(item.box >= 0 and self.boxes[item.box].side for item in (a, b)):
            return 0.2 + 0.3 * sides
        if sides:
            return 8.0 if sides == 2.0 else 2.0
        slim = [item for item in (a, b) if len(self.boxes[item.box].left) <= 1]
        return 1.0 + len(slim)

    def _return_lanes(self) -> None:
        """Feedback below what it passes, short ways first."""
        top = min(item.y for column in self.columns for item in column)
        for column in self.columns:
            for item in column:
                item.y = round(item.y - top + MARGIN)
        bottom = [max((i.y + i.height for i in column), default=0.0) for column in self.columns]
        self.passing = {place: item.y for place, item in self.lanes.items()}
        for k in sorted(self.returns, key=lambda k: (len(self.returns[k]), k)):
            y = max(bottom[r] for r in self.returns[k]) + LANE + 3.0
            for r in self.returns[k]:
                self.passing[k, r] = bottom[r] = y

    # Wires

    def _draw(self) -> GraphLayout:
        count = len(self.columns)
        channels = [WireChannel() for _ in range(count + 1)]  # channel c is left of column c
        ends_at = [(k, *net.source, True) for k, net in enumerate(self.nets)]
        ends_at += [(k, b, p, False) for k, net in enumerate(self.nets) for b, p in net.sinks]
        heights = [
            self.item_of[b].y + (self.boxes[b].right if out else self.boxes[b].left)[p] for _, b, p, out in ends_at
        ]
        for (k, b, _, out), y in zip(ends_at, heights, strict=True):
            (channels[self.rank[b] + 1].left if out else channels[self.rank[b]].right).append((k, y))
        for (k, r), y in self.passing.items():
            channels[r].right.append((k, y))
            channels[r + 1].left.append((k, y))
        x = MARGIN
        starts, ends = [0.0] * count, [0.0] * count
        for c, channel in enumerate(channels):
            channel.route()
            channel.x = x
            x += channel.width(outer=c in (0, count))
            if c < count:
                starts[c] = x
                x += max((self.boxes[i.box].width for i in self.columns[c] if i.box >= 0), default=0.0)
                ends[c] = x
        corners = []
        for i, box in enumerate(self.boxes):
            c = self.rank[i]
            room = ends[c] - starts[c] - box.width
            shift = {"in": room, "out": 0.0}.get(box.side, 0.5 * room)
            corners.append((starts[c] + round(shift), self.item_of[i].y))
        wires: list[list[Segment]] = [[] for _ in self.nets]
        joints: list[tuple[float, float]] = []
        for channel in channels:
            for k, segments in channel.segments().items():
                wires[k] += segments
            joints += channel.joints()
        # From boxes to the edges of their columns, and across the columns that a wire passes.
        for (k, b, _, out), y in zip(ends_at, heights, strict=True):
            edges = (
                (corners[b][0] + self.boxes[b].width, ends[self.rank[b]])
                if out
                else (starts[self.rank[b]], corners[b][0])
            )
            wires[k].append((edges[0], y, edges[1], y))
        for (k, r), y in self.passing.items():
            wires[k].append((starts[r], y, ends[r], y))
        bottom = [i.y + i.height for column in self.columns for i in column]
        bottom += [*self.passing.values(), *(max(y1, y2) for wire in wires for _, y1, _, y2 in wire)]
        return GraphLayout(corners, wires, joints, x + MARGIN, max(bottom) + MARGIN)


def _settle(column: Sequence[_Item], offsets: Sequence[float], wants: dict[_Item, list[tuple[float, float]]]) -> None:
    """Heights as near as can be to those wanted, in the column's order: least sum of weighted distances.

    Pool adjacent violators (Barlow et al., Statistical Inference under Order Restrictions, 1972) on heights from
    which the room needed above, `offsets`, is taken.
    """
    pools: list[tuple[float, list[tuple[float, float]], int]] = []
    for item, shift in zip(column, offsets, strict=True):
        wanted = [(y - shift, w) for y, w in wants.get(item, [(item.y, 0.05)])]
        pool = _median(wanted), wanted, 1
        while pools and pools[-1][0] > pool[0]:
            _, others, count = pools.pop()
            wanted = [*others, *pool[1]]
            pool = _median(wanted), wanted, count + pool[2]
        pools.append(pool)
    heights = [y for y, _, count in pools for _ in range(count)]
    for item, y, shift in zip(column, heights, offsets, strict=True):
        item.y = float(round(y + shift))


def _median(wanted: list[tuple[float, float]]) -> float:
    ordered = sorted(wanted)
    half, so_far = 0.5 * sum(w for _, w in ordered), 0.0
    for y, w in ordered:
        so_far += w
        if so_far >= half:
            return y
    return ordered[-1][0]


def _crossings(links: Sequence[Sequence[_Link]], place: dict[_Item, float]) -> int:
    """Return the number of pairs of wires that cross between columns."""
    total = 0
    for column in links:
        seen: list[tuple[float, float]] = []
        for _, _, b, pb in sorted((place[a], pa, place[b], pb) for a, pa, b, pb in column):
            total += len(seen) - bisect_right(seen, (b, pb))
            insort(seen, (b, pb))
    return total


def _components(count: int, edges: Sequence[tuple[int, int]]) -> list[int]:
    """Strongly connected components: a number for each node."""
    rows, columns = np.array(edges, dtype=int).reshape(-1, 2).T
    from scipy.sparse import coo_array  # imported late: most commands start without it
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(edges)), (rows, columns)), shape=(count, count))
    component: list[int] = connected_components(graph, connection="strong")[1].tolist()
    return component
