"""Tests of a user's diagram: scenarios, assertions over time, expected tables, and which decisions they took.

The same from a file (`twodof diagram test`) and in Python, for use inside pytest; docs/how-to/test-a-diagram.md.
"""

from twodof.compile.diagram_test.assertions import Assertion, Reaches, Stays, assertion
from twodof.compile.diagram_test.coverage.coverage import Coverage, measure_coverage
from twodof.compile.diagram_test.coverage.decisions import Decision
from twodof.compile.diagram_test.input_signals import InputSignal, PointsInput, RampInput, SineInput, StepInput
from twodof.compile.diagram_test.judgement import Judgement, ScenarioResult
from twodof.compile.diagram_test.junit import to_junit
from twodof.compile.diagram_test.run_scenarios import run_scenario, run_scenarios
from twodof.compile.diagram_test.scenario import ExpectedTable, Scenario
from twodof.compile.diagram_test.scenario_file import ScenarioFile, read_scenarios
from twodof.compile.diagram_test.signal_table import SignalTable, read_table, table_of

__all__ = [
    "Assertion",
    "Coverage",
    "Decision",
    "ExpectedTable",
    "InputSignal",
    "Judgement",
    "PointsInput",
    "RampInput",
    "Reaches",
    "Scenario",
    "ScenarioFile",
    "ScenarioResult",
    "SignalTable",
    "SineInput",
    "Stays",
    "StepInput",
    "assertion",
    "measure_coverage",
    "read_scenarios",
    "read_table",
    "run_scenario",
    "run_scenarios",
    "table_of",
    "to_junit",
]
