"""Ports and topics: templates fit, roles are found, what PX4 has nothing for is refused."""

from pathlib import Path
from typing import Any

import pytest

from tests.compile.px4.modules import pitch, rail
from twodof.blocks import Diagram
from twodof.blocks import library as lib
from twodof.compile.program.lower import lower
from twodof.compile.px4.export import make_module
from twodof.compile.px4.work_item import INPUTS, OUTPUTS, role
from twodof.errors import DiagramError
from twodof.flight.starters import STARTERS, starter
from twodof.flight.templates import TEMPLATES


@pytest.mark.parametrize("template", TEMPLATES.values(), ids=TEMPLATES)
def test_px4_has_every_port_of_the_templates(template: Any) -> None:
    for port in template.inputs:
        assert (INPUTS[port.name].kind, INPUTS[port.name].unit) == (port.kind, port.unit), port.name
    for port in template.outputs:
        assert port.name in OUTPUTS


@pytest.mark.parametrize("name", STARTERS)
def test_every_starter_becomes_a_module(name: str) -> None:
    module = make_module(starter(name))
    commands = {"attitude": "torque", "position": "attitude", "motor": "motors"}[name.rpartition("-")[2]]
    assert module.role.commands == commands


def diagram(inputs: dict[str, dict[str, Any]], outputs: tuple[str, ...]) -> Diagram:
    """A diagram with these ports, all outputs fed by a constant."""
    d = Diagram("ports")
    for name, port in inputs.items():
        d.input(name, **port)
    d.add("zero", lib.Constant(0.0))
    for name in outputs:
        d.output(name, "zero")
    return d


def test_roles() -> None:
    torque, attitude = role(lower(pitch(), 0.004)), role(lower(rail(), 0.004))
    assert (torque.commands, torque.stops) == ("torque", ("mc_rate_control",))
    assert torque.writes == ("vehicle_thrust_setpoint", "vehicle_torque_setpoint")
    assert (attitude.commands, attitude.stops) == ("attitude", ("mc_pos_control",))
    both = role(lower(diagram({"x": {}, "theta": {}, "theta_0": {}}, ("M", "thrust", "theta_0")), 0.004))
    assert (both.commands, both.stops) == ("torque", ("mc_rate_control", "mc_pos_control"))
    motors = role(lower(diagram({"M_0": {}}, ("motor_1", "motor_2", "motor_3", "motor_4")), 0.004))
    assert (motors.commands, motors.stops) == ("motors", ("control_allocator",))
    assert "vehicle_torque_setpoint" in motors.reads


@pytest.mark.parametrize(
    ("inputs", "outputs", "what"),
    [
        ({"roll": {}}, ("M",), "no signal for its input 'roll'"),
        ({"theta": {"kind": "int32"}}, ("M",), "'theta' is int32"),
        ({"theta": {"width": 2}}, ("M",), "'theta' is real of 2"),
        ({"theta": {"unit": "deg"}}, ("M",), "'theta' is in deg"),
        ({"FLAG_RESET_INT": {}}, ("M",), "'FLAG_RESET_INT' is real"),
        ({"theta": {}}, ("N",), "command nothing"),
        ({"theta": {}}, (), "command nothing"),
        ({"theta": {}}, ("thrust",), "command nothing"),
        ({"theta": {}}, ("motor_1", "motor_2"), "it commands motor_1, motor_2"),
        ({"theta": {}}, ("M", "motor_1", "motor_2", "motor_3", "motor_4"), "it commands M"),
        ({"M_0": {}}, ("M",), "reads M_0 and gives M"),
        ({"theta_0": {}, "x": {}}, ("theta_0", "thrust"), "reads theta_0, which it commands itself"),
        ({}, ("M",), "no inputs"),
    ],
)
def test_ports_that_px4_has_nothing_for_are_refused(inputs: Any, outputs: tuple[str, ...], what: str) -> None:
    with pytest.raises(DiagramError, match=what) as refused:
        make_module(diagram(inputs, outputs))
    assert refused.value.remedy


def test_the_page_names_every_port() -> None:
    page = (Path(__file__).parents[3] / "docs" / "how-to" / "export-to-px4.md").read_text()
    missing = [name for name in {*INPUTS, *OUTPUTS} - {"motor_2", "motor_3"} if f"`{name}`" not in page]
    assert missing == []
