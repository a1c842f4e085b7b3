"""Blocks of a diagram computed by one block: an algebraic loop that is solved, a subsystem that is iterated.

The expressions of the blocks, recorded once each, are computed in the order in which they need each other.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from itertools import takewhile
from operator import and_
from typing import Any

import numpy as np

from twodof.blocks import Diagram
from twodof.blocks.block import Block, Clock
from twodof.blocks.declarations import State
from twodof.blocks.diagram import BASE, CONDITIONS, Part
from twodof.blocks.expressions.arrays import flat_of, fold, shape_of, vector
from twodof.blocks.expressions.expr import convert, int32, where
from twodof.blocks.expressions.graph import walk
from twodof.blocks.expressions.numbers import FLOATS, STORED
from twodof.blocks.library import DataStore, StoreRead, StoreWrite, UnitDelay
from twodof.blocks.trace import computed
from twodof.slx.matlab.evaluation import Evaluation
from twodof.slx.matlab.program import call, of_library
from twodof.slx.matlab.values import as_array, filled
from twodof.slx.translation import NotTranslated

Key = tuple[str, str]
"""An output: path of its block, "" for an input of the diagram, and the port's name."""


@dataclass(eq=False)
class NestedDiagram:
    """A diagram in the network: its path, and the level and the part that it is in."""

    diagram: Diagram
    prefix: str = ""
    above: "NestedDiagram | None" = None
    name: str = ""
    below: dict[str, "NestedDiagram"] = field(default_factory=dict)


@dataclass(eq=False)
class PlacedBlock:
    """A block in the network; `apart` says why it cannot be joined with others."""

    path: str
    block: Block
    level: NestedDiagram
    part: Part
    apart: str = ""


class Network:
    """The blocks of a diagram and of those in it, by path, with the output that drives each input."""

    def __init__(self, diagram: Diagram) -> None:
        self.root, self.nodes = NestedDiagram(diagram), dict[str, PlacedBlock]()
        self._collect(self.root, "")

    def _collect(self, level: NestedDiagram, apart: str) -> None:
        for name, part in level.diagram.parts.items():
            conditional = part.enable or part.trigger or part.reset
            why = apart or ("acts at times only" if conditional else "has another rate" if part.rate != BASE else "")
            path = f"{level.prefix}{name}"
            if isinstance(part.item, Diagram):
                level.below[name] = NestedDiagram(part.item, f"{path}.", level, name)
                self._collect(level.below[name], why)
            else:
                store = isinstance(part.item, (DataStore, StoreRead, StoreWrite))
                traced = part.item.trace
                why = why or ("is a data store" if store else "has edges" if traced.edges else "")
                self.nodes[path] = PlacedBlock(path, part.item, level, part, why)

    def origin(self, level: NestedDiagram, source: str | None) -> Key | None:
        """Return the output that a source of a level is; None where nothing is connected."""
        while source is not None:
            part, port = level.diagram.source(source)
            if part is not None and part not in level.below:
                return f"{level.prefix}{part}", port
            if part is not None:
                level = level.below[part]
                source = level.diagram.outlet(port)
            elif level.above is None:
                return "", port
            else:
                source, level = level.above.diagram.feed(level.name, port), level.above
        return None

    def driver(self, node: PlacedBlock, port: str) -> Key | None:
        """Return the output that drives an input of a block."""
        return self.origin(node.level, node.level.diagram.feed(node.part.name, port))

    def needs(self, key: Key) -> list[Key]:
        """Return the outputs of blocks that an output needs in the same step."""
        node = self.nodes[key[0]]
        found = (self.driver(node, port) for port in sorted(node.block.trace.feedthrough[key[1]]))
        return [one for one in found if one is not None and one[0]]

    def loops(self) -> list[set[Key]]:
        """Return the algebraic loops: the sets of outputs that all need each other (Tarjan)."""
        found, index, low = list[set[Key]](), dict[Key, int](), dict[Key, int]()
        stack, on = list[Key](), set[Key]()
        for start in [(node.path, port.name) for node in self.nodes.values() for port in node.block.outputs]:
            work = [(start, iter([start]))] if start not in index else []
            while work:
                at, following = work[-1]
                if at not in index:
                    index[at] = low[at] = len(index)
                    stack.append(at)
                    on.add(at)
                    following = iter(self.needs(at))
                    work[-1] = at, following
                after = next((one for one in following if one not in index or one in on), None)
                if after is None:
                    work.pop()
                    if work:
                        low[work[-1][0]] = min(low[work[-1][0]], low[at])
                    if low[at] == index[at]:
                        found.append(set(stack[stack.index(at) :]))
                        del stack[stack.index(at) :]
                        on -= found[-1]
                elif after in index:
                    low[at] = min(low[at], index[after])
                else:
                    work.append((after, iter(())))
        return [one for one in found if len(one) > 1 or next(iter(one)) in self.needs(next(iter(one)))]


