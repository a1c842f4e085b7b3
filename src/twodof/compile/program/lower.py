"""Lowering of a diagram to a program: check, flatten, drop unneeded signals, order."""

import heapq
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from graphlib import TopologicalSorter

from twodof.blocks.declarations import check_tick
from twodof.blocks.diagram import BASE, Diagram
from twodof.blocks.expressions.expr import Expr
from twodof.blocks.expressions.graph import leaves
from twodof.compile.program.flat_program import Action, FlatProgram, FlatSignal, Group, Guard, Node, Start
from twodof.compile.program.flatten import FlatDiagram, conditions_of, drivers_of, node_of, tick_needs
from twodof.errors import DiagramError

TWO_SIGNALS = "{!r} is both a field of an output of the diagram and the output of a part"
INTEGRATORS = ("rk4", "euler")


def lower(diagram: Diagram, dt: float, log: Iterable[str] = (), integrator: str = "rk4") -> FlatProgram:
    """Return the program of `diagram` at the base tick `dt` [s], with the signals in `log` as further outputs.

    Raises DiagramError, with the whole path, if the diagram is incomplete or contradicts itself.
    """
    tick = check_tick(dt, diagram.name)
    if integrator not in INTEGRATORS:
        raise DiagramError(f"unknown integrator {integrator!r}", diagram.name, 'use "rk4" or "euler"')
    flat = FlatDiagram(diagram)
    ordered = flat.ordered()
    inputs = {name: flat.root.root_inputs[name] for name in diagram.inputs}
    outputs = dict(flat.outputs)
    for path in log:
        for name, signal in flat.logged(path).items():
            if outputs.setdefault(name, signal) is not signal:
                raise DiagramError(TWO_SIGNALS.format(name), diagram.name, "rename the part or the output")
    moving = _moving(ordered)
    integrated = [n for n in flat.nodes if n.continuous]
    edged = [s for s in ordered if integrated and node_of(s).trace.edges.get(s.port) is not None]
    stage = _stage(integrated, ordered, moving)
    always = [*outputs.values(), *edged, *_read_inside(integrated, stage, moving)]
    live = _live(flat.nodes, always)
    chosen = [s for s in ordered if s in live]
    return FlatProgram(
        diagram.name,
        diagram.text,
        tick,
        integrator,
        inputs,
        outputs,
        flat.signals,
        flat.parameters,
        flat.nodes,
        _grouped(chosen, flat.nodes, tick_needs),
        _grouped(stage, (), lambda s: [d for d in drivers_of(s) if d in moving]),
        frozenset(moving),
        edged,
        tuple(flat.outputs),
    )


def _moving(ordered: Sequence[FlatSignal]) -> set[FlatSignal]:
    """Return the signals that change inside a step: by an edge, a continuous state, or such an input."""
    moving: set[FlatSignal] = set()
    for s in ordered:
        node = node_of(s)
        if s.port in node.trace.edges:
            moving.add(s)
            continue
        if node.rate != BASE or node.block.crossing or (node.discrete and not node.continuous):
            continue
        own = {x.name for x in node.continuous}
        if own & leaves([node.trace.outputs[s.port]], "state") or any(d in moving for d in drivers_of(s)):
            moving.add(s)
    return moving


def inputs_of(node: Node, roots: Iterable[Expr]) -> set[FlatSignal]:
    """Return the signals that expressions of `node` read."""
    return {node.drivers[name] for name in leaves(roots, "input")}


def _read_by(signal: FlatSignal) -> set[FlatSignal]:
    """Return the signals that the expression of a signal reads."""
    node = node_of(signal)
    return inputs_of(node, [node.trace.outputs[signal.port]])


def _stage(integrated: Sequence[Node], ordered: Sequence[FlatSignal], moving: set[FlatSignal]) -> list[FlatSignal]:
    """Return the continuous outputs that the derivatives depend on, in order; edged ones are given, not computed."""
    needed = {s for n in integrated for s in inputs_of(n, n.trace.derivative.values())}
    chosen = []
    for s in reversed(ordered):
        if s in needed and s in moving and s.port not in node_of(s).trace.edges:
            chosen.append(s)
            needed |= _read_by(s)
    return chosen[::-1]


