"""Need: the conditions without which nobody reads a signal. What is read under a condition only is computed only then.

`where` reads one of its two values; `and` and `or` read their second one only where the first does not decide. So a
block that selects between signals reads one of them, and what gives the other one need not run.
"""

from collections.abc import Collection, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from twodof.blocks.elementary.functions import FUNCTIONS
from twodof.blocks.expressions.cost import CostMeter
from twodof.blocks.expressions.expr import Expr, node, tracing
from twodof.blocks.expressions.graph import evaluate, walk
from twodof.compile.program.flat_program import FlatSignal, Need, Node
from twodof.compile.program.flatten import node_of

WORTH = 20  # operations from which on a branch costs less than computing what nobody may read
LONGEST = 12  # nodes of a condition
MOST = 8  # conditions on a signal
MOST_PARTS = 100  # nodes of a condition that are looked at
MOST_ROUNDS = 100

_Needs = dict[int, Need]
"""Conditions that must all hold, by their identity."""


@dataclass(frozen=True)
class _Use:
    """Where a signal is read: in the expression of `reader` (None: one that is always computed), under `needs`."""

    reader: FlatSignal | None
    needs: _Needs = field(hash=False)


def needs(
    nodes: Collection[Node], ordered: Sequence[FlatSignal], always: Iterable[FlatSignal]
) -> dict[FlatSignal, tuple[Need, ...]]:
    """The conditions on those of the signals `ordered` that are worth a branch; `always` are read under none."""
    outputs: dict[Node, list[FlatSignal]] = {}
    for s in ordered:
        outputs.setdefault(node_of(s), []).append(s)
    worth = {n for n, signals in outputs.items() if _worth(n, signals)}
    uses = _uses(nodes, ordered, worth)
    for s in always:
        uses.setdefault(s, []).append(_Use(None, {}))
    found: dict[FlatSignal, _Needs | None] = {}  # None: nobody has been seen to read it
    for _ in range(MOST_ROUNDS):
        before = dict(found)
        for s in reversed(ordered):
            found[s] = _common(uses.get(s, ()), found) if node_of(s) in worth else {}
        for n in worth:  # the outputs of a block share what they compute
            shared = _common([_Use(s, {}) for s in outputs[n]], found)
            found.update(dict.fromkeys(outputs[n], shared))
        if found == before:
            return {s: tuple(needed.values()) for s, needed in found.items() if needed}
    return {}


def _worth(n: Node, signals: Sequence[FlatSignal]) -> bool:
    """Whether a block may be left out of a tick, and costs enough: one with states shares what its update computes."""
    simple = all(s.width is None for s in signals) and not n.trace.edges
    alone = not n.block.states and not any(d.node is n for d in n.drivers.values())
    if not (simple and alone):
        return False
    return CostMeter(None).measure(n.trace.outputs[s.port] for s in signals).operations >= WORTH


def _common(uses: Iterable[_Use], found: Mapping[FlatSignal, _Needs | None]) -> _Needs | None:
    """The conditions that all uses have in common."""
    common: _Needs | None = None
    for use in uses:
        outer = {} if use.reader is None else found.get(use.reader)
        if outer is not None:
            here = outer | use.needs
            common = here if common is None else {k: need for k, need in common.items() if k in here}
    return common


def _uses(
    nodes: Collection[Node], ordered: Iterable[FlatSignal], worth: Container[Node]
) -> dict[FlatSignal, list[_Use]]:
    """Where each signal of the nodes `worth` is read, and perhaps others.

    Who acts at other ticks may read a value of a tick in which nobody else did.
    """
    uses: dict[FlatSignal, list[_Use]] = {}
    meanings: dict[int, Need] = {}

    def read(d: FlatSignal, n: Node, reader: FlatSignal | None, under: _Needs) -> None:
        together = d.node is not None and d.node.guard == n.guard
        uses.setdefault(d, []).append(_Use(reader, under) if together else _Use(None, {}))

    readers = {n for n in nodes if any(d.node in worth for d in n.drivers.values())}
    for s in ordered:
        n = node_of(s)
        if n not in readers:
            continue
        for d, under in _reads(n, [n.trace.outputs[s.port], *n.trace.edges.get(s.port, ())], meanings):
            read(d, n, s, under)
    for n in nodes:
        if n in readers:
            for d, under in _reads(n, [*n.trace.update.values(), *n.trace.project.values()], meanings):
                read(d, n, None, under)
        for condition in n.conditions:
            for d in condition.signals:
                uses.setdefault(d, []).append(_Use(None, {}))
    return uses


def _reads(n: Node, roots: Sequence[Expr], meanings: dict[int, Need]) -> Iterator[tuple[FlatSignal, _Needs]]:
    """The signals that expressions of a block read, and the conditions under which they do."""
    under: dict[int, _Needs] = {id(r): {} for r in roots}
    for item in reversed(walk(roots)):
        own = under[id(item)]
        for a, condition, holds in _arguments(item):
            here = own if condition is None else own | _conditions(n, condition, holds, meanings)
            if len(here) > MOST:
                here = own
            if id(a) in under:
                here = {k: need for k, need in under[id(a)].items() if k in here}
            under[id(a)] = here
        if item.op == "input":
            yield n.drivers[item.data], own


def _arguments(item: Expr) -> Iterator[tuple[Expr, Expr | None, bool]]:
    """The arguments of a node, each with the condition (None: none) that must hold, or not hold, where it is read."""
    if item.op == "where":
        condition, first, second = item.args
        yield from ((condition, None, True), (first, condition, True), (second, condition, False))
    elif item.op in ("and", "or") and item.kind == "bool":
        first, second = item.args
        yield from ((first, None, True), (second, first, item.op == "and"))
    else:
        yield from ((a, None, True) for a in item.args)


def _conditions(n: Node, condition: Expr, holds: bool, meanings: dict[int, Need]) -> _Needs:
    """A condition as those that must all hold for it; of very many only some, which is enough for a branch."""
    found: _Needs = {}
    seen: set[tuple[int, bool]] = set()
    stack = [(condition, holds)]
    while stack and len(seen) < MOST_PARTS:
        item, wanted = stack.pop()
        if (id(item), wanted) in seen:  # one that stands in many places is small, and endless to follow as a tree
            continue
        seen.add((id(item), wanted))
        if item.op == "not":
            stack.append((item.args[0], not wanted))
        elif item.op == ("and" if wanted else "or"):
            stack += [(a, wanted) for a in reversed(item.args)]
        else:
            found |= _meaning(n, item, wanted, meanings)
    return found


def _meaning(n: Node, condition: Expr, holds: bool, meanings: dict[int, Need]) -> _Needs:
    nodes = walk([condition])
    if len(nodes) > LONGEST or any(e.op in ("state", "tick", "dt", "bound", "call") or e.width for e in nodes):
        return {}
    with tracing(n.path):  # over paths, so that conditions of several blocks are the same node if they say the same
        (meaning,) = evaluate([condition], lambda e: _global(n, e), FUNCTIONS)
    key = 2 * id(meaning) + holds
    read = tuple(n.drivers[e.data] for e in nodes if e.op == "input")
    return {key: meanings.setdefault(key, Need(n, condition, holds, read, meaning))}


def _global(n: Node, leaf: Expr) -> Expr:
    if leaf.op == "input":
        return node("input", leaf.kind, (), n.drivers[leaf.data].path)
    path = n.parameters[leaf.data].path if leaf.data in n.parameters else f"{n.path}.{leaf.data}"
    return node("param", leaf.kind, (), path)
