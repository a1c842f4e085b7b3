"""Random state machines as tables, and an interpreter of these tables that knows nothing of the block language.

All numbers are small whole ones, which both precisions hold exactly.
"""

import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from twodof.blocks import Port, State, to_int32
from twodof.blocks.state_machine import Mode, StateMachine, Transition

Row = Mapping[str, Any]
Term = tuple[Any, ...]
"""An expression: an operation, and what it is applied to."""
Assignments = dict[str, Term]

REALS, WHOLES = ("w", "v"), ("n",)


@dataclass
class MachineTable:
    """A state machine as data: the outer modes with their inner ones, and what acts when."""

    outer: dict[str, list[str]] = field(default_factory=dict)
    histories: set[str] = field(default_factory=set)
    actions: dict[tuple[str, str], Assignments] = field(default_factory=dict)
    transitions: list[tuple[str, str, Term, Assignments]] = field(default_factory=list)

    @property
    def leaves(self) -> list[str]:
        """The modes that the machine can be in."""
        return [leaf for outer, inner in self.outer.items() for leaf in inner or [outer]]

    def around(self, leaf: str) -> list[str]:
        """The mode around a leaf, if there is one."""
        return [outer for outer, inner in self.outer.items() if leaf in inner]


def random_table(r: random.Random) -> MachineTable:
    """Make a table of modes on two levels, each reached by a transition."""
    table = MachineTable()
    for k in range(r.randint(1, 4)):
        inner = [f"m{k}{i}" for i in range(r.choice((0, 0, 1, 2, 3)))]
        table.outer[f"m{k}"] = inner
        if inner and r.random() < 0.5:
            table.histories.add(f"m{k}")
    leaves, names = table.leaves, [*table.leaves, *(o for o, inner in table.outer.items() if inner)]
    for name in names:
        given: Assignments = {"y": _real(r), "k": _whole(r)} if name in leaves else {}
        table.actions[name, "during"] = given | _some(r)
        if name not in leaves and r.random() < 0.5:
            table.actions[name, "during"] = {"y": _real(r), **table.actions[name, "during"]}
        for action in ("entry", "exit"):
            if r.random() < 0.5:
                table.actions[name, action] = _some(r)
    constants = iter(range(1, 1000))
    ways = list(pairwise(leaves))
    ways += [(r.choice(names), r.choice(names)) for _ in range(r.randint(1, 6))]
    r.shuffle(ways)
    for source, target in ways:
        table.transitions.append((source, target, _test(r, constants), _some(r) if r.random() < 0.4 else {}))
    return table


def _some(r: random.Random) -> Assignments:
    made: Assignments = {}
    for name in (*REALS, *WHOLES):
        if r.random() < 0.3:
            made[name] = _real(r) if name in REALS else _whole(r)
    return made


def _real(r: random.Random) -> Term:
    constant, own = ("const", float(r.randint(-4, 4))), ("x", r.choice(REALS))
    return r.choice((constant, ("u", "u"), own, ("add", own, constant), ("sub", ("u", "u"), own)))


def _whole(r: random.Random) -> Term:
    constant = ("const", r.randint(-3, 3))
    return r.choice(
        (constant, ("elapsed",), ("add", ("x", "n"), constant), ("u", "b"), ("sub", ("u", "b"), ("x", "n")))
    )


def _test(r: random.Random, constants: Iterator[int]) -> Term:
    """A condition like no other: so none hides another for certain."""
    unlike = ("<", ("x", "n"), ("const", 500 + next(constants)))
    often = r.choice(
        (
            ("u", "flag"),
            ("not", ("u", "flag")),
            ("<", ("const", float(r.randint(-4, 3))), ("u", "u")),
            ("<", ("const", r.randint(1, 6)), ("elapsed",)),
            ("<", ("x", "w"), ("x", "v")),
            ("<", ("x", "n"), ("u", "b")),
        )
    )
    return ("and", often, unlike)


