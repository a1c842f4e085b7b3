"""Run scenarios on the reference or a compiled target, and judge them."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.datatypes.enumeration import Enumeration
from twodof.blocks.diagram import Diagram
from twodof.blocks.machine import Machine
from twodof.blocks.reference.interpreter import Reference
from twodof.compile.builder import build
from twodof.compile.diagram_test.assertions import Assertion
from twodof.compile.diagram_test.judgement import Judgement, ScenarioResult
from twodof.compile.diagram_test.plan import Plan, plan
from twodof.compile.diagram_test.scenario import ExpectedColumn, Scenario, expected_column
from twodof.compile.diagram_test.signal_element import element_of, parse_element
from twodof.errors import DiagramError, ParameterError

REFERENCE = "reference"
DT = 0.004
"""The control period [s], and the base tick of tests that do not say another one."""


class Program(Protocol):
    """A diagram ready to run, interpreted or compiled."""

    def machine(self) -> Machine:
        """A fresh instance in its initial state."""


def run_scenario(diagram: Diagram, scenario: Scenario, dt: float = DT, **options: Any) -> ScenarioResult:
    """One scenario, run and judged; `options` and errors as those of `run_scenarios`."""
    return run_scenarios(diagram, [scenario], dt, **options)[0]


def run_scenarios(
    diagram: Diagram,
    scenarios: Sequence[Scenario],
    dt: float = DT,
    precision: str = "float64",
    target: str = "native",
    integrator: str = "rk4",
    log: Iterable[str] = (),
) -> list[ScenarioResult]:
    """Each scenario, run from the initial state at the base tick `dt` [s], and judged.

    `target` is "reference", or one of `build`: "native", "wasm", "cortex-m7"; all give the same bits. `log` are paths
    of further signals that the results keep. Raises DiagramError for a scenario that does not fit the diagram,
    ParameterError for a parameter, and what `build` raises.
    """
    plans = [plan(diagram, scenario, dt) for scenario in scenarios]
    wanted = frozenset(log).union(*(p.paths for p in plans))
    paths = sorted(path for path in wanted if not diagram.gives(path))
    program: Program
    if target == REFERENCE:
        program = Reference(diagram, dt, precision, paths, integrator)
    else:
        program = build(diagram, dt, precision, paths, integrator, target=target)
    return [judged(p, run_plan(p, program.machine()), dt) for p in plans]


def run_plan(planned: Plan, machine: Machine) -> dict[str, NDArray[Any]]:
    """The signals of a run of a scenario on a fresh machine, by name, each of `steps` rows."""
    if planned.scenario.parameters:
        try:
            machine.set_many(planned.scenario.parameters)
        except ParameterError as error:
            where = f"{planned.scenario.name}, {error.where}".rstrip(", ")
            raise ParameterError(error.what, where, error.remedy) from error
        machine.reset()  # initial states may be parameters
    return machine.run(planned.steps, planned.inputs)


def _named(judgement: Judgement, enumeration: Enumeration | None) -> Judgement:
    """`judgement` with the members' names in its text, if it says what value is wrong."""
    value, limit, time = judgement.value, judgement.limit, judgement.time
    if enumeration is None or value is None or limit is None or time is None:
        return judgement
    names = [enumeration.name_of(round(v) if math.isfinite(v) else v) for v in (value, limit)]
    _, more, count = judgement.text.partition("; ")
    return replace(judgement, text=f"{names[0]} at {time:.6g} s is not {names[1]}{more}{count.partition(',')[0]}")


def judged(planned: Plan, signals: dict[str, NDArray[Any]], dt: float) -> ScenarioResult:
    """What is found of a scenario in the signals of its run. Raises DiagramError for a claim about no tick of it."""
    table, name = planned.scenario.table, planned.scenario.name
    claims: list[tuple[Assertion | ExpectedColumn, NDArray[Any]]] = [
        (check, element_of(signals, check.signal, f"{name}, {check.text}")) for check in planned.checks
    ]
    for column, signal in planned.expected:
        assert table is not None
        values = element_of(signals, signal, f"{name}, {column}")
        whole = values.dtype.kind != "f"
        claims.append((expected_column(table, column, signal, whole, planned.steps, dt), values))
    try:
        found = (claim.judge(values.astype(np.float64), dt) for claim, values in claims)
        judgements = tuple(_named(j, planned.enumerations.get(parse_element(j.signal, name)[0])) for j in found)
    except DiagramError as error:
        raise DiagramError(error.what, f"{name}, {error.where}", error.remedy) from error
    tables = {c.text: (dt * c.ticks.astype(np.float64), c.expected) for c, _ in claims if isinstance(c, ExpectedColumn)}
    return ScenarioResult(name, judgements, dt * np.arange(planned.steps, dtype=np.float64), signals, tables)
