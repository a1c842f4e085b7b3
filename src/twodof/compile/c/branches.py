"""Branches: `if` statements around nodes of an expression graph that are needed under a condition only.

`where` reads one of its two values; `and` and `or` read the second one only if the first does not decide. Nodes that
one side alone reads move into an `if` if they cost enough, together with all choices on the same condition. Other
choices stay choices between two computed values. Expressions have no effect, so both forms give the same bits.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

from twodof.blocks.expressions.expr import LOOPS, Expr, node
from twodof.blocks.expressions.graph import CALL, walk
from twodof.blocks.expressions.numbers import FLOATS

WORTH = 10  # operations from which on a branch costs less than computing what may not be read
WORTH_OF_FLAG = 4  # where the processor guesses right: a mode or a flag seldom changes, two reals are seldom the same
SLOW = {"div": 4, "sqrt": 4, "call": CALL}  # cost in simple operations
DEEPEST = 24  # branches within one another
MOST_ALIKE = 32  # choices that are tried for sharing one branch
WALKED = 20  # nodes visited for each node of the graph, in the search for choices that share a branch
TRUE, FALSE = (node("const", "bool", (), value) for value in (True, False))


@dataclass(frozen=True)
class Choice:
    """A choice that `where`, `and` or `or` makes by `condition`."""

    condition: Expr
    then: Expr
    otherwise: Expr


@dataclass(frozen=True, eq=False)
class Branch:
    """An `if` with the steps of each side, which gives the nodes `chosen` their values, by the choice of each."""

    condition: Expr
    chosen: tuple[Expr, ...]
    choices: tuple[Choice, ...]
    then: tuple[Step, ...]
    otherwise: tuple[Step, ...]


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


@dataclass(frozen=True, eq=False)
class _Place:
    """A side of a condition (where it holds, or not), within the place around it; None stands for outside of all."""

    around: _Place | None
    condition: Expr
    holds: bool
    depth: int


def _common(a: _Place | None, b: _Place | None) -> _Place | None:
    """Return the innermost place around both."""
    while a is not b:
        if b is None or (a is not None and a.depth > b.depth):
            a = a.around if a is not None else None
        elif a is None or b.depth > a.depth:
            b = b.around
        else:
            a, b = a.around, b.around
    return a


class Plan:
    """Plan of where each node is computed, and in which order.

    In `order` the arguments, which `args` gives, come before their users. The nodes `always` are computed in any case;
    nodes with an id in `hand` are computed already. Signals with an id in `optional` may be left 0 under a condition
    that keeps all other nodes from reading them. `in_loop` tells that the steps are those of a loop's body.
    """

    def __init__(
        self,
        order: Sequence[Expr],
        args: Arguments,
        always: Iterable[Expr],
        hand: Container[int],
        optional: Container[int],
        in_loop: bool,
    ) -> None:
        self.given = order
        self.order = [item for item in order if id(item) not in hand]
        self.hand = hand
        self.worth: set[int] = set()
        if not any(item.op in ("where", "and", "or") for item in order):
            return
        self.args: dict[int, tuple[Expr, ...]] = {}
        self.decisions: dict[int, Choice] = {}
        self.known: set[int] = set()  # nodes that cost nothing
        self.flags: dict[int, bool] = {}  # True if a node depends on no real number
        for item in self.order:
            below = args(item)
            if not below:
                self.known.add(id(item))
            found = decision(item, below) if below else None
            if found is not None:
                self.decisions[id(item)] = found
            self.args[id(item)] = tuple(a for a in below if id(a) not in hand)
            flags = (self.flags.get(id(a), a.kind not in FLOATS) for a in below)
            self.flags[id(item)] = item.kind not in FLOATS and item.width is None and all(flags)
        self.always = {id(item) for item in always}
        self.rank = {id(item): i for i, item in enumerate(self.order)}
        self._kept: list[Expr] = []
        self.clashing: set[int] = set()  # conditions of which two branches share a node
        self._leave_out(optional)
        self.worth = {id(d.condition) for d in self.decisions.values()}
        self.places: dict[tuple[_Place | None, int, bool], _Place] = {}
        self._place()
        self.worth = self._worthwhile(in_loop)

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
                (root,) = self.args[id(item)] or (None,)
                zero = node("const", item.kind, (), 0.0 if item.kind in FLOATS else item.kind != "bool" and 0)
                if root is not None:
                    self._kept.append(zero)
                    choice = (root, zero) if holds else (zero, root)
                    self.decisions[id(item)] = Choice(known[condition], *choice)

    def _meaning(self, condition: Expr, holds: bool) -> Conditions:
        """Return the conditions that must all hold, or not hold, for one."""
        found: set[tuple[int, bool]] = set()
        stack = [(condition, holds)]
        while stack and len(found) < MOST_CONDITIONS:
            item, wanted = stack.pop()
            if item.op == "not":
                stack.append((item.args[0], not wanted))
                continue
            if (id(item), wanted) in found:
                continue
            found.add((id(item), wanted))
            if item.op == ("and" if wanted else "or") and item.kind == "bool":
                stack += [(a, wanted) for a in item.args]
            elif item.op == "signal":
                stack += [(a, wanted) for a in self.args.get(id(item), ())]
        return frozenset(found)

    def _place(self) -> None:
        """Find the innermost place of each node that is around all of its readers."""
        self.opening: set[int] = set()  # nodes whose sides stand in places of their own
        place: dict[int, _Place | None] = dict.fromkeys(self.always)
        for item in reversed(self.order):
            for a, here in self._reads(item, place.setdefault(id(item), None)):
                place[id(a)] = _common(place[id(a)], here) if id(a) in place else here
        self.place = place

    def _reads(self, item: Expr, own: _Place | None) -> Iterator[tuple[Expr, _Place | None]]:
        """Yield the arguments of a node in the place `own`, each with the place where it is read."""
        found = self.decisions.get(id(item))
        if found is None or id(found.condition) not in self.worth or not self._may_open(found.condition, own):
            yield from ((a, own) for a in self.args[id(item)])
            return
        self.opening.add(id(item))
        if id(found.condition) not in self.hand:
            yield found.condition, own
        for side, holds in ((found.then, True), (found.otherwise, False)):
            if id(side) in self.rank:
                yield side, self._inside(own, found.condition, holds)

    def _may_open(self, condition: Expr, own: _Place | None) -> bool:
        """Return True if a branch on the condition may open in a place: no other one on it is around, and few are."""
        if own is not None and own.depth >= DEEPEST:
            return False
        while own is not None:
            if own.condition is condition:
                return False
            own = own.around
        return True

    def _inside(self, around: _Place | None, condition: Expr, holds: bool) -> _Place:
        key = around, id(condition), holds
        if key not in self.places:
            self.places[key] = _Place(around, condition, holds, 1 if around is None else around.depth + 1)
        return self.places[key]

    def _worthwhile(self, in_loop: bool) -> set[int]:
        """Return the conditions whose branches save enough operations."""
        costs: dict[int, int] = {}
        self.costs: dict[int, int] = {}
        for item in self.order:
            cost = 0 if id(item) in self.known or item.op == "signal" else SLOW.get(item.op, 1)
            if item.op in LOOPS and cost:
                cost = item.data[0] * (1 + len(walk(item.bodies)))
            elif item.op == "vector" and cost:
                cost = len(item.args)
            self.costs[id(item)] = cost
            place = self.place[id(item)]
            while place is not None:
                key = id(place.condition)
                costs[key] = costs.get(key, 0) + cost
                place = place.around
        calm = {id(d.condition): not in_loop and self._calm(d.condition) for d in self.decisions.values()}
        return {key for key, cost in costs.items() if cost >= (WORTH_OF_FLAG if calm[key] else WORTH)}

    def _calm(self, condition: Expr) -> bool:
        """Return True if a condition is a mode or a flag, or compares reals for equality: it seldom changes."""
        if condition.op == "not":
            return self._calm(condition.args[0])
        if condition.op == "and" and any(self._calm(a) for a in condition.args):
            return True
        return condition.op in ("eq", "ne") or self.flags.get(id(condition), True)

    def steps(self) -> Sequence[Step]:
        """Return the steps that compute the nodes, with branches where they save enough operations."""
        found = self._all_steps() if self.worth else []
        if self.worth and self.clashing:
            self.worth -= self.clashing
            found = self._all_steps()
        if not self.worth or self.clashing:
            return self.given
        return [item for item in self.given if id(item) in self.hand] + found

    def _all_steps(self) -> list[Step]:
        """Return the steps, each node in its place."""
        self.places = {}
        self._place()
        self.clashing = set()
        self.done: set[int] = set()
        self.budget = WALKED * len(self.order)
        return self._level([item for item in self.order if self.place[id(item)] is None], None)

    def _opens(self, item: Expr) -> Expr | None:
        """Return the condition of the branch that a node needs, or None if neither side is computed in one."""
        if id(item) not in self.opening:
            return None
        found, own = self.decisions[id(item)], self.place[id(item)]
        places = [self.place[id(s)] for s in (found.then, found.otherwise) if id(s) in self.rank]
        inside = [self._inside(own, found.condition, holds) for holds in (True, False)]
        return found.condition if any(p in inside for p in places) else None

    def _level(self, items: Sequence[Expr], place: _Place | None) -> list[Step]:
        """Return the steps of the nodes `items` of a place, which are in order."""
        opening = {id(item): self._opens(item) for item in items}
        alike: dict[int, deque[Expr]] = {}
        for item in items:
            condition = opening[id(item)]
            if condition is not None:
                alike.setdefault(id(condition), deque()).append(item)
        found: list[Step] = []
        for item in items:
            if id(item) in self.done:
                continue
            condition = opening[id(item)]
            if condition is None:
                found.append(item)
            else:
                found += self._branch(item, condition, alike[id(condition)], place)
            self.done.add(id(item))
        return found

    def _branch(self, first: Expr, condition: Expr, alike: deque[Expr], place: _Place | None) -> Iterable[Step]:
        """Return the branch that gives `first`, with other choices on its condition whose arguments are known.

        Where the branch would save little, return the nodes without a branch.
        """
        sides = [self._inside(place, condition, holds) for holds in (True, False)]
        chosen, inside = [first], self._below(first, place, set())
        while alike and (alike[0] is first or id(alike[0]) in self.done):
            alike.popleft()
        for item in islice(alike, MOST_ALIKE if self.budget > 0 else 0):
            if id(item) in self.done:
                continue
            more = self._below(item, place, set(), strict=True)
            if more is not None:
                chosen.append(item)
                inside = {**(inside or {}), **more}
        nodes = sorted((inside or {}).values(), key=lambda item: self.rank[id(item)])
        if len(chosen) == 1 and sum(self.costs[id(n)] for n in nodes) < WORTH_OF_FLAG:
            self.done.update(map(id, nodes))
            return *nodes, first
        self.done.update(map(id, chosen))
        lists = [self._level([n for n in nodes if self.place[id(n)] is side], side) for side in sides]
        chosen.sort(key=lambda item: self.rank[id(item)])
        choices = tuple(self.decisions[id(item)] for item in chosen)
        return (Branch(condition, tuple(chosen), choices, tuple(lists[0]), tuple(lists[1])),)

    def _below(self, item: Expr, place: _Place | None, seen: set[int], strict: bool = False) -> dict[int, Expr] | None:
        """Return the nodes that a branch in `place` must compute for a node.

        With `strict`, return None if a node before the branch is missing, or one inside is computed already.
        """
        found: dict[int, Expr] = {}
        depth = 0 if place is None else place.depth
        stack = [item]
        while stack:
            top = stack.pop()
            for a in self.args[id(top)]:
                if id(a) in seen:
                    continue
                seen.add(id(a))
                self.budget -= 1
                own = self.place[id(a)]
                if own is None or own.depth <= depth:
                    if strict and id(a) not in self.done:
                        return None
                elif id(a) in self.done:
                    if strict:
                        return None
                    self.clashing.add(id(own.condition))
                else:
                    found[id(a)] = a
                    stack.append(a)
        return found