class Joined(Block):
    """The blocks at these paths of a network. `given` are outputs outside by the input that has them."""

    def __init__(self, network: Network, paths: Iterable[str], given: Mapping[Key, str]) -> None:
        self.network, self.given = network, dict(given)
        self.nodes = [network.nodes[path] for path in paths]
        for node in self.nodes:
            if node.apart:
                raise NotTranslated(f"{node.path} {node.apart}")
        inputs = [(node.path, port.name) for node, port in self._of("inputs")]
        self.driven = {one: network.driver(network.nodes[one[0]], one[1]) for one in inputs}  # the diagram may change
        starts = [_own(n, s.initial) if isinstance(s.initial, str) else s.initial for n, s in self._of("states")]
        states = zip(self._of("states"), starts, strict=True)
        self.states = [replace(s, name=_own(n, s.name), initial=start) for (n, s), start in states]
        self.params = [replace(one, name=_own(node, one.name)) for node, one in self._of("params")]
        self.derived = [replace(one, name=_own(node, one.name)) for node, one in self._of("derived")]

    def _of(self, what: str) -> list[tuple[PlacedBlock, Any]]:
        return [(node, one) for node in self.nodes for one in getattr(node.block, what)]

    def _computed(self, node: PlacedBlock, roots: Sequence[Any], value: Callable[[Key], Any], *views: Any) -> list[Any]:
        x, p, t = views
        ports = {leaf.data for leaf in walk(roots) if leaf.op == "input"}
        drivers = {port: self.driven[node.path, port] for port in ports}
        u = {port: value(driver) for port, driver in drivers.items() if driver is not None}
        if len(u) < len(ports):
            raise NotTranslated(f"nothing drives an input of {node.path}")
        declared: list[Any] = [*node.block.params, *node.block.derived]
        states = {one.name: x[_own(node, one.name)] for one in node.block.states}
        return computed(roots, u, states, {one.name: p[_own(node, one.name)] for one in declared}, t)

    def values(self, known: Mapping[Key, Any], u: Any, *views: Any) -> Callable[[Key], Any]:
        """Return the function that computes an output, where those in `known` have these values."""
        memo = {**{key: flat_of(u[name]) for key, name in self.given.items()}, **known}

        def value(key: Key) -> Any:
            if key not in memo:
                memo[key] = self.anew(key, value, *views)
            return memo[key]

        return value

    def anew(self, key: Key, value: Callable[[Key], Any], *views: Any) -> Any:
        """Compute an output from those that it needs."""
        node = self.network.nodes[key[0]]
        return self._computed(node, [node.block.trace.outputs[key[1]]], value, *views)[0]

    def moved(self, method: str, value: Callable[[Key], Any], *views: Any) -> dict[str, Any]:
        """Return what a method of all blocks gives for the states."""
        found = dict[str, Any]()
        for node in self.nodes:
            roots = getattr(node.block.trace, method)
            made = self._computed(node, list(roots.values()), value, *views) if roots else []
            found |= {_own(node, name): one for name, one in zip(roots, made, strict=True)}
        return found

    def prepare(self, p: Any, t: Clock) -> Any:
        """Compute the derived parameters of all blocks."""
        found = dict[str, Any]()
        for node in self.nodes:
            roots = node.block.trace.prepare
            given = {one.name: p[_own(node, one.name)] for one in node.block.params} if roots else {}
            made = computed(list(roots.values()), {}, {}, given, t)
            found |= {_own(node, name): one for name, one in zip(roots, made, strict=True)}
        return found


def _own(node: PlacedBlock, name: str) -> str:
    return f"{node.path}_{name}".replace(".", "_")


# --- algebraic loops

TURNS = 20
"""Steps of Newton's method: a loop that is linear needs one."""
NEAR = 1e-6
"""How near to its solution a loop is, relative to it where it is above 1; otherwise it has none that was found."""


LONGEST_CUT = 6
"""Most elements of an output for which a loop is solved."""


