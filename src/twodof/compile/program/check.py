"""Checks of a diagram: all problems at once, remarks on a diagram that compiles, and its size."""

from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from twodof.blocks.declarations import Param
from twodof.blocks.diagram import Diagram
from twodof.blocks.expressions.numbers import FLOATS
from twodof.blocks.reference.interpreter import Reference
from twodof.compile.program.flat_program import FlatProgram, FlatSignal, Node, parameter_values
from twodof.compile.program.flatten import FlatDiagram
from twodof.compile.program.lower import lower
from twodof.errors import DiagramError

MAX_PROBLEMS = 1000


@dataclass(frozen=True)
class DiagramRemark:
    """Remark on a probable mistake in a diagram that compiles: text, path and remedy."""

    what: str
    where: str
    remedy: str


@dataclass(frozen=True)
class DiagramSizes:
    """Sizes of a diagram; states and parameters count single numbers, so an array counts its elements."""

    blocks: int
    subdiagrams: int
    inputs: int
    outputs: int
    signals: int
    discrete_states: int
    continuous_states: int
    parameters: int
    rates: tuple[tuple[int, int], ...]  # (divider, offset) of the tick, those in use


@dataclass(frozen=True)
class Findings:
    """Findings of `check`.

    `problems` keep the diagram from compiling. Only without problems there are `remarks`; `sizes`; `feedthrough`, for
    each output of the diagram the inputs on which it depends in the same tick; `port_feedthrough`, for each output port
    of each block its own inputs on which it depends in the same tick; `unread`, the output ports without a reader;
    `left_out`, the blocks that are not compiled because nothing needs them.
    """

    problems: tuple[DiagramError, ...]
    remarks: tuple[DiagramRemark, ...] = ()
    sizes: DiagramSizes | None = None
    feedthrough: dict[str, tuple[str, ...]] | None = None
    port_feedthrough: dict[str, tuple[str, ...]] | None = None
    unread: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()

    @property
    def fine(self) -> bool:
        """True if the diagram compiles."""
        return not self.problems


def check(diagram: Diagram, dt: float) -> Findings:
    """Return all errors that `lower` would raise for `diagram` (1000 at most), or its remarks and size.

    `dt` is the base tick [s]. Raises DiagramError only for an invalid `dt`.
    """
    problems: list[DiagramError] = []

    def report(error: DiagramError) -> None:
        if len(problems) >= MAX_PROBLEMS:
            raise _Enough
        if str(error) not in {str(p) for p in problems[-50:]}:
            problems.append(error)

    with suppress(_Enough):
        flat = FlatDiagram(diagram, report)
        ordered = flat.ordered()
    if problems:
        return Findings(tuple(problems))
    program = lower(diagram, dt)
    through = _feedthrough(ordered)
    read = _read(flat)
    needed = set(compiled(program))
    left_out = tuple(n.path for n in program.nodes if n.path not in needed)
    return Findings(
        (),
        tuple(_remarks(diagram, flat, program, read, left_out)),
        _sizes(flat, program),
        {name: tuple(sorted(through[s])) if s.node else (s.path,) for name, s in flat.outputs.items()},
        {s.path: tuple(sorted(s.node.trace.feedthrough[s.port])) for s in ordered if s.node},
        tuple(s.path for n in flat.nodes for s in n.outputs.values() if s not in read),
        left_out,
    )


class _Enough(Exception):
    """Signal that a check has found MAX_PROBLEMS problems."""


def compiled(program: FlatProgram) -> dict[str, None]:
    """Return the paths of the blocks that run at a tick: their outputs are computed, or their states change."""
    found = {a.node.path: None for group in (*program.tick, *program.stage) for a in group.actions}
    for n in program.nodes:
        moving = any(not (e.op == "state" and e.data == name) for name, e in n.trace.update.items())
        if moving or n.continuous:
            found[n.path] = None
    return found


