"""Tests of a user's diagram: scenarios, assertions over time, expected tables and coverage of decisions.

They run from a file (`twodof diagram test`) and in Python, inside pytest; see docs/how-to/test-a-diagram.md.
"""

from twodof.compile.diagram_test.assertions import Assertion as Assertion
from twodof.compile.diagram_test.assertions import Judgement as Judgement
from twodof.compile.diagram_test.assertions import assertion as assertion
from twodof.compile.diagram_test.coverage import Coverage as Coverage
from twodof.compile.diagram_test.coverage import Decision as Decision
from twodof.compile.diagram_test.coverage import measure_coverage as measure_coverage
from twodof.compile.diagram_test.run_scenarios import run_scenario as run_scenario
from twodof.compile.diagram_test.run_scenarios import run_scenarios as run_scenarios
from twodof.compile.diagram_test.run_scenarios import to_junit as to_junit
from twodof.compile.diagram_test.scenario import ExpectedTable as ExpectedTable
from twodof.compile.diagram_test.scenario import InputSignal as InputSignal
from twodof.compile.diagram_test.scenario import PointsInput as PointsInput
from twodof.compile.diagram_test.scenario import RampInput as RampInput
from twodof.compile.diagram_test.scenario import Scenario as Scenario
from twodof.compile.diagram_test.scenario import ScenarioResult as ScenarioResult
from twodof.compile.diagram_test.scenario import SignalTable as SignalTable
from twodof.compile.diagram_test.scenario import SineInput as SineInput
from twodof.compile.diagram_test.scenario import StepInput as StepInput
from twodof.compile.diagram_test.scenario import read_table as read_table
from twodof.compile.diagram_test.scenario import table_of as table_of
from twodof.compile.diagram_test.scenario_file import ScenarioFile as ScenarioFile
from twodof.compile.diagram_test.scenario_file import read_scenarios as read_scenarios
