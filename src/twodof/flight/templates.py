"""Templates of controllers: a diagram with exactly the ports of a template can replace its stock controller."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import SequenceMatcher
from types import MappingProxyType
from typing import NamedTuple

from twodof.blocks.declarations import Port, unknown_name
from twodof.blocks.diagram import Diagram
from twodof.blocks.library.delays import ZeroOrderHold
from twodof.compile.program.flat_program import FlatProgram, FlatSignal
from twodof.compile.program.lower import lower
from twodof.errors import DiagramError
from twodof.signals import PERIOD

MEANT = 0.25
"""Share of common ports, among all ports of a diagram and a template, from which the diagram is meant for it."""
ALIKE = 0.6  # of two names, one is a slip of the pen of the other
MAX_COMPARED = 100


class TemplatePort(NamedTuple):
    """A port of a template: a scalar of type `kind` in `unit` ("" for none), and its meaning `text`."""

    name: str
    kind: str
    unit: str
    text: str


@dataclass(frozen=True)
class Template:
    """Template of one kind of controller: name, meaning, and its ports in order."""

    name: str
    text: str
    inputs: tuple[TemplatePort, ...]
    outputs: tuple[TemplatePort, ...]


def _ports(*rows: tuple[str, str, str, str]) -> tuple[TemplatePort, ...]:
    return tuple(TemplatePort(*row) for row in rows)


_RESET = "the integrals are to be held in reset: no thrust, just armed, or the mode does not use this controller"
_ATTITUDE = "the pitch loop is closed: follow theta_0; false in rate mode: follow q_0"
_THETA = "estimated pitch, nose-up positive, as of the sample before: the estimator publishes after the controller"
_X = "estimated position along the rail, 0 at its middle, published at 100 Hz and held"
_VX = "estimated velocity along the rail, published at 100 Hz and held"

ATTITUDE = Template(
    "attitude_control",
    "pitch and pitch-rate loops: set-points and estimates in, normalised pitch moment out",
    _ports(
        ("theta_0", "real", "rad", "pitch set-point, in use while FLAG_ATTITUDE_ENABLED"),
        ("q_0", "real", "rad/s", "pitch-rate set-point, in use while not FLAG_ATTITUDE_ENABLED"),
        ("theta", "real", "rad", _THETA),
        ("q", "real", "rad/s", "estimated pitch rate of this sample"),
        ("FLAG_RESET_INT", "bool", "", _RESET),
        ("FLAG_ATTITUDE_ENABLED", "bool", "", _ATTITUDE),
    ),
    _ports(("M", "real", "", "normalised pitch moment, -1 to 1; M > 0 raises the nose")),
)

POSITION = Template(
    "position_control",
    "position and velocity loops: set-points and estimates in, thrust and pitch set-point out",
    _ports(
        ("x_0", "real", "m", "position set-point, in use while FLAG_POSITION_ENABLED"),
        ("vx_0", "real", "m/s", "velocity set-point, in use while not FLAG_POSITION_ENABLED"),
        ("x", "real", "m", _X),
        ("vx", "real", "m/s", _VX),
        ("ax_0", "real", "m/s2", "acceleration set-point along the rail, a feed-forward; 0 if none is given"),
        ("FLAG_RESET_INT_VEL", "bool", "", _RESET),
        (
            "FLAG_POSITION_ENABLED",
            "bool",
            "",
            "the position loop is closed: follow x_0; false in velocity mode: follow vx_0",
        ),
    ),
    _ports(
        ("thrust", "real", "", "normalised thrust, 0 to 1; the drone hovers at 0.4"),
        ("theta_0", "real", "rad", "pitch set-point for the attitude controller; theta > 0 drives to -x"),
    ),
)

MOTOR = Template(
    "motor_control",
    "the lowest level: measurements, estimates and set-points in, the commands of the single motors out",
    _ports(
        ("M_0", "real", "", "normalised pitch moment that the level above asks for (open loop: given)"),
        ("thrust_0", "real", "", "normalised thrust that the level above asks for"),
        ("theta_0", "real", "rad", "pitch set-point in use, 0 if none is"),
        ("q_0", "real", "rad/s", "pitch-rate set-point in use, 0 if none is"),
        ("x_0", "real", "m", "position set-point in use, 0 if none is"),
        ("vx_0", "real", "m/s", "velocity set-point in use, 0 if none is"),
        ("theta", "real", "rad", _THETA),
        ("q", "real", "rad/s", "estimated pitch rate of this sample"),
        ("x", "real", "m", _X),
        ("vx", "real", "m/s", _VX),
        ("acc_x", "real", "m/s2", "measured specific force along the body's x axis (forward)"),
        ("acc_z", "real", "m/s2", "measured specific force along the body's z axis (down): -9.81 at rest"),
        ("gyro_y", "real", "rad/s", "measured pitch rate, its bias still in it"),
        ("FLAG_RESET_INT", "bool", "", _RESET),
        ("FLAG_RATE_ENABLED", "bool", "", "some loop is closed; false in open loop, where M_0 is to be flown"),
        ("FLAG_ATTITUDE_ENABLED", "bool", "", "the pitch is controlled: attitude, velocity or position mode"),
        ("FLAG_VELOCITY_ENABLED", "bool", "", "the velocity is controlled: velocity or position mode"),
        ("FLAG_POSITION_ENABLED", "bool", "", "the position is controlled: position mode"),
    ),
    _ports(
        ("motor_1", "real", "", "command of the fore right motor, 0 to 1"),
        ("motor_2", "real", "", "command of the aft left motor, 0 to 1"),
        ("motor_3", "real", "", "command of the fore left motor, 0 to 1"),
        ("motor_4", "real", "", "command of the aft right motor, 0 to 1"),
    ),
)

FORE_MOTORS, AFT_MOTORS = ("motor_1", "motor_3"), ("motor_2", "motor_4")
"""Motors of each rotor pair, numbered as by PX4 for a quadrotor X: 1 fore right, 2 aft left, 3 fore left, 4 aft right.

