"""Run scenarios on the reference or a compiled target, and judge them."""

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.block import Block
from twodof.blocks.declarations import Port
from twodof.blocks.diagram import Diagram, carried
from twodof.blocks.enumeration import Enumeration
from twodof.blocks.expressions.numbers import BY_NAME, FLOATS
from twodof.blocks.machine import Machine, axes
from twodof.blocks.reference.interpreter import Reference
from twodof.compile.builder import build
from twodof.compile.diagram_test.assertions import (
    Assertion,
    Index,
    Judgement,
    assertion,
    check_index,
    element_of,
    last_tick,
    parse_element,
)
from twodof.compile.diagram_test.scenario import (
    INPUT,
    OUTPUT,
    ExpectedColumn,
    ExpectedTable,
    Scenario,
    ScenarioResult,
    between_rows,
)
from twodof.errors import DiagramError, ParameterError, nearest, printable, shown

REFERENCE = "reference"
DT = 0.004
"""Default base tick of tests [s]: the control period."""
MAX_TICKS = 1_000_000


@dataclass(frozen=True, eq=False)
class ScenarioPlan:
    """A scenario prepared for a diagram.

    `inputs` are arrays of `steps` rows in the ports' types. `claims` are the assertions and the table's expected
    columns. `paths` are the signals to log, `enumerations` those of the signals that are checked, by name.
    """

    scenario: Scenario
    steps: int
    inputs: dict[str, NDArray[Any]]
    claims: tuple[Assertion | ExpectedColumn, ...]
    paths: frozenset[str]
    enumerations: Mapping[str, Enumeration]


def run_scenario(diagram: Diagram, scenario: Scenario, dt: float = DT, **options: Any) -> ScenarioResult:
    """Run and judge one scenario; `options` and errors as those of `run_scenarios`."""
    return run_scenarios(diagram, [scenario], dt, **options)[0]


def run_scenarios(
    diagram: Diagram,
    scenarios: Sequence[Scenario],
    dt: float = DT,
    precision: str = "float64",
    target: str = "native",
    integrator: str = "rk4",
) -> list[ScenarioResult]:
    """Run each scenario from the initial state at the base tick `dt` [s], and judge it.

    `target` is "reference", or one of `build`: "native", "wasm", "cortex-m7"; all give the same bits. Raises
    DiagramError for a scenario that does not fit the diagram, ParameterError for a wrong parameter, and the errors of
    `build`.
    """
    plans = [plan(diagram, scenario, dt) for scenario in scenarios]
    paths = sorted(frozenset[str]().union(*(p.paths for p in plans)))
    program = (
        Reference(diagram, dt, precision, paths, integrator)
        if target == REFERENCE
        else build(diagram, dt, precision, paths, integrator, target=target)
    )
    return [_judged(p, run_plan(p, program.machine()), dt) for p in plans]


def run_plan(planned: ScenarioPlan, machine: Machine) -> dict[str, NDArray[Any]]:
    """Run a scenario on a fresh machine, and return its signals by name, each of `steps` rows."""
    if planned.scenario.parameters:
        try:
            machine.set_many(planned.scenario.parameters)
        except ParameterError as error:
            where = f"{planned.scenario.name}, {error.where}".rstrip(", ")
            raise ParameterError(error.what, where, error.remedy) from error
        machine.reset()  # initial states may be parameters
    return machine.run(planned.steps, planned.inputs)


def _judged(planned: ScenarioPlan, signals: dict[str, NDArray[Any]], dt: float) -> ScenarioResult:
    """Judge the signals of a scenario. Raises DiagramError for a claim about a time outside it."""
    scenario, claims = planned.scenario, planned.claims
    name = scenario.name
    judgements = []
    for claim in claims:
        values = element_of(signals, claim.signal, f"{name}, {claim.text}").astype(np.float64)
        try:
            found = claim.judge(values, dt)
        except DiagramError as error:
            raise DiagramError(error.what, f"{name}, {error.where}", error.remedy) from error
        judgements.append(_with_names(found, planned.enumerations.get(parse_element(claim.signal, name)[0])))
    tables = {c.text: (dt * c.ticks.astype(np.float64), c.expected) for c in claims if isinstance(c, ExpectedColumn)}
    return ScenarioResult(name, tuple(judgements), dt * np.arange(planned.steps, dtype=np.float64), signals, tables)