def _feedthrough(ordered: Iterable[FlatSignal]) -> dict[FlatSignal, frozenset[str]]:
    """Return, for each signal, the inputs of the diagram on which it depends in the same tick."""
    through: dict[FlatSignal, frozenset[str]] = {}
    for s in ordered:
        if s.node is not None:
            drivers = [s.node.drivers[name] for name in s.node.trace.feedthrough[s.port]]
            drivers += [c for q in s.node.conditions for c in q.signals]
            names = (through[d] if d.node else frozenset((d.path,)) for d in drivers)
            through[s] = frozenset[str]().union(*names)
    return through


def _read(flat: FlatDiagram) -> set[FlatSignal]:
    read = set(flat.outputs.values())
    for node in flat.nodes:
        read.update(node.drivers.values())
        for condition in node.conditions:
            read.update(condition.signals)
    return read


def _sizes(flat: FlatDiagram, program: FlatProgram) -> DiagramSizes:
    def elements(nodes: Iterable[Node], continuous: bool) -> int:
        return sum(s.width or 1 for n in nodes for s in n.block.states if s.continuous == continuous)

    return DiagramSizes(
        sum(not n.added for n in flat.nodes),
        len(flat.levels) - 1,
        len(program.inputs),
        len(program.outputs),
        sum(len(n.outputs) for n in flat.nodes),
        elements(flat.nodes, False),
        elements(flat.nodes, True),
        sum(p.declared.width or 1 for p in flat.parameters.values()),
        tuple(sorted({(n.rate.divider, n.rate.offset) for n in flat.nodes})),
    )


def _remarks(
    diagram: Diagram, flat: FlatDiagram, program: FlatProgram, read: set[FlatSignal], left_out: tuple[str, ...]
) -> Iterator[DiagramRemark]:
    for name, signal in flat.root.root_inputs.items():
        if signal not in read:
            yield DiagramRemark("nothing reads this input", name, "connect it, or leave it if a template asks for it")
    for path in left_out:
        yield DiagramRemark("nothing reads its outputs: it is left out", path, "connect it, log it, or remove it")
    for node in flat.nodes:
        idle = node.outputs and not any(s in read for s in node.outputs.values())
        if idle and node.path not in left_out:
            yield DiagramRemark(
                "its states are computed, and nothing reads its outputs", node.path, "connect it, or remove it"
            )
    used = {p.path for n in flat.nodes for p in n.parameters.values()}
    for parameter in flat.parameters.values():
        if parameter.path not in used:
            yield DiagramRemark("no block uses this parameter", parameter.path, "bind a parameter of a part to it")
            continue
        yield from _at_bound(parameter.path, parameter.declared)
    yield from _not_finite(diagram, program)


def _at_bound(path: str, declared: Param) -> Iterator[DiagramRemark]:
    """Yield remarks on a default that is a bound: no room on one side. 0 is left out: it switches things off."""
    if declared.kind == "bool" or declared.low == declared.high or not declared.tunable:
        return
    for bound, word in ((declared.low, "lower"), (declared.high, "upper")):
        if np.isfinite(bound) and bound != 0 and np.any(np.asarray(declared.value) == bound):
            yield DiagramRemark(f"its default {bound:g} is its {word} bound", path, "check the bound")


def _not_finite(diagram: Diagram, program: FlatProgram) -> Iterator[DiagramRemark]:
    """Yield remarks on derived parameters that the defaults make infinite or NaN, else on such signals at inputs 0."""
    found = False
    for (node, name), value in parameter_values(program, {}).items():
        if name not in node.parameters and not _finite(value):
            found = True
            where = f"{node.path}.{name}"
            yield DiagramRemark("the default parameters make it infinite or NaN", where, "change the defaults")
    if found:
        return
    paths = [s.path for n in program.nodes for s in n.outputs.values() if s.kind in FLOATS]
    for path, value in Reference(diagram, program.dt, log=paths).machine().step().items():
        if path in paths and not np.all(np.isfinite(value)):
            yield DiagramRemark(
                "with all inputs 0 it is infinite or NaN at the first step", path, "guard the division with where"
            )


def _finite(value: object) -> bool:
    items = value if isinstance(value, tuple) else (value,)
    return all(bool(np.isfinite(v)) for v in items if isinstance(v, np.floating))