1 and 2 turn counter-clockwise seen from above, 3 and 4 clockwise. The fore pair lifts the nose, so it gives M > 0.
"""

TEMPLATES: Mapping[str, Template] = MappingProxyType({t.name: t for t in (ATTITUDE, POSITION, MOTOR)})
"""The templates by name."""


def kind_of(diagram: Diagram) -> str:
    """Return the name of the template nearest to `diagram` (see `nearest_template`).

    Use `check_template` to find out whether the diagram fits it. Raises DiagramError for a diagram that has hardly any
    port of a template.
    """
    nearest = nearest_template(diagram)
    if nearest is None:
        known = "; ".join(f"{t.name} gives {', '.join(port.name for port in t.outputs)}" for t in TEMPLATES.values())
        what = f"no template has its outputs ({', '.join(diagram.outputs) or 'none'})"
        raise DiagramError(what, diagram.name, f"give the diagram the ports of one: {known}")
    return nearest


def nearest_template(diagram: Diagram) -> str | None:
    """Return the name of the template with the most ports in common with `diagram`; outputs count before inputs.

    Return None if the diagram has no output and hardly any input of a template.
    """

    def folded(inputs: Iterable[str], outputs: Iterable[str]) -> set[tuple[str, str]]:
        ports = [*(("input", name) for name in inputs), *(("output", name) for name in outputs)]
        return {(what, name.casefold().replace("_", "")) for what, name in ports}

    def likeness(template: Template) -> tuple[int, float]:
        outputs = [port.name for port in template.outputs]
        asked = folded((port.name for port in template.inputs), outputs)
        own = folded(diagram.inputs, diagram.outputs)
        return sum(name in diagram.outputs for name in outputs), len(own & asked) / len(own | asked)

    best = max(TEMPLATES.values(), key=likeness)
    outputs, share = likeness(best)
    return best.name if outputs or share >= MEANT else None


def by_kind(diagrams: Iterable[Diagram]) -> dict[str, Diagram]:
    """Return the diagrams by the name of their template. Raises DiagramError if one fits none, or two fit the same."""
    found: dict[str, Diagram] = {}
    for diagram in diagrams:
        name = check_template(diagram).name
        if name in found:
            what = f"{found[name].name!r} and {diagram.name!r} are both of the template {name}"
            raise DiagramError(what, "controllers", "give at most one diagram for each template")
        found[name] = diagram
    return found


def check_template(diagram: Diagram, kind: str | None = None) -> Template:
    """Return the template that `diagram` fits: that called `kind`, by default the nearest one (`kind_of`).

    A diagram fits if it has exactly the template's ports, each a scalar of the template's type, in its unit or in none.
    It need not use all inputs. Raises DiagramError that names every port that is missing, unknown or of another type or
    unit, or the reason why the diagram cannot be compiled or stepped as a controller (no continuous states).
    """
    found = template_fit(diagram, kind_of(diagram) if kind is None else kind)
    if found.faults:
        what = f"it does not fit the template {found.template.name}: {'; '.join(found.faults)}"
        raise DiagramError(what, diagram.name, "change these ports") from found.refusal
    if found.refusal is not None:
        raise found.refusal
    return found.template


@dataclass(frozen=True)
class TemplateFit:
    """Fit of a diagram to a template: the faults of its ports, and the first other reason why it cannot fly."""

    template: Template
    faults: tuple[str, ...]
    refusal: DiagramError | None

    @property
    def fits(self) -> bool:
        """True if the diagram can fly in place of the template's stock controller."""
        return not self.faults and self.refusal is None