def _with_names(judgement: Judgement, enumeration: Enumeration | None) -> Judgement:
    """Return `judgement` with the names of an enumeration's members in its text."""
    if enumeration is None or judgement.value is None or judgement.limit is None:
        return judgement
    found, limit = (enumeration.name_of(round(v) if isfinite(v) else v) for v in (judgement.value, judgement.limit))
    _, more, count = judgement.text.partition("; ")
    text = f"{found} at {judgement.time:.6g} s is not {limit}{more}{count.partition(',')[0]}"
    return replace(judgement, text=text)


def plan(diagram: Diagram, scenario: Scenario, dt: float) -> ScenarioPlan:
    """Prepare `scenario` for `diagram` at the base tick `dt` [s].

    Raises DiagramError for a scenario without checks, an unknown input or output, an input that is given twice, and
    values that do not fit an input's type.
    """
    steps = _steps(scenario, dt)
    inputs: dict[str, NDArray[Any]] = {}
    fed: set[tuple[str, Index]] = set()

    def feed(name: str, index: Index, values: NDArray[np.float64], where: str) -> None:
        if (name, index) in fed:
            raise DiagramError("the input is given twice", where, "keep one of the two")
        fed.add((name, index))
        element: tuple[Any, ...] = (slice(None), *index)
        inputs.setdefault(name, np.zeros((steps, *axes(diagram.inputs[name]))))[element] = values

    for name, value in scenario.inputs.items():
        where = f"{scenario.name}, {name}"
        port = _input(diagram, name, where)
        for index, one in _elements(value, axes(port), where):
            feed(name, index, _values(one, port, steps, dt, where), where)

    def enumeration_of(signal: str) -> Enumeration | None:
        port = _port(diagram, parse_element(signal, scenario.name)[0])
        found: Enumeration | None = None if port is None else port.enum
        return found

    expected: list[ExpectedColumn] = []
    table = scenario.table
    for column in table.table.cells if table else ():
        assert table is not None
        where = f"{scenario.name}, {column}"
        signal = column.removeprefix(INPUT).removeprefix(OUTPUT).strip()
        name, index = parse_element(signal, where)
        feeds = name in diagram.inputs and not column.startswith(OUTPUT)
        if feeds and name in diagram.outputs and not column.startswith(INPUT):
            remedy = f'write "{INPUT}{name}" or "{OUTPUT}{name}"'
            raise DiagramError("an input and an output have this name", where, remedy)
        if feeds or column.startswith(INPUT):
            port = _input(diagram, name, where)
            check_index(index, axes(port), name, where)
            feed(name, index, _of_table(table, column, port, steps, dt, where), where)
        else:
            given = _port(diagram, name)
            whole = given is not None and given.kind not in FLOATS
            expected.append(table.expected(column, signal, whole, steps, dt, enumeration_of(signal)))

    def member(signal: str, name: str) -> float:
        enumeration = enumeration_of(signal)
        if enumeration is None:
            remedy = f"{signal} is not of an enumeration: write a number"
            raise DiagramError(f"{shown(name)} is not a number", f"{scenario.name}, {signal}", remedy)
        return float(enumeration.plain(name, f"{scenario.name}, {signal}"))

    checks = (assertion(c, member) if isinstance(c, str) else c for c in scenario.checks)
    claims: tuple[Assertion | ExpectedColumn, ...] = (*checks, *expected)
    if not claims:
        raise DiagramError("it checks nothing", scenario.name, "add checks, or a table with a column of an output")
    names = {parse_element(claim.signal, scenario.name)[0]: claim.text for claim in reversed(claims)}
    for name, what in names.items():
        if name not in diagram.outputs and "." not in name:
            remedy = f"outputs: {nearest(name, diagram.outputs)}; the path of a signal inside is part.port"
            raise DiagramError(f"no output named {shown(name)}", f"{scenario.name}, {what}", remedy)
    typed = {name: _typed(diagram.inputs[name], data, f"{scenario.name}, {name}") for name, data in inputs.items()}
    enumerations = {name: found for name in names if (found := enumeration_of(name)) is not None}
    return ScenarioPlan(
        scenario, steps, typed, claims, frozenset(n for n in names if not diagram.gives(n)), enumerations
    )


def _steps(scenario: Scenario, dt: float) -> int:
    if scenario.duration is not None:
        last = last_tick(scenario.duration, dt) if 0.0 <= scenario.duration < MAX_TICKS * dt else -1
    elif scenario.table is not None:
        last = int(scenario.table.table.ticks_of(dt)[-1])
    else:
        raise DiagramError("it has no duration", scenario.name, "give its duration in seconds")
    if not 0 <= last < MAX_TICKS:
        what = f"the duration of {shown(scenario.duration)} s is out of bounds"
        raise DiagramError(what, scenario.name, f"run 1 to {MAX_TICKS} ticks")
    return last + 1


