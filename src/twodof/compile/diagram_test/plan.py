"""Plan: a scenario made to fit a diagram, its inputs as arrays."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.block import Block
from twodof.blocks.datatypes.enumeration import Enumeration
from twodof.blocks.declarations import Port
from twodof.blocks.diagram import Diagram, carried
from twodof.blocks.expressions.kinds import BY_NAME, FLOATS
from twodof.blocks.machine import axes
from twodof.compile.diagram_test.assertions import Assertion, assertion
from twodof.compile.diagram_test.input_signals import ConstantInput, InputSignal, between_rows
from twodof.compile.diagram_test.scenario import INPUT, OUTPUT, ExpectedTable, Scenario
from twodof.compile.diagram_test.signal_element import Index, check_index, parse_element
from twodof.compile.diagram_test.tick_times import last_tick
from twodof.errors import DiagramError, nearest, shown

MAX_TICKS = 1_000_000

Elements = dict[str, dict[Index, NDArray[np.float64]]]
"""Values of inputs by name and element, each of shape (steps,)."""


@dataclass(frozen=True, eq=False)
class Plan:
    """A scenario that fits a diagram.

    `inputs` are arrays of `steps` rows in the ports' types. `checks` are its assertions, `expected` the columns of its
    table that are expected, with the signal's name (or path, perhaps with an index). `paths` are the signals to log.
    `enumerations` are those of signals that are of one, by name.
    """

    scenario: Scenario
    steps: int
    inputs: dict[str, NDArray[Any]]
    checks: tuple[Assertion, ...]
    expected: tuple[tuple[str, str], ...]
    paths: frozenset[str]
    enumerations: Mapping[str, Enumeration]


def plan(diagram: Diagram, scenario: Scenario, dt: float) -> Plan:
    """`scenario` for `diagram` at the base tick `dt` [s].

    Raises DiagramError for an input or output that is not there, and for a scenario that claims nothing. It does so too
    for an input that is fed twice, or with values that are not of its type.
    """
    scenario = _named(diagram, scenario)
    steps = _steps(scenario, dt)
    elements: Elements = {}
    for name, value in scenario.inputs.items():
        where = f"{scenario.name}, {name}"
        port = _input(diagram, name, where)
        given = _signals(value, axes(port), where, port.enum)
        elements[name] = {i: s.values(steps, dt, port.kind not in FLOATS) for i, s in given.items()}
    checks = tuple(
        assertion(c, lambda s, name: _member(diagram, s, name, scenario.name)) if isinstance(c, str) else c
        for c in scenario.checks
    )
    expected = tuple(_read_table(diagram, scenario, steps, dt, elements)) if scenario.table else ()
    if not (checks or expected):
        raise DiagramError("it claims nothing", scenario.name, "add checks, or a table with a column of an output")
    names = {parse_element(signal, scenario.name)[0]: what for what, signal in expected}
    names |= {parse_element(check.signal, scenario.name)[0]: check.text for check in checks}
    for name, what in names.items():
        if name.partition(".")[0] not in diagram.outputs and "." not in name:
            outputs = nearest(name, diagram.outputs)
            raise DiagramError(
                f"there is no output {shown(name)}",
                f"{scenario.name}, {what}",
                f"outputs: {outputs}; the path of a signal inside is part.port",
            )
    inputs = {
        name: _column(diagram.inputs[name], by_element, steps, f"{scenario.name}, {name}")
        for name, by_element in elements.items()
    }
    found = {name: _enumeration(diagram, name) for name in names}
    enumerations = {name: e for name, e in found.items() if e is not None}
    return Plan(
        scenario, steps, inputs, checks, expected, frozenset(n for n in names if not diagram.gives(n)), enumerations
    )


def _enumeration(diagram: Diagram, path: str) -> Enumeration | None:
    """The enumeration of which the signal at `path` is: an input, an output, or part.port."""
    found: Enumeration | None
    if path in diagram.inputs:
        found = diagram.inputs[path].enum
        return found
    item: Block | Diagram = diagram
    while isinstance(item, Diagram) and "." in path and path.partition(".")[0] in item.parts:
        name, _, path = path.partition(".")
        item = item.parts[name].item
    try:
        port = carried(item, path)
    except DiagramError:  # which the build says
        return None
    found = None if port is None else port.enum
    return found


def _member(diagram: Diagram, signal: str, name: str, scenario: str) -> float:
    """The number of a signal's value that is named."""
    enumeration = _enumeration(diagram, parse_element(signal, scenario)[0])
    if enumeration is None:
        remedy = f"{signal} is not of an enumeration: write a number"
        raise DiagramError(f"{shown(name)} is not a number", f"{scenario}, {signal}", remedy)
    return float(enumeration.plain(name, f"{scenario}, {signal}"))