class Solved(Joined):
    """An algebraic loop, solved for one output, the `cut`, by Newton's method from `guess`; NaN where that fails.

    Slopes are difference quotients, as Simulink's solver takes them; Simulink ends the simulation where it fails.
    """

    def __init__(
        self, network: Network, paths: Iterable[str], given: Mapping[Key, str], cut: Key, shown: Mapping[str, Key]
    ) -> None:
        super().__init__(network, paths, given)
        if {one.continuous for one in self.states} == {True, False}:
            raise NotTranslated("it has discrete and continuous states")
        self.cut, self.shown = cut, {"solution": cut, **shown}
        ports = {(node.path, port.name): port for node, port in self._of("outputs")}
        self.inputs = [replace(_port(network, key), name=name) for key, name in self.given.items()]
        self.inputs.append(replace(ports[cut], name="guess", unit=""))
        self.outputs = [replace(ports[key], name=name) for name, key in self.shown.items()]

    def _solved(self, u: Any, *views: Any) -> Callable[[Key], Any]:
        def distance(z: Any) -> Any:
            return self.anew(self.cut, self.values({self.cut: z}, u, *views), *views) - z

        def turn(i: Any, *z: Any) -> list[Any]:
            left, steps = _elements(distance(_joined(z))), [(abs(one) + 1.0) * 2.0**-12 for one in z]
            moved = ([*z[:k], z[k] + step, *z[k + 1 :]] for k, step in enumerate(steps))
            ahead = [_elements(distance(_joined(one))) for one in moved]
            slopes = [(a - b) / step for there, step in zip(ahead, steps, strict=True)
                      for a, b in zip(there, left, strict=True)]  # fmt: skip
            there = reduce(and_, (one == 0.0 for one in left))
            return [where(there, one, one - move) for one, move in zip(z, _solution(slopes, left), strict=True)]

        z = list(fold(TURNS, _elements(u.guess), turn))
        left = _elements(distance(_joined(z)))
        near = [abs(away) <= (abs(one) + 1.0) * NEAR for away, one in zip(left, z, strict=True)]
        z = [where(is_near, one, float("nan")) for is_near, one in zip(near, z, strict=True)]
        return self.values({self.cut: _joined(z)}, u, *views)

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """Solve the loop and compute the outputs that others read."""
        value = self._solved(u, x, p, t)
        return {name: value(key) for name, key in self.shown.items()}

    def _moved(self, method: str, u: Any, x: Any, p: Any, t: Clock) -> Any:
        if not any(getattr(node.block.trace, method) for node in self.nodes):
            return {}
        return self.moved(method, self._solved(u, x, p, t), x, p, t)

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """Return the next discrete states of all blocks."""
        return self._moved("update", u, x, p, t)

    def derivative(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """Return the slopes of the continuous states of all blocks."""
        return self._moved("derivative", u, x, p, t)

    def project(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """Return the continuous states that jump."""
        return self._moved("project", u, x, p, t)


def _elements(value: Any) -> list[Any]:
    return [value[k] for k in range(len(value))] if shape_of(value) else [value]


def _joined(elements: Sequence[Any]) -> Any:
    return vector(list(elements)) if len(elements) > 1 else elements[0]


def _solution(slopes: list[Any], left: list[Any]) -> list[Any]:
    """Return the solution of a system of equations, by elimination with pivoting; its columns are side by side."""
    code, count = of_library("mldivide"), len(left)
    assert code is not None
    given = [filled((count, count), slopes), filled((count, 1), left)]
    return list(as_array(call(code, code.main, given, Evaluation({}))["x"]).flat)


def _port(network: Network, key: Key) -> Any:
    if not key[0]:
        return network.root.diagram.inputs[key[1]]
    return next(port for port in network.nodes[key[0]].block.outputs if port.name == key[1])


def with_solved_loops(diagram: Diagram) -> list[str]:
    """Put a block that solves it in place of each algebraic loop of few real numbers. Return a note on each.

    A loop that it cannot solve is left as it is. Inner ones come first: others may go through their subsystem.
    """
    notes = list[str]()
    for loop in sorted(Network(diagram).loops(), key=_depth, reverse=True):
        network = Network(diagram)  # the loops before may have changed it
        try:
            if all(key[0] in network.nodes for key in loop):
                notes.append(_solve(network, loop))
        except NotTranslated as why:
            notes.append(f"an algebraic loop over {min(loop)[0]} is not solved: {why}")
    return notes


def _depth(loop: set[Key]) -> int:
    """Return how many subsystems are around all of a loop."""
    around = zip(*(path.split(".")[:-1] for path, _ in loop), strict=False)
    return sum(1 for _ in takewhile(lambda names: len(set(names)) == 1, around))


def _solve(network: Network, loop: set[Key]) -> str:
    """Put the parts of the innermost diagram around a loop into one block."""
    level = network.root
    while len(inside := {path[len(level.prefix) :].partition(".")[0] for path, _ in loop}) == 1 and (
        (name := next(iter(inside))) in level.below
    ):
        level = level.below[name]
    paths = [n for n in network.nodes if n.startswith(level.prefix) and n[len(level.prefix) :].split(".")[0] in inside]
    diagram, members = level.diagram, set(paths)
    widths = {key: _width(network, key) for key in loop}
    known = sorted((width, key) for key, width in widths.items() if 0 < width <= LONGEST_CUT)
    cuts = [key for _, key in known if _cuts(network, key, loop)]
    if not cuts:
        raise NotTranslated(f"no output of at most {LONGEST_CUT} real numbers cuts it")
    if any(other.isdisjoint(loop) and any(path in members for path, _ in other) for other in network.loops()):
        raise NotTranslated("another one goes through the same subsystems")
    given, sources = dict[Key, str](), dict[str, str]()
    for node in (network.nodes[path] for path in paths):
        for wanted in node.block.inputs:
            way, driver = _outside(network, level, node, wanted.name)
            if driver is not None and driver[0] not in members and driver not in given:
                if not way or diagram.source(way)[0] in inside:
                    raise NotTranslated(f"{'.'.join(driver)} only passes through it")
                given[driver] = f"u{len(given) + 1}"
                sources[given[driver]] = way
    shown = dict[str, str]()  # source in the diagram: output of the block
    keys = dict[str, Key]()
    conditions = [getattr(one, what) for one in diagram.parts.values() for what in CONDITIONS]
    for source in [*diagram.connections.values(), *diagram.outputs.values(), *conditions]:
        inner, port = diagram.source(source) if source else (None, "")
        if inner not in inside or source in shown:
            continue
        key = network.origin(level, f"{inner}.{port}")
        if key is None or key[0] not in members:
            raise NotTranslated(f"{source} only passes through it")
        if not any(one.name == key[1] for one in network.nodes[key[0]].block.outputs):
            raise NotTranslated("a bus leaves it")
        shown[source] = f"y{len(keys) + 1}"
        keys[shown[source]] = key
    block = Solved(network, paths, given, cuts[0], keys)
    name = f"loop_of_{min(inside)}"
    while name in diagram.parts or name in diagram.inputs:
        name += "_"
    place, turned = diagram.parts[min(inside)].position, {one: f"{name}.{port}" for one, port in shown.items()}
    for one in inside:
        del diagram.parts[one]
    for part in diagram.parts.values():
        for what in CONDITIONS:
            setattr(part, what, turned.get(getattr(part, what), getattr(part, what)))
    kept = {end: source for end, source in diagram.connections.items() if end[0] not in inside}
    diagram.connections = {end: turned.get(source, source) for end, source in kept.items()}
    diagram.outputs = {end: source and turned.get(source, source) for end, source in diagram.outputs.items()}
    diagram.add(name, block, position=place)
    width = widths[cuts[0]]
    guess = UnitDelay(0.0) if width == 1 else UnitDelay([0.0] * width, "real", width)
    diagram.add(f"{name}_guess", guess, u=f"{name}.solution")
    for entry, way in {**sources, "guess": f"{name}_guess"}.items():
        diagram.connect(way, f"{name}.{entry}")
    return f"an algebraic loop over {', '.join(sorted(inside))[:80]} is solved by {TURNS} steps of Newton's method"


def _outside(network: Network, level: NestedDiagram, node: PlacedBlock, port: str) -> tuple[str, Key | None]:
    """Return what drives an input of a block, and the source in the level by which it comes into its part."""
    at, source = node.level, node.level.diagram.feed(node.part.name, port)
    driver = network.origin(at, source)
    while source is not None and at is not level:
        part, name = at.diagram.source(source)
        if part is not None or at.above is None:
            return "", driver
        source, at = at.above.diagram.feed(at.name, name), at.above
    return source or "", driver


def _width(network: Network, key: Key) -> int:
    """Return how many real numbers an output has; 0 of another type."""
    port = _port(network, key)
    return 0 if port.kind != "real" or port.shape else port.width or 1


def _cuts(network: Network, cut: Key, loop: set[Key]) -> bool:
    """Return True if a loop without this output is none."""
    left = loop - {cut}
    while free := {key for key in left if not left.intersection(network.needs(key))}:
        left -= free
    return not left


# --- iterated subsystems


@dataclass(frozen=True)
class Iteration:
    """How a subsystem is iterated: `count` times, None where an output says it, or while an output is true.

    `extra` outputs after the others: the count of a For Iterator, the condition of a While Iterator and whether it is
    iterated at all. `first` is the first number, `most` the greatest number of turns; it is ours where it is `bounded`.
    """

    most: int
    extra: int
    first: int = 1
    loops: bool = False
    held: bool = True
    bounded: bool = False


class Iterated(Joined):
    """A diagram that acts several times in a step. Its last input has the type of the number of the turn.

    Its states go from turn to turn; they are initial in each step, or are kept with `held`. The outputs are those of
    the last turn, and are kept where there is none.
    """

    def __init__(self, diagram: Diagram, iteration: Iteration) -> None:
        network = Network(diagram)
        super().__init__(network, network.nodes, {("", name): name for name in diagram.inputs})
        self.iteration, self.inputs = iteration, list(diagram.inputs.values())
        ends = {name: network.origin(network.root, source) for name, source in diagram.outputs.items()}
        if any(key is None for key in ends.values()) or any(one.continuous for one in self.states):
            raise NotTranslated("its outputs are not connected, are buses, or it has continuous states")
        self.ends = {name: key for name, key in ends.items() if key is not None}
        ports = [replace(_port(network, key), name=name) for name, key in self.ends.items()]
        self.outputs = ports[: len(ports) - iteration.extra]
        self.own = list(self.states)
        last = [_kept(port) for port in self.outputs]
        self.states = [*(self.own if iteration.held else ()), *last]

    def _run(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, Any]:
        """Return the states, and the outputs, after the last turn."""
        how, counter = self.iteration, self.inputs[-1]
        first = {s.name: x[s.name] if how.held else _constant(s, p) for s in self.own}
        carried = [*self.own, *(_kept(port) for port in self.outputs)]
        start = {**first, **{one.name: x[one.name] for one in carried if one.name not in first}}
        extras = list(self.ends.values())[len(self.outputs) :]

        def values(number: Any, states: Mapping[str, Any]) -> Callable[[Key], Any]:
            return self.values({("", counter.name): convert(number, counter.kind)}, u, states, p, t)

        before = values(int32(how.first), start)
        limit, goes = int32(how.most), int32(1)
        if how.loops and len(extras) > 1:
            goes = where(_true(before(extras[1])), int32(1), int32(0))
        elif not how.loops and extras:
            limit = convert(convert(before(extras[0]), "real"), "int32")

        def turn(i: Any, goes: Any, *scalars: Any) -> list[Any]:
            states = _together(carried, scalars)
            value = values(i + int32(how.first), states)
            after = {**states, **self.moved("update", value, states, p, t)}
            after |= {_kept(port).name: value(self.ends[port.name]) for port in self.outputs}
            acts = (goes != 0) & (i < limit)
            on = where(_true(value(extras[0])), goes, int32(0)) if how.loops and extras else goes
            return [on, *(where(acts, new, old) for new, old in zip(_apart(carried, after), scalars, strict=True))]

        _, *scalars = fold(how.most, [goes, *_apart(carried, start)], turn)
        return _together(carried, scalars)

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """Return the outputs of the last turn."""
        found = self._run(u, x, p, t)
        return {port.name: found[_kept(port).name] for port in self.outputs}

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """Keep the outputs, and the states if they are held."""
        found = self._run(u, x, p, t)
        return {one.name: found[one.name] for one in self.states}


def _kept(port: Any) -> State:
    zero = False if port.kind == "bool" else 0.0 if port.kind in FLOATS else 0
    start: Any = zero if port.width is None else [zero] * port.width
    start = [[zero] * port.shape[1]] * port.shape[0] if port.shape else start
    return State(f"last_{port.name}", start, port.kind, port.width, shape=port.shape)


def _constant(state: State, p: Any) -> Any:
    """Return a state's initial value."""
    if isinstance(state.initial, str):
        return flat_of(p[state.initial])
    values = [convert(v, state.kind) for v in np.asarray(state.initial).flatten(order="F").tolist()]
    return values[0] if state.width is None else vector(values)


def _apart(states: Sequence[State], values: Mapping[str, Any]) -> list[Any]:
    """Return the elements of all states side by side, as a loop carries them."""
    flat = [(one, flat_of(values[one.name])) for one in states]
    elements = [(s, one) for s, v in flat for one in ([v] if s.width is None else [v[k] for k in range(s.width)])]
    return [convert(one, "int32") if s.kind in STORED else one for s, one in elements]


def _together(states: Sequence[State], scalars: Sequence[Any]) -> dict[str, Any]:
    """Return the states by name from their elements side by side."""
    found, rest = dict[str, Any](), iter(scalars)
    for one in states:
        elements = [convert(next(rest), one.kind) for _ in range(one.width or 1)]
        found[one.name] = elements[0] if one.width is None else vector(elements)
    return found


def _true(value: Any) -> Any:
    return convert(value, "real") != 0.0