def _input(diagram: Diagram, name: str, where: str) -> Port:
    if name not in diagram.inputs:
        raise DiagramError(f"no input named {shown(name)}", where, f"inputs: {nearest(name, diagram.inputs)}")
    return diagram.inputs[name]


def _port(diagram: Diagram, path: str) -> Port | None:
    """Return the declaration of the signal at `path`, an input, an output or part.port; None for an unknown one."""
    item: Block | Diagram = diagram
    while isinstance(item, Diagram) and "." in path and path.partition(".")[0] in item.parts:
        name, _, path = path.partition(".")
        item = item.parts[name].item
    try:
        return diagram.inputs[path] if path in diagram.inputs and item is diagram else carried(item, path)
    except DiagramError:  # the build says so, with the whole path
        return None


def _elements(value: Any, sizes: tuple[int, ...], where: str) -> Iterator[tuple[Index, Any]]:
    """Yield what is given for each element of a port with these axes; a single signal feeds all elements."""
    if not isinstance(value, (list, tuple)):
        yield from ((index, value) for index in np.ndindex(*sizes))
        return
    if not sizes or len(value) != sizes[0]:
        what = f"an array of {' x '.join(map(str, sizes))}" if sizes else "a number"
        raise DiagramError(f"{len(value)} values for {what}", where, "give one for each row or element")
    for i, one in enumerate(value):
        yield from (((i, *below), found) for below, found in _elements(one, sizes[1:], where))


def _values(value: Any, port: Port, steps: int, dt: float, where: str) -> NDArray[np.float64]:
    """Return the values of one element: those of a signal, or a number (the name of a member) at each tick."""
    if isinstance(value, str) and port.enum is not None:
        value = port.enum.plain(value, where)
    if isinstance(value, (bool, int, float, np.number, np.bool_)):
        return np.full(steps, float(value))
    if not hasattr(value, "values"):
        raise DiagramError(f"{shown(value)} is not a signal", where, "give a number or a signal such as StepInput")
    found: NDArray[np.float64] = value.values(steps, dt, port.kind not in FLOATS)
    return found


def _of_table(given: ExpectedTable, column: str, port: Port, steps: int, dt: float, where: str) -> NDArray[np.float64]:
    """Return the values of an input that a table feeds."""
    rows, values = given.table.column(column, port.enum)
    ticks = given.table.ticks_of(dt)
    if len(rows) < len(ticks):
        raise DiagramError("a cell of an input is empty", where, "fill it, or take the input out of the table")
    if ticks[0] != 0:
        raise DiagramError("the first row is not at 0", where, "add a row at 0 with the input's first value")
    return between_rows(ticks, values, steps, given.between if port.kind in FLOATS else "hold")


def _typed(port: Port, data: NDArray[np.float64], where: str) -> NDArray[Any]:
    """Return an input's values in its type."""
    if port.kind in FLOATS:
        return data
    low, high = BY_NAME[port.kind].low, BY_NAME[port.kind].high
    odd = data[~((data == np.rint(data)) & (data >= low) & (data <= high))]
    if odd.size:
        remedy = f"give whole numbers from {low} to {high}"
        raise DiagramError(f"{odd[0]:g} does not fit {port.kind}", where, remedy)
    if port.enum is not None:
        port.enum.plain(np.unique(data).astype(int).tolist(), where)
    return data.astype(port.kind)


def to_junit(results: Mapping[str, Sequence[ScenarioResult]]) -> str:
    """Return the results of each file as JUnit XML: a `testcase` for each assertion, with its scenario as class."""
    root = ElementTree.Element("testsuites")
    for file, scenarios in results.items():
        judgements = [(s, j) for s in scenarios for j in s.judgements]
        counts = {"tests": len(judgements), "failures": sum(not j.passed for _, j in judgements), "errors": 0}
        numbers = {name: str(count) for name, count in counts.items()}
        suite = ElementTree.SubElement(root, "testsuite", name=printable(file), attrib=numbers)
        for scenario, judgement in judgements:
            case = ElementTree.SubElement(suite, "testcase", classname=scenario.name, name=judgement.check)
            if not judgement.passed:
                ElementTree.SubElement(case, "failure", message=printable(judgement.text))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"