def _read_inside(
    integrated: Iterable[Node], stage: Iterable[FlatSignal], moving: Container[FlatSignal]
) -> list[FlatSignal]:
    """Return the signals of the tick that the integration reads; a disabled block's outputs are those of the tick."""
    read = set().union(*(inputs_of(n, n.trace.derivative.values()) for n in integrated), *map(_read_by, stage))
    return [s for s in read if s not in moving or node_of(s).guard.enables]


def _live(nodes: Sequence[Node], always: Iterable[FlatSignal]) -> set[FlatSignal]:
    """Return the signals that must be computed at the tick: `always`, and those that states need."""
    stack = list(always)
    for n in nodes:
        if n.block.states:
            stack += conditions_of(n)
            stack += inputs_of(n, [*n.trace.update.values(), *n.trace.project.values()])
    live: set[FlatSignal] = set()
    while stack:
        s = stack.pop()
        if s.node is not None and s not in live:
            live.add(s)
            # What resets a block that has no states changes nothing in it.
            stack += tick_needs(s) if s.node.block.states else [*drivers_of(s), *s.node.guard.enables]
    return live


def _grouped(
    signals: Sequence[FlatSignal], nodes: Sequence[Node], before_it: Callable[[FlatSignal], list[FlatSignal]]
) -> list[Group]:
    """Sort `signals` into groups of one guard, as actions; the states of `nodes` are reset before their outputs."""
    chosen = set(signals)
    starts = {n: n.starts for n in nodes}
    # What is done: a signal, or the start of a node's states.
    things: list[FlatSignal | Start] = [*(start for found in starts.values() for start in found), *signals]
    before: dict[FlatSignal | Start, set[FlatSignal | Start]] = {}
    for thing in things:
        if isinstance(thing, Start):
            before[thing] = {s for s in (*thing.guard.enables, *thing.signals) if s in chosen}
        else:
            before[thing] = {s for s in before_it(thing) if s in chosen}
            before[thing].update(starts.get(node_of(thing), ()))
    things = _nearest_first(things, before)
    rank = {thing: i for i, thing in enumerate(things)}
    sorter = TopologicalSorter(before)
    sorter.prepare()
    queues: dict[Guard, list[int]] = {}
    groups: list[Group] = []
    at = Guard(BASE)
    actions: list[Action] = []
    while sorter.is_active():
        for thing in sorter.get_ready():
            key = thing.guard if isinstance(thing, Start) else node_of(thing).guard
            heapq.heappush(queues.setdefault(key, []), rank[thing])
        if not queues.get(at):
            if actions:
                groups.append(Group(at, tuple(actions)))
            # What always runs first, for it wakes what is guarded.
            at = min((k for k, q in queues.items() if q), key=lambda k: (not k.always, queues[k][0]))
            actions = []
        thing = things[heapq.heappop(queues[at])]
        if isinstance(thing, Start):
            actions.append(Action(thing.node, (), thing))
        elif actions and actions[-1].signals and actions[-1].node is thing.node:
            actions[-1] = Action(actions[-1].node, (*actions[-1].signals, thing))
        else:
            actions.append(Action(node_of(thing), (thing,)))
        sorter.done(thing)
    if actions:
        groups.append(Group(at, tuple(actions)))
    return groups


def _nearest_first(
    things: Sequence[FlatSignal | Start], before: Mapping[FlatSignal | Start, set[FlatSignal | Start]]
) -> list[FlatSignal | Start]:
    """Sort by the length of the chain that each waits for, so that a processor works at several chains at once."""
    depth: dict[FlatSignal | Start, int] = {}
    for thing in TopologicalSorter(before).static_order():
        depth[thing] = max((depth[b] + 1 for b in before[thing]), default=0)
    return sorted(things, key=depth.__getitem__)
