"""Branches: what of an expression graph is computed only where a condition holds.

`where` reads one of its two values, `and` and `or` their second one only where the first does not decide. What is read
on one side alone, and is worth it, becomes an `if` with all that hangs on the same condition. The rest stays a choice
between two values. Expressions have no effect, so both give the same bits.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice

from twodof.blocks.expressions.expr import LOOPS, Expr, node
from twodof.blocks.expressions.graph import CALL, walk
from twodof.blocks.expressions.numbers import FLOATS

WORTH = 10  # operations from which on a branch costs less than computing what may not be read
WORTH_OF_FLAG = 4  # where the processor guesses right: a mode or a flag seldom changes, two reals are seldom the same
SLOW = {"div": 4, "sqrt": 4, "call": CALL}  # operations that take as long as some
DEEPEST = 24  # branches within one another
MOST_ROUNDS = 4  # before what two branches on one condition share is no longer looked for
MOST_ALIKE = 32  # nodes that are looked at for whether they can share a branch
WALKED = 20  # nodes that are looked at for each node of the graph, in finding what can share a branch


@dataclass(frozen=True)
class Choice:
    """What `where`, `and` or `or` decide: by `condition`, the value of each side, a constant that is not a node."""

    condition: Expr
    then: Expr | bool
    otherwise: Expr | bool


@dataclass(frozen=True, eq=False)
class Branch:
    """An `if`: the steps of each side, after which the values of all `chosen` are known, by their `choices`."""

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
    """What a node with these arguments decides, if it is one that reads one of two values."""
    if item.op == "where":
        return Choice(*args)
    if item.op in ("and", "or") and item.kind == "bool":
        first, second = args
        return Choice(first, second, False) if item.op == "and" else Choice(first, True, second)
    return None


@dataclass(frozen=True, eq=False)
class _Place:
    """Where a node is computed: on the side `holds` of a condition, within the place around it (None: anywhere)."""

    around: _Place | None
    condition: Expr
    holds: bool
    depth: int
    inner: dict[tuple[int, bool], _Place] = field(default_factory=dict)


def _common(a: _Place | None, b: _Place | None) -> _Place | None:
    """The innermost place around both."""
    while a is not b:
        if b is None or (a is not None and a.depth > b.depth):
            a = a.around if a is not None else None
        elif a is None or b.depth > a.depth:
            b = b.around
        else:
            a, b = a.around, b.around
    return a


def steps(
    order: Sequence[Expr],
    args: Arguments,
    always: Iterable[Expr],
    hand: Container[int],
    optional: Container[int],
    in_loop: bool,
) -> Sequence[Step]:
    """Return the nodes `order`, arguments before their users, as steps.

    Those `always` are computed in any case; those whose identity is in `hand` are there and cost nothing. The signals
    `optional` may be 0 where a condition keeps all others from reading them.
    """
    if not any(item.op in ("where", "and", "or") for item in order):
        return order
    plan = _Plan([item for item in order if id(item) not in hand], args, always, hand, optional, in_loop)
    at_hand = [item for item in order if id(item) in hand]
    for _ in range(MOST_ROUNDS):
        if not plan.worth:
            return order
        found = plan.all_steps()
        if not plan.clashes:
            return at_hand + found
        plan.raised |= plan.clashes
    plan.worth -= plan.clashing
    found = plan.all_steps()
    return order if plan.clashes else at_hand + found


class _Plan:
    """Which node is computed where, and in which order."""

    def __init__(
        self,
        order: Sequence[Expr],
        args: Arguments,
        always: Iterable[Expr],
        hand: Container[int],
        optional: Container[int],
        in_loop: bool,
    ) -> None:
        self.order = order
        self.hand = hand
        self.args: dict[int, tuple[Expr, ...]] = {}
        self.decisions: dict[int, Choice] = {}
        self.known: set[int] = set()  # what is at hand
        self.flags: dict[int, bool] = {}  # whether nothing real is in it
        for item in order:
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
        self.rank = {id(item): i for i, item in enumerate(order)}
        self._kept: list[Expr] = []
        self.raised: set[int] = set()  # what two branches on one condition share: it is computed before both
        self.clashes: set[int] = set()
        self.clashing: set[int] = set()  # conditions of such branches
        self._leave_out(optional)
        self.worth = {id(d.condition) for d in self.decisions.values()}
        self.outermost: dict[tuple[int, bool], _Place] = {}
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
            elif item.op == "input":
                stack += [(a, wanted) for a in self.args.get(id(item), ())]
        return frozenset(found)

    def _place(self) -> None:
        """Find of each node the innermost place in which all stand that read it."""
        place: dict[int, _Place | None] = dict.fromkeys(self.always)
        for item in reversed(self.order):
            own = place.setdefault(id(item), None)
            if id(item) in self.raised and own is not None:
                own = place[id(item)] = own.around
            for a, here in self._reads(item, own):
                place[id(a)] = _common(place[id(a)], here) if id(a) in place else here
        self.place = place

    def _reads(self, item: Expr, own: _Place | None) -> Iterator[tuple[Expr, _Place | None]]:
        """The arguments of a node in the place `own`, each with the place where it is read."""
        found = self.decisions.get(id(item))
        if found is None or id(found.condition) not in self.worth or not self._may_open(found.condition, own):
            yield from ((a, own) for a in self.args[id(item)])
            return
        if id(found.condition) not in self.hand:
            yield found.condition, own
        for side, holds in ((found.then, True), (found.otherwise, False)):
            if isinstance(side, Expr) and id(side) in self.rank:
                yield side, self._inside(own, found.condition, holds)

    def _may_open(self, condition: Expr, own: _Place | None) -> bool:
        """Whether a branch on the condition may stand in a place: not within another one on it."""
        if own is not None and own.depth >= DEEPEST:
            return False
        while own is not None:
            if own.condition is condition:
                return False
            own = own.around
        return True

    def _inside(self, around: _Place | None, condition: Expr, holds: bool) -> _Place:
        known = self.outermost if around is None else around.inner
        key = id(condition), holds
        if key not in known:
            known[key] = _Place(around, condition, holds, 1 if around is None else around.depth + 1)
        return known[key]

    def _worthwhile(self, in_loop: bool) -> set[int]:
        """The conditions on which enough hangs."""
        costs: dict[int, int] = {}
        self.costs: dict[int, int] = {}
        for item in self.order:
            cost = 0 if id(item) in self.known or item.op == "input" else SLOW.get(item.op, 1)
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
        """Whether a condition is a mode or a flag, or needs two reals to be the same, which they seldom are."""
        if condition.op == "not":
            return self._calm(condition.args[0])
        if condition.op == "and" and any(self._calm(a) for a in condition.args):
            return True
        return condition.op in ("eq", "ne") or self.flags.get(id(condition), True)

    def all_steps(self) -> list[Step]:
        """The steps in the places that were found."""
        self.outermost = {}
        self._place()
        self.clashes, self.clashing = set(), set()
        self.done: set[int] = set()
        self.budget = WALKED * len(self.order)
        return self._level([item for item in self.order if self.place[id(item)] is None], None)

    def _opens(self, item: Expr) -> Expr | None:
        """The condition of the branch that a node needs, if one of its sides stands in one."""
        found = self.decisions.get(id(item))
        if found is None or id(found.condition) not in self.worth:
            return None
        own = self.place[id(item)]
        if not self._may_open(found.condition, own):
            return None
        places = [
            self.place[id(s)] for s in (found.then, found.otherwise) if isinstance(s, Expr) and id(s) in self.rank
        ]
        inside = [self._inside(own, found.condition, holds) for holds in (True, False)]
        return found.condition if any(p in inside for p in places) else None

    def _level(self, items: Sequence[Expr], place: _Place | None) -> list[Step]:
        """The steps of what stands in a place; `items` are in order."""
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
        """The branch that gives `first`, and those like it whose sides can be computed now; none if that is little."""
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
        """What must be computed inside a branch in `place` for a node; `strict`: None if more is missing before it."""
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
                    self.clashes.add(id(a))
                    self.clashing.add(id(own.condition))
                else:
                    found[id(a)] = a
                    stack.append(a)
        return found
