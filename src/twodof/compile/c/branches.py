"""Branches: `if` statements around nodes of an expression graph that are needed under a condition only.

`where` reads one of its two values; `and` and `or` read the second one only if the first does not decide. Nodes that
one side of a choice alone reads move into an `if` if they cost enough. Other choices stay choices between two computed
values. Expressions have no effect, so both forms give the same bits.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from dataclasses import dataclass

from twodof.blocks.expressions.expr import LOOPS, Expr, node
from twodof.blocks.expressions.graph import CALL
from twodof.blocks.expressions.numbers import FLOATS

WORTH = 4  # operations from which on a branch costs less than computing what may not be read
SLOW = {"div": 4, "sqrt": 4, "call": CALL, **dict.fromkeys(LOOPS, CALL)}  # cost in simple operations
DEEPEST = 24  # branches within one another
TRUE, FALSE = (node("const", "bool", (), value) for value in (True, False))


@dataclass(frozen=True)
class Choice:
    """A choice that `where`, `and` or `or` makes by `condition`."""

    condition: Expr
    then: Expr
    otherwise: Expr


@dataclass(frozen=True, eq=False)
class Branch:
    """An `if` with the steps of each side, which gives nodes their values, by the choice of each on its condition."""

    choices: tuple[tuple[Expr, Choice], ...]
    then: Sequence[Step]
    otherwise: Sequence[Step]


Step = Expr | Branch
Conditions = frozenset[tuple[int, bool]]
NO_CONDITIONS: Conditions = frozenset()
MOST_CONDITIONS = 8  # that are followed for one value
Arguments = Callable[[Expr], Sequence[Expr]]


def decision(item: Expr, args: Sequence[Expr]) -> Choice | None:
    """Return the choice that a node with the arguments `args` makes, or None."""
    if item.op == "where":
        return Choice(*args)
    if item.op in ("and", "or") and item.kind == "bool":
        first, second = args
        return Choice(first, second, FALSE) if item.op == "and" else Choice(first, TRUE, second)
    return None


class _Place:
    """A side of a condition, within the place around it; without one, the place outside of all."""

    def __init__(self, condition: Expr = TRUE, around: _Place | None = None) -> None:
        self.condition = condition
        self.around = around or self
        self.depth: int = around.depth + 1 if around else 0

    def sides(self) -> Iterator[_Place]:
        """Yield the place, if it is a side, and the sides around it."""
        place = self
        while place is not OUTSIDE:
            yield place
            place = place.around

    def common(self, other: _Place) -> _Place:
        """Return the innermost place around both."""
        a, b = self, other
        while a is not b:
            a, b = (a.around, b) if a.depth > b.depth else (a, b.around)
        return a


OUTSIDE = _Place()


class Plan:
    """Plan of where each node is computed: its `steps` in order, and how many more `uses` a node has by its branches.

    In `order` the arguments, which `args` gives, come before their users. The nodes `always` are computed in any case;
    nodes with an id in `hand` are computed already. Signals with an id in `optional` may be left 0 under a condition
    that keeps all other nodes from reading them.
    """

    def __init__(
        self,
        order: Sequence[Expr],
        args: Arguments,
        always: Iterable[Expr],
        hand: Container[int],
        optional: Container[int],
    ) -> None:
        self.steps: Sequence[Step] = order
        self.uses = Counter[int]()
        if not any(item.op in ("where", "and", "or") for item in order):
            return
        self.order = [item for item in order if id(item) not in hand]
        self.args = {id(item): args(item) for item in self.order}
        self.rank = {id(item): i for i, item in enumerate(self.order)}
        found = ((id(item), decision(item, self.args[id(item)])) for item in self.order)
        self.decisions: dict[int, Choice] = {key: choice for key, choice in found if choice is not None}
        self.always = [id(item) for item in always]
        self._kept: list[Expr] = []
        self.apart: set[int] = set()  # conditions whose choices do not share branches
        self._leave_out(optional)
        self._place()
        self._drop_cheap()
        self._place()
        while self._mended():
            self._place()
        if self.sides:
            self.steps = [*(item for item in order if id(item) in hand), *self._level(OUTSIDE)]

    def _leave_out(self, optional: Container[int]) -> None:
        """Decide over signals that several branches read, all under one condition."""
        needs: dict[int, Conditions] = dict.fromkeys(self.always, NO_CONDITIONS)
        known = {id(item): item for item in self.order}
        for item in reversed(self.order):
            own = needs.get(id(item), NO_CONDITIONS)
            found = self.decisions.get(id(item))
            sides = {} if found is None else {id(found.then): True, id(found.otherwise): False}
            for a in self.args[id(item)]:
                here = own
                if found is not None and a is not found.condition and len(own) < MOST_CONDITIONS and len(sides) == 2:
                    here = own | self._meaning(found.condition, sides[id(a)])
                needs[id(a)] = needs[id(a)] & here if id(a) in needs else here
            before = [(self.rank[c], c, holds) for c, holds in own if c in known and self.rank[c] < self.rank[id(item)]]
            if before and id(item) in optional and found is None:
                _, condition, holds = min(before)
                (root,) = self.args[id(item)]
                zero = node("const", item.kind, (), 0.0 if item.kind in FLOATS else item.kind != "bool" and 0)
                self._kept.append(zero)
                choice = (root, zero) if holds else (zero, root)
                self.decisions[id(item)] = Choice(known[condition], *choice)

    def _meaning(self, condition: Expr, holds: bool) -> Conditions:
        """Return the nodes that hold, or do not hold, if a condition does: itself, and what it shows or negates."""
        found = {(id(condition), holds)}
        while condition.op in ("not", "signal") and self.args.get(id(condition)):
            holds = holds != (condition.op == "not")
            (condition,) = self.args[id(condition)]
            found.add((id(condition), holds))
        return frozenset(found)

    def _place(self) -> None:
        """Find the innermost place of each node that is around all of its readers, and the sides of each choice."""
        self.place = dict.fromkeys(self.always, OUTSIDE)
        self.reads: dict[int, list[Expr]] = {}
        self.sides: dict[int, tuple[_Place, _Place]] = {}
        self.branch: dict[_Place, tuple[_Place, _Place]] = {}  # the sides of which a place is one
        shared: dict[tuple[_Place, int, int | None], tuple[_Place, _Place]] = {}
        for item in reversed(self.order):
            own = self.place.setdefault(id(item), OUTSIDE)
            reads = [(a, own) for a in self.args[id(item)]]
            choice = self.decisions.get(id(item))
            if choice is not None and self._may_open(choice.condition, own):
                key = own, id(choice.condition), id(item) if id(choice.condition) in self.apart else None
                sides = shared.setdefault(key, (_Place(choice.condition, own), _Place(choice.condition, own)))
                self.sides[id(item)] = sides
                self.branch |= dict.fromkeys(sides, sides)
                reads = [(choice.condition, own), (choice.then, sides[0]), (choice.otherwise, sides[1])]
            reads = [(a, here) for a, here in reads if id(a) in self.rank]
            self.reads[id(item)] = [a for a, _ in reads]
            for a, here in reads:
                self.place[id(a)] = self.place.get(id(a), here).common(here)

    def _unit(self, item: Expr) -> int:
        """Return the key of what is computed together: a node by itself, or all that one branch gives."""
        return id(self.sides.get(id(item), item))

    def _may_open(self, condition: Expr, own: _Place) -> bool:
        """Return True if a branch on the condition may open in a place: no other one on it is around, and few are."""
        return own.depth < DEEPEST and all(place.condition is not condition for place in own.sides())

    def _spent(self) -> Counter[_Place]:
        """Return the operations within each side."""
        spent = Counter[_Place]()
        for item in self.order:
            for place in self.place[id(item)].sides():
                spent[place] += 0 if not self.args[id(item)] or item.op == "signal" else SLOW.get(item.op, 1)
        return spent

    def _drop_cheap(self) -> None:
        """Drop the choices on conditions whose branches save few operations."""
        saved = Counter[int]()
        for place, cost in self._spent().items():
            saved[id(place.condition)] += cost
        for key, choice in list(self.decisions.items()):
            if saved[id(choice.condition)] < WORTH:
                del self.decisions[key]

    def _mended(self) -> bool:
        """Order the nodes of each place; return True if choices were set apart, or dropped as cheap, for a new try.

        Choices on one condition in one place are made in one branch, unless one of them needs the value of another.
        """
        units: dict[int, list[Expr]] = {}  # nodes that are computed together
        needs: dict[int, list[Expr]] = {}
        for item in self.order:
            own, key = self.place[id(item)], self._unit(item)
            units.setdefault(key, []).append(item)
            for a in self.reads[id(item)]:
                at, here, user = self.place[id(a)], own, key
                while here.depth > at.depth:
                    user, here = id(self.branch[here]), here.around
                if here is at:  # else `a` is on a side of this choice
                    needs.setdefault(user, []).append(a)
        before = len(self.apart), len(self.decisions)
        self.levels: dict[_Place, list[list[Expr]]] = {}
        spent, done = self._spent(), set[int]()
        for root in (members[0] for members in units.values() if self._unit(members[0]) not in done):
            path = {self._unit(root): (root, iter(needs.get(self._unit(root), [])))}  # by what, and what is left
            while path:
                key, (first, left) = next(reversed(path.items()))
                needed = next((a for a in left if self._unit(a) not in done), None)
                if needed is None:
                    path.popitem()
                    done.add(key)
                    self.levels.setdefault(self.place[id(first)], []).append(units[key])
                    sides = self.sides.get(id(first), ())
                    if sides and len(units[key]) == 1 and sum(spent[side] for side in sides) < WORTH:
                        del self.decisions[id(first)]
                elif self._unit(needed) in path:
                    circle = [*path][[*path].index(self._unit(needed)) :]
                    shared = [self.sides[id(units[unit][0])] for unit in circle if len(units[unit]) > 1]
                    self.apart |= {id(side.condition) for side, _ in shared}
                else:
                    path[self._unit(needed)] = needed, iter(needs.get(self._unit(needed), []))
        return (len(self.apart), len(self.decisions)) != before

    def _level(self, place: _Place) -> list[Step]:
        """Return the steps that compute the nodes of a place."""
        found: list[Step] = []
        for group in self.levels.get(place, []):
            if (sides := self.sides.get(id(group[0]))) is None:
                found += group
                continue
            choices = tuple((item, self.decisions[id(item)]) for item in group)
            self.uses[id(sides[0].condition)] += 1 - sum(item.op != "signal" for item in group)
            found.append(Branch(choices, *map(self._level, sides)))
        return found
