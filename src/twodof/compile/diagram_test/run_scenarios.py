"""Run scenarios on the reference or a compiled target, and judge them."""

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
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
    ConstantInput,
    ExpectedColumn,
    InputSignal,
    Scenario,
    ScenarioResult,
    between_rows,
)
from twodof.errors import DiagramError, ParameterError, nearest, printable, shown

REFERENCE = "reference"
DT = 0.004
"""The control period [s], and the base tick of tests without another one."""
MAX_TICKS = 1_000_000

Elements = dict[str, dict[Index, NDArray[np.float64]]]
"""Values of inputs by name and element, each of shape (steps,)."""


@dataclass(frozen=True, eq=False)
class Plan:
    """A scenario that fits a diagram.

    `inputs` are arrays of `steps` rows in the ports' types. `expected` are the columns of its table that are expected,
    with the signal's name (or path, perhaps with an index). `paths` are the signals to log, `enumerations` those of
    claimed signals, by name.
    """

    scenario: Scenario
    steps: int
    inputs: dict[str, NDArray[Any]]
    checks: tuple[Assertion, ...]
    expected: tuple[tuple[str, str], ...]
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
    DiagramError for a scenario that does not fit the diagram, ParameterError for a parameter, errors of `build`.
    """
    plans = [plan(diagram, scenario, dt) for scenario in scenarios]
    paths = sorted(frozenset[str]().union(*(p.paths for p in plans)))
    program = (
        Reference(diagram, dt, precision, paths, integrator)
        if target == REFERENCE
        else build(diagram, dt, precision, paths, integrator, target=target)
    )
    return [_judged(p, run_plan(p, program.machine()), dt) for p in plans]


def run_plan(planned: Plan, machine: Machine) -> dict[str, NDArray[Any]]:
    """Run a scenario on a fresh machine. Returns its signals by name, each of `steps` rows."""
    if planned.scenario.parameters:
        try:
            machine.set_many(planned.scenario.parameters)
        except ParameterError as error:
            where = f"{planned.scenario.name}, {error.where}".rstrip(", ")
            raise ParameterError(error.what, where, error.remedy) from error
        machine.reset()  # initial states may be parameters
    return machine.run(planned.steps, planned.inputs)


def _judged(planned: Plan, signals: dict[str, NDArray[Any]], dt: float) -> ScenarioResult:
    """Judge the signals of a scenario. Raises DiagramError for a claim about a time outside it."""
    scenario, claims = planned.scenario, list[Assertion | ExpectedColumn](planned.checks)
    name = scenario.name
    for column, signal in planned.expected:
        assert scenario.table is not None
        whole = element_of(signals, signal, f"{name}, {column}").dtype.kind != "f"
        enumeration = planned.enumerations.get(parse_element(signal, name)[0])
        claims.append(scenario.table.expected(column, signal, whole, planned.steps, dt, enumeration))
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
    value, limit, time = judgement.value, judgement.limit, judgement.time
    if enumeration is None or value is None or limit is None or time is None:
        return judgement
    names = [enumeration.name_of(round(v) if math.isfinite(v) else v) for v in (value, limit)]
    _, more, count = judgement.text.partition("; ")
    return replace(judgement, text=f"{names[0]} at {time:.6g} s is not {names[1]}{more}{count.partition(',')[0]}")


def plan(diagram: Diagram, scenario: Scenario, dt: float) -> Plan:
    """Fit `scenario` to `diagram` at the base tick `dt` [s].

    Raises DiagramError for a scenario that claims nothing, an unknown input or output, an input that is fed twice, and
    values that are not of an input's type.
    """
    steps = _steps(scenario, dt)
    elements: Elements = {}
    for name, value in scenario.inputs.items():
        where = f"{scenario.name}, {name}"
        port = _input(diagram, name, where)
        given = _signals(value, axes(port), where, port.enum)
        elements[name] = {i: s.values(steps, dt, port.kind not in FLOATS) for i, s in given.items()}

    def member(signal: str, name: str) -> float:
        enumeration = _enumeration(diagram, parse_element(signal, scenario.name)[0])
        if enumeration is None:
            remedy = f"{signal} is not of an enumeration: write a number"
            raise DiagramError(f"{shown(name)} is not a number", f"{scenario.name}, {signal}", remedy)
        return float(enumeration.plain(name, f"{scenario.name}, {signal}"))

    checks = tuple(assertion(c, member) if isinstance(c, str) else c for c in scenario.checks)
    expected = tuple(_read_table(diagram, scenario, steps, dt, elements))
    if not (checks or expected):
        raise DiagramError("it claims nothing", scenario.name, "add checks, or a table with a column of an output")
    names = {parse_element(signal, scenario.name)[0]: what for what, signal in expected}
    names |= {parse_element(check.signal, scenario.name)[0]: check.text for check in checks}
    for name, what in names.items():
        if name not in diagram.outputs and "." not in name:
            remedy = f"outputs: {nearest(name, diagram.outputs)}; the path of a signal inside is part.port"
            raise DiagramError(f"there is no output {shown(name)}", f"{scenario.name}, {what}", remedy)
    inputs = {
        name: _column(diagram.inputs[name], by_element, steps, f"{scenario.name}, {name}")
        for name, by_element in elements.items()
    }
    enumerations = {name: e for name in names if (e := _enumeration(diagram, name)) is not None}
    paths = frozenset(name for name in names if not diagram.gives(name))
    return Plan(scenario, steps, inputs, checks, expected, paths, enumerations)


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


def _enumeration(diagram: Diagram, path: str) -> Enumeration | None:
    """Return the enumeration of the signal at `path`: an input, an output or part.port."""
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
    except DiagramError:  # the build says so, with the whole path
        return None
    found = None if port is None else port.enum
    return found


def _signals(
    value: Any, sizes: tuple[int, ...], where: str, enumeration: Enumeration | None
) -> dict[Index, InputSignal]:
    """Return a signal for each element of a port with these axes; a single signal feeds all elements."""
    if isinstance(value, (list, tuple)):
        if not sizes or len(value) != sizes[0]:
            what = f"an array of {' x '.join(map(str, sizes))}" if sizes else "a number"
            raise DiagramError(f"{len(value)} values for {what}", where, "give one for each row or element")
        found: dict[Index, InputSignal] = {}
        for i, one in enumerate(value):
            found |= {(i, *below): s for below, s in _signals(one, sizes[1:], where, enumeration).items()}
        return found
    if isinstance(value, str) and enumeration is not None:
        value = enumeration.plain(value, where)
    if isinstance(value, (bool, int, float, np.number, np.bool_)):
        value = ConstantInput(float(value))
    if not hasattr(value, "values"):
        raise DiagramError(f"{shown(value)} is not a signal", where, "give a number or a signal such as StepInput")
    return dict.fromkeys(np.ndindex(*sizes), value)


def _read_table(
    diagram: Diagram, scenario: Scenario, steps: int, dt: float, elements: Elements
) -> Iterator[tuple[str, str]]:
    """Add the table's inputs to `elements`. Yields its other columns, each with the signal that it expects."""
    given = scenario.table
    for column in given.table.cells if given else ():
        assert given is not None
        where = f"{scenario.name}, {given.table.name}, {column}"
        signal = column.removeprefix(INPUT).removeprefix(OUTPUT).strip()
        name, index = parse_element(signal, where)
        marked = column.startswith((INPUT, OUTPUT))
        if not marked and name in diagram.inputs and name in diagram.outputs:
            remedy = f'write "{INPUT}{name}" or "{OUTPUT}{name}"'
            raise DiagramError("an input and an output have this name", where, remedy)
        if not column.startswith(INPUT) and (marked or name not in diagram.inputs):
            yield column, signal
            continue
        port = _input(diagram, name, where)
        check_index(index, axes(port), name, where)
        if index in elements.get(name, {}):
            raise DiagramError("the input is fed twice", where, "keep one of the two")
        rows, values = given.table.column(column, port.enum)
        ticks = given.table.ticks_of(dt)
        if len(rows) < len(ticks):
            raise DiagramError("a cell of an input is empty", where, "fill it, or take the input out of the table")
        if ticks[0] != 0:
            raise DiagramError("the first row is not at 0", where, "say what the input is from the start on")
        between = given.between if port.kind in FLOATS else "hold"
        elements.setdefault(name, {})[index] = between_rows(ticks, values, steps, between)


def _column(port: Port, elements: dict[Index, NDArray[np.float64]], steps: int, where: str) -> NDArray[Any]:
    """Return the values of an input in its type; elements that are not given are 0."""
    data: NDArray[Any] = np.zeros((steps, *axes(port)))
    for index, values in elements.items():
        place: tuple[Any, ...] = (slice(None), *index)
        data[place] = values
    if port.kind not in FLOATS:
        low, high = BY_NAME[port.kind].low, BY_NAME[port.kind].high
        odd = data[~((data == np.rint(data)) & (data >= low) & (data <= high))]
        if odd.size:
            remedy = f"give whole numbers from {low} to {high}"
            raise DiagramError(f"{odd[0]:g} does not fit {port.kind}", where, remedy)
        data = data.astype(port.kind)
    if port.enum is not None:
        for value in np.unique(data).tolist():
            port.enum.plain(value, where)
    return data


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
