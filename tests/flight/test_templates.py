"""The templates: the ports SLXtoPX4's controllers have, and what is said of a diagram that has others."""

import pytest

from twodof.blocks import Diagram
from twodof.blocks.library import Constant, FractionalDelay, Gain, Integrator, Mux, Sum
from twodof.errors import DiagramError
from twodof.flight.starters import starter
from twodof.flight.starters.attitude import with_ports
from twodof.flight.templates import (
    ATTITUDE,
    MOTOR,
    POSITION,
    TEMPLATES,
    by_kind,
    check_template,
    kind_of,
    nearest_template,
    template_fit,
)

FLAG = ("bool", "")


def test_the_ports_are_those_of_slxtopx4() -> None:
    def rows(ports: object) -> dict[str, tuple[str, str]]:
        return {p.name: (p.kind, p.unit) for p in ports}  # type: ignore[attr-defined]

    assert rows(ATTITUDE.inputs) == {
        "theta_0": ("real", "rad"),
        "q_0": ("real", "rad/s"),
        "theta": ("real", "rad"),
        "q": ("real", "rad/s"),
        "FLAG_RESET_INT": FLAG,
        "FLAG_ATTITUDE_ENABLED": FLAG,
    }
    assert rows(ATTITUDE.outputs) == {"M": ("real", "")}
    assert rows(POSITION.inputs) == {
        "x_0": ("real", "m"),
        "vx_0": ("real", "m/s"),
        "x": ("real", "m"),
        "vx": ("real", "m/s"),
        "ax_0": ("real", "m/s2"),
        "FLAG_RESET_INT_VEL": FLAG,
        "FLAG_POSITION_ENABLED": FLAG,
    }
    assert rows(POSITION.outputs) == {"thrust": ("real", ""), "theta_0": ("real", "rad")}
    assert [p.name for p in MOTOR.outputs] == ["motor_1", "motor_2", "motor_3", "motor_4"]


def controller() -> Diagram:
    d = with_ports(ATTITUDE, "mine", "")
    d.add("gain", Gain(0.1), u="theta_0")
    d.output("M", "gain")
    return d


def without(d: Diagram, name: str) -> Diagram:
    del d.inputs[name]
    return d


def extra_input(d: Diagram) -> Diagram:
    d.input("wind")
    return d


def extra_output(d: Diagram) -> Diagram:
    d.output("spare", "q")
    return d


def retyped(d: Diagram, kind: str, width: int | None, unit: str) -> Diagram:
    del d.inputs["q_0"]
    d.input("q_0", kind, width, unit)
    return d


def output_of(item: object, **inputs: str) -> Diagram:
    d = with_ports(ATTITUDE, "mine", "")
    d.add("made", item, **inputs)  # type: ignore[arg-type]
    d.output("M", "made")
    return d


@pytest.mark.parametrize(
    ("diagram", "said"),
    [
        (without(controller(), "q"), ["the input q is missing: add real in rad/s, estimated pitch rate"]),
        (extra_input(controller()), ["the input wind is not of the template: remove it"]),
        (extra_output(controller()), ["the output spare is not of the template: remove it"]),
        (retyped(controller(), "int32", None, "rad/s"), ["the input q_0 is int32 in rad/s: make it real in rad/s"]),
        (retyped(controller(), "real", 2, "rad/s"), ["the input q_0 is real[2] in rad/s: make it real in rad/s"]),
        (retyped(controller(), "real", None, "m"), ["the input q_0 is real in m: make it real in rad/s"]),
        (output_of(Mux(2), a="q", b="q_0"), ["the output M is real[2]: make it real"]),
        (output_of(Constant(1.0, unit="N")), ["the output M is real in N: make it real"]),
        (output_of(Constant(1, "int32")), ["the output M is int32: make it real"]),
        (
            extra_output(without(retyped(controller(), "bool", None, ""), "theta")),
            ["the input theta is missing", "the output spare is not", "the input q_0 is bool: make it real in rad/s"],
        ),
    ],
)
def test_each_port_that_does_not_fit_is_named_with_its_remedy(diagram: Diagram, said: list[str]) -> None:
    with pytest.raises(DiagramError) as caught:
        check_template(diagram)
    assert caught.value.where == "mine"
    for text in said:
        assert text in caught.value.what