def machine_block(table: MachineTable, spare: bool = False) -> StateMachine:
    """The table as a user would write it; with a `spare` input nothing reads that."""

    class Tabled(StateMachine):
        inputs = (Port("u"), Port("b", "int32"), Port("flag", "bool"), *([Port("spare")] if spare else []))
        outputs = (Port("y"), Port("k", "int32"), Port("w"), Port("mode", "int32"), Port("elapsed", "uint32"))
        variables = (State("w", 1.0), State("v", -1.0), State("n", 2, "int32"))

    def mode(name: str, inner: Sequence[str]) -> Mode:
        acts = {a: _function(table.actions[name, a]) for a in ("entry", "during", "exit") if (name, a) in table.actions}
        return Mode(name, inner=[mode(one, ()) for one in inner], history=name in table.histories, **acts)

    Tabled.modes = [mode(outer, inner) for outer, inner in table.outer.items()]
    Tabled.transitions = [
        Transition(source, target, _function({"": test}), _function(does) if does else None)
        for source, target, test, does in table.transitions
    ]
    return Tabled()


def _function(given: Assignments) -> Callable[..., Any]:
    def function(u: Any, x: Any, t: Any) -> Any:
        found = {name: _traced(term, u, x, t) for name, term in given.items()}
        return found.get("", found)

    return function


def _traced(term: Term, u: Any, x: Any, t: Any) -> Any:
    op, *rest = term
    if op == "const":
        return rest[0]
    if op in ("u", "x"):
        return (u if op == "u" else x)[rest[0]]
    if op == "elapsed":
        return to_int32(t.elapsed)
    a, *others = (_traced(one, u, x, t) for one in rest)
    if op == "not":
        return ~a
    (b,) = others
    return a & b if op == "and" else a < b if op == "<" else a + b if op == "add" else a - b


def told_by_the_table(table: MachineTable, rows: Sequence[Row], taken: set[int] | None = None) -> Iterator[Row]:
    """Yield the machine's outputs tick by tick, and add the numbers of taken transitions to `taken`."""
    leaf, values, since, last = "", {}, {}, {}

    def evaluate(term: Term, row: Row, owner: str) -> Any:
        op, *rest = term
        match op:
            case "const":
                return rest[0]
            case "u":
                return row[rest[0]]
            case "x":
                return values[rest[0]]
            case "elapsed":
                return since[owner]
            case "not":
                return not evaluate(rest[0], row, owner)
        a, b = (evaluate(one, row, owner) for one in rest)
        return {"and": a and b, "<": a < b, "add": a + b, "sub": a - b}[op]

    def act(assignments: Assignments, row: Row, owner: str) -> None:
        values.update({name: evaluate(term, row, owner) for name, term in assignments.items()})

    for row in rows:
        if row["clear"]:
            leaf = ""
        before = [*table.around(leaf), leaf] if leaf else []
        entered: list[str] = []
        if not leaf:
            values = {"w": 1.0, "v": -1.0, "n": 2}
            last = {o: inner[0] for o, inner in table.outer.items() if inner}
            leaf = table.leaves[0]
            entered = [*table.around(leaf), leaf]
        for one in before:
            since[one] += 1
        ordered = [t for one in before for t in table.transitions if t[0] == one]
        for transition in ordered:
            source, target, test, does = transition
            if not evaluate(test, row, source):
                continue
            if taken is not None:
                taken.add(table.transitions.index(transition))
            end = target
            if table.outer.get(target):
                end = last[target] if target in table.histories else table.outer[target][0]
            after = [*table.around(end), end]
            common = [o for o in after[:-1] if o in before and o not in (source, target)]
            for one in reversed(before):
                if one not in common:
                    act(table.actions.get((one, "exit"), {}), row, one)
            act(does, row, source)
            entered, leaf = [o for o in after if o not in common], end
            break
        since.update(dict.fromkeys(entered, 0))
        for one in table.around(leaf):
            last[one] = leaf
        for one in entered:
            act(table.actions.get((one, "entry"), {}), row, one)
        for one in (*table.around(leaf), leaf):
            act(table.actions.get((one, "during"), {}), row, one)
        found = {"y": values["y"], "k": values["k"], "w": values["w"]}
        yield found | {"mode": table.leaves.index(leaf), "elapsed": since[leaf]}