def template_fit(diagram: Diagram, kind: str) -> TemplateFit:
    """Return how `diagram` fits the template `kind`. Raises DiagramError only for an unknown template."""
    if kind not in TEMPLATES:
        raise unknown_name("template", kind, TEMPLATES, diagram.name)
    template = TEMPLATES[kind]
    outputs: dict[str, FlatSignal | None] = dict.fromkeys(diagram.outputs)
    refusal: DiagramError | None = None
    try:
        program = lower(diagram, PERIOD)
        outputs = {name: program.outputs[name] for name in program.own}
        refusal = _not_as_a_controller(diagram, program)
    except DiagramError as error:
        refusal = error
    inputs = _faults("input", template.inputs, diagram.inputs)
    return TemplateFit(template, (*inputs, *_faults("output", template.outputs, outputs)), refusal)


def _not_as_a_controller(diagram: Diagram, program: FlatProgram) -> DiagramError | None:
    """Return the reasons why a compiled diagram cannot be a part of the flight core."""
    moving = [node.path for node in program.integrated]
    if moving:
        return DiagramError(
            f"continuous states in {', '.join(moving[:8])}{' ...' if len(moving) > 8 else ''}",
            diagram.name,
            f"a controller is stepped every {PERIOD * 1e3:g} ms: use the discrete blocks",
        )
    try:
        _check_among_others(diagram)
    except DiagramError as error:
        return error
    return None


def _check_among_others(diagram: Diagram) -> None:
    """Check that a diagram runs as a part that is stepped every fourth tick. Raises DiagramError."""
    d = Diagram(diagram.name)
    for port in diagram.inputs.values():
        d.declare(port)
        held = ZeroOrderHold(port.enum or port.kind, port.width, port.unit)
        d.add(f"{port.name.replace('.', '_')}_held", held, rate=(4, 0), u=port.name)
    d.add("controller", diagram, rate=(4, 0))
    for name in diagram.inputs:
        d.connect(f"{name.replace('.', '_')}_held", f"controller.{name}")
    for name in diagram.outputs:
        d.output(name, f"controller.{name}")
    lower(d, PERIOD / 4.0)


def _faults(what: str, wanted: Sequence[TemplatePort], given: Mapping[str, FlatSignal | Port | None]) -> Iterator[str]:
    """Return the faults of the ports `given`, by name to type; a type of None is unknown."""
    names = {port.name for port in wanted}
    strange = [name for name in given if name not in names]
    meant = _misnamed([port.name for port in wanted if port.name not in given], strange, what == "output")
    for port in wanted:
        asked = _described(port.kind, None, port.unit)
        if port.name not in given:
            rename = f"rename {meant[port.name]} if it is that, or " if port.name in meant else ""
            yield f"the {what} {port.name} is missing: {rename}add {asked}, {port.text}"
        elif (found := given[port.name]) is not None:
            # A unit that is left out is not compared, as at any connection.
            if (found.kind, found.width) != (port.kind, None) or (found.unit and found.unit != port.unit):
                described = _described(found.kind, found.width, found.unit)
                yield f"the {what} {port.name} is {described}: make it {asked}"
    for name in strange:
        if name not in meant.values():
            yield f"the {what} {name} is not of the template: remove it"


def _misnamed(missing: Sequence[str], strange: Sequence[str], alone: bool) -> dict[str, str]:
    """Which of the `strange` ports may be which of the `missing` ones, by likeness; with `alone`, the only one is."""
    if alone and len(missing) == len(strange) == 1:
        return {missing[0]: strange[0]}
    pairs = [
        (SequenceMatcher(None, one.casefold(), other.casefold()).ratio(), one, other)
        for one in missing
        for other in strange[:MAX_COMPARED]
    ]
    found: dict[str, str] = {}
    for likeness, one, other in sorted(pairs, key=lambda pair: -pair[0]):
        if likeness >= ALIKE and one not in found and other not in found.values():
            found[one] = other
    return found


def _described(kind: str, width: int | None, unit: str) -> str:
    return f"{kind}{'' if width is None else f'[{width}]'}{f' in {unit}' if unit else ''}"