def test_a_unit_may_be_left_out_and_an_input_unused() -> None:
    assert check_template(retyped(controller(), "real", None, "")) is ATTITUDE


@pytest.mark.parametrize("name", TEMPLATES)
def test_a_diagram_without_any_port_lacks_them_all(name: str) -> None:
    with pytest.raises(DiagramError) as caught:
        check_template(Diagram("nothing"), name)
    template = TEMPLATES[name]
    for port in (*template.inputs, *template.outputs):
        assert f"put {port.name} is missing" in caught.value.what


def test_what_a_diagram_is_meant_for_shows_in_its_outputs() -> None:
    for name in ("attitude", "position", "motor"):
        assert kind_of(starter(f"empty-{name}")) == f"{name}_control"
    with pytest.raises(DiagramError, match=r"no template has its outputs \(none\).*attitude_control gives M"):
        kind_of(Diagram("nothing"))
    with pytest.raises(DiagramError, match=r"mine: no template named 'atitude' \(there are: attitude_control, "):
        check_template(controller(), "atitude")


def renamed(d: Diagram, **names: str) -> Diagram:
    """`d` with inputs and outputs under other names; nothing reads the inputs."""
    made = Diagram("mine")
    for port in d.inputs.values():
        made.input(names.get(port.name, port.name), port.kind, unit=port.unit)
    for name in d.outputs:
        made.add(f"{name}_source", Constant(0.5))
        made.output(names.get(name, name), f"{name}_source")
    return made


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ({"theta_0": "theta0"}, {"theta_0": "theta0"}),
        ({"theta": "Theta", "theta_0": "Theta_set"}, {"theta": "Theta", "theta_0": "Theta_set"}),
        ({"FLAG_RESET_INT": "flag_reset", "q_0": "q0"}, {"FLAG_RESET_INT": "flag_reset", "q_0": "q0"}),
        ({"M": "moment"}, {"M": "moment"}),
        ({"q": "wind"}, {}),
    ],
)
def test_a_port_under_a_like_name_is_the_one_to_rename(names: dict[str, str], said: dict[str, str]) -> None:
    found = template_fit(renamed(controller(), **names), "attitude_control")
    assert [fault.split(": rename ")[1].split()[0] for fault in found.faults if "rename" in fault] == [
        said[name] for name in (*(p.name for p in ATTITUDE.inputs), "M") if name in said
    ]
    for wanted, given in names.items():
        assert any(f"put {wanted} is missing: " in fault for fault in found.faults)
        assert any(f"put {given} is not of the template" in fault for fault in found.faults) == (wanted not in said)


def test_the_nearest_template_is_that_of_most_ports() -> None:
    for template in TEMPLATES.values():
        other = {port.name: f"{port.name}x" for port in template.outputs}
        empty = starter(f"empty-{template.name.removesuffix('_control')}")
        assert nearest_template(empty) == nearest_template(renamed(empty, **other)) == template.name
    loop = Diagram("loop")
    loop.input("r")
    loop.output("y", "r")
    assert nearest_template(loop) is None


def test_a_controller_is_discrete() -> None:
    with pytest.raises(DiagramError, match=r"continuous states in made.*discrete blocks"):
        check_template(output_of(Integrator(), u="q"))


def test_what_runs_alone_but_not_in_the_flight_code_is_said_at_once() -> None:
    with pytest.raises(DiagramError, match="edge inside the step"):
        check_template(output_of(FractionalDelay(0.01), u="q"))


def test_what_does_not_compile_is_said_as_the_compiler_says_it() -> None:
    d = with_ports(ATTITUDE, "mine", "")
    d.add("sum", Sum("++"), a="q", b="sum")
    d.output("M", "sum")
    with pytest.raises(DiagramError, match="algebraic loop"):
        check_template(d)
    d = with_ports(ATTITUDE, "mine", "")
    d.output("M")
    with pytest.raises(DiagramError, match="not connected"):
        check_template(d)


def test_one_diagram_of_a_kind() -> None:
    found = by_kind([starter("empty-motor"), starter("lqr-attitude")])
    assert {name: d.name for name, d in found.items()} == {
        "motor_control": "empty_motor",
        "attitude_control": "lqr_attitude",
    }
    with pytest.raises(DiagramError, match="'empty_attitude' and 'lqr_attitude' are both of the template"):
        by_kind([starter("empty-attitude"), starter("lqr-attitude")])