def _named(diagram: Diagram, scenario: Scenario) -> Scenario:
    """`scenario` with the numbers of the members that its table names."""
    if scenario.table is None or not scenario.table.table.words:
        return scenario
    found = {}
    for column in scenario.table.table.words:
        signal = column.removeprefix(INPUT).removeprefix(OUTPUT).strip()
        found[column] = _enumeration(diagram, parse_element(signal, f"{scenario.name}, {column}")[0])
    table = replace(scenario.table, table=scenario.table.table.with_members(found))
    return replace(scenario, table=table)


def _steps(scenario: Scenario, dt: float) -> int:
    if scenario.duration is not None:
        duration = float(scenario.duration)
        last = last_tick(duration, dt) if 0.0 <= duration < MAX_TICKS * dt else -1
    elif scenario.table is not None:
        last = int(scenario.table.table.ticks_of(dt)[-1])
    else:
        raise DiagramError("it has no duration", scenario.name, "say how many seconds it lasts")
    if not 0 <= last < MAX_TICKS:
        raise DiagramError(f"a duration of {shown(scenario.duration)} s", scenario.name, f"run 1 to {MAX_TICKS} ticks")
    return last + 1


def _input(diagram: Diagram, name: str, where: str) -> Port:
    if name not in diagram.inputs:
        raise DiagramError(f"there is no input {shown(name)}", where, f"inputs: {nearest(name, diagram.inputs)}")
    return diagram.inputs[name]


def _signals(
    value: Any, sizes: tuple[int, ...], where: str, enumeration: Enumeration | None = None
) -> dict[Index, InputSignal]:
    """A signal for each element of a port with these axes; one alone is that of all elements."""
    if isinstance(value, (list, tuple)):
        if not sizes or len(value) != sizes[0]:
            what = f"an array of {' x '.join(map(str, sizes))}" if sizes else "a number"
            raise DiagramError(f"{len(value)} values for {what}", where, "give one for each row or element")
        return {
            (i, *below): signal
            for i, one in enumerate(value)
            for below, signal in _signals(one, sizes[1:], where, enumeration).items()
        }
    if isinstance(value, str) and enumeration is not None:
        value = enumeration.plain(value, where)
    if isinstance(value, (bool, int, float, np.number, np.bool_)):
        value = ConstantInput(float(value))
    if not isinstance(value, InputSignal):
        raise DiagramError(f"{shown(value)} is not a signal", where, "give a number or a signal such as StepInput")
    return dict.fromkeys(np.ndindex(*sizes), value)


def _read_table(
    diagram: Diagram, scenario: Scenario, steps: int, dt: float, elements: Elements
) -> Iterator[tuple[str, str]]:
    """Adds the table's inputs to `elements`; gives its other columns, each with the signal that it expects."""
    given = scenario.table
    assert given is not None
    for column in given.table.columns:
        where = f"{scenario.name}, {given.table.name}, {column}"
        signal = column.removeprefix(INPUT).removeprefix(OUTPUT).strip()
        name, index = parse_element(signal, where)
        marked = column.startswith((INPUT, OUTPUT))
        if not marked and name in diagram.inputs and name in diagram.outputs:
            raise DiagramError(
                "an input and an output have this name", where, f'write "{INPUT}{name}" or "{OUTPUT}{name}"'
            )
        if column.startswith(INPUT) or (not marked and name in diagram.inputs):
            port = _input(diagram, name, where)
            check_index(index, axes(port), name, where)
            if index in elements.get(name, {}):
                raise DiagramError("the input is fed twice", where, "keep one of the two")
            elements.setdefault(name, {})[index] = _fed(given, column, port, steps, dt, where)
        else:
            yield column, signal


def _fed(given: ExpectedTable, column: str, port: Port, steps: int, dt: float, where: str) -> NDArray[np.float64]:
    """What a column of the table feeds into an input."""
    ticks = given.table.ticks_of(dt)
    if not given.table.given[column].all():
        raise DiagramError("a cell of an input is empty", where, "fill it, or take the input out of the table")
    if ticks[0] != 0:
        raise DiagramError("the first row is not at 0", where, "say what the input is from the start on")
    return between_rows(ticks, given.table.columns[column], steps, given.between if port.kind in FLOATS else "hold")


def _column(port: Port, elements: dict[Index, NDArray[np.float64]], steps: int, where: str) -> NDArray[Any]:
    """The values of an input in its type; elements that are not given are 0."""
    data = np.zeros((steps, *axes(port)))
    for index, values in elements.items():
        place: tuple[Any, ...] = (slice(None), *index)
        data[place] = values
    found: NDArray[Any] = data
    if port.kind not in FLOATS:
        low, high = BY_NAME[port.kind].low, BY_NAME[port.kind].high
        odd = ~((data == np.rint(data)) & (data >= low) & (data <= high))
        if odd.any():
            value = data[odd][0]
            raise DiagramError(f"{value:g} does not fit {port.kind}", where, f"give whole numbers from {low} to {high}")
        found = data.astype(port.kind)
    if port.enum is not None:
        for value in np.unique(found).tolist():
            port.enum.plain(value, where)
    return found
