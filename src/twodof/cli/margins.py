"""Margins: `twodof margins`, `bode`, `rlocus` and `step` of a loop of your own, `diagram margins` of the cascade."""

import importlib
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from twodof.cli.options import Force, Json, StockGains, argument, option, read_json
from twodof.cli.output import exit_unless, print_result, progress, table
from twodof.compile.linear.linear_model import LinearModel
from twodof.compile.linear.linearize import linearize
from twodof.design import LoopMargins, LoopTransfer, final_value, own_loop, read_rational, step_response
from twodof.design import margins as margins_of
from twodof.errors import ParameterError, listed
from twodof.flight.gains import load_gains
from twodof.flight.starters import DIAGRAM_HELP, load_diagram
from twodof.models.lti import step_figures
from twodof.report.plots.flight_view import PICTURES, check_place
from twodof.sim.linear import LOOPS, cascade_margins
from twodof.sim.resimulation import load_rig_or_model

_TICK_S = 0.004

Plant = Annotated[
    str,
    argument(
        "What `twodof identify --out` wrote, a diagram's JSON file, or a transfer function: "
        '"2 exp(-0.3 s) / (1.5 s + 1)", "0.1 / (z - 0.9)".',
        "PLANT",
    ),
]
Controller = Annotated[
    str,
    argument('From error to plant: a diagram, or a transfer function as "3 + 1 / s" (after --: "-2").', "CONTROLLER"),
]
Period = Annotated[float | None, option("Sample time: of z, of a diagram, or of a loop to be sampled.", "SECONDS")]
Input = Annotated[str | None, option("For a plant with several inputs: the one that the controller drives.", "NAME")]
Output = Annotated[str | None, option("For a plant with several outputs: the one that the controller reads.", "NAME")]
Measured = Annotated[
    str | None, option("For a controller with several inputs: the measured one, whose sign is inverted.", "NAME")
]


def _command(picture: str, about: str, drawn: str = "it there") -> Callable[..., None]:
    """Return a command about a loop, with the help `about`; it draws the `picture`, in words what is `drawn`."""

    def command(
        plant: Plant,
        controller: Controller = "1",
        period: Period = None,
        input: Input = None,
        output: Output = None,
        measured: Measured = None,
        plot: Annotated[Path | None, option(f"Draw {drawn} ({', '.join(PICTURES)}).", "FILE")] = None,
        force: Force = False,
        json: Json = False,
    ) -> None:
        if plot is not None:
            check_place(plot, force, PICTURES)
        if period is not None and not 0.0 < period < float("inf"):
            raise ParameterError(f"a period of {period:g} s", "--period", "give a time above 0")
        own = _system(plant, period, "PLANT", input, output)
        law = _system(controller, period or own.dt, "CONTROLLER", measured, None, negate=measured is not None)
        found = margins_of(own_loop(own, law, period))
        title = f"{_short(controller)} on {_short(plant)}"
        document: dict[str, Any] = {"plant": plant, "controller": controller, "dt": found.loop.dt, **found.to_json()}
        lines = [title + ("" if found.loop.dt is None else f", steps of {found.loop.dt:g} s")]
        lines += margin_lines({"loop": found})
        if picture == "step" and found.stable:
            time, value = step_response(found)
            shown, document["step"] = _step_line(time, value, final_value(found))
            lines.append(shown)
        if plot is not None:
            _draw({"loop": found}, plot, title, force, picture)
            lines.append(f"written: {plot}")
        print_result(json, document, lines)
        exit_unless(found.stable)

    command.__doc__ = about
    return command


margins = _command(
    "all",
    """Compute the stability margins of a loop of your own, at any sample time.

    A continuous plant with a sampled controller is discretised exactly, by zero-order hold. A continuous controller in
    a sampled loop is discretised by Tustin's rule. The drone's cascade: `twodof diagram margins`.

    Exit status 1: the loop is unstable.
    """,
    "Bode, Nyquist, Nichols, sensitivities, step and root locus",
)
bode = _command("bode", "Draw the Bode plot of a loop with its margins marked; arguments as for `twodof margins`.")
rlocus = _command("rlocus", "Draw the root locus of a loop: the closed loop's poles for .02 to 20 times the gain.")
step = _command(
    "step", "Compute rise time, overshoot and settling time of the closed loop, and draw its step response."
)


def _draw(found: Mapping[str, LoopMargins], plot: Path, title: str, force: bool, picture: str = "all") -> None:
    """Draw loops, importing matplotlib only now."""
    draw = importlib.import_module("twodof.report.plots.loop_plot").write_loop_plot
    draw({name: m.loop for name, m in found.items()}, plot, title, force, picture)


def _short(source: str) -> str:
    return Path(source).name if Path(source).suffix == ".json" else source


def _system(
    source: str, period: float | None, where: str, input: str | None, output: str | None, negate: bool = False
) -> LoopTransfer:
    """Return what a file or a text describes, from one input to one output. Raises ParameterError, DiagramError."""
    if not source.endswith(".json"):
        return read_rational(source).transfer(where, period)
    document = read_json(source, "give a model or a diagram")
    if isinstance(document, dict) and "estimates" in document:
        if "linear" not in document:
            remedy = "identify it again with --out; a model that sticks at rest has no linear form"
            raise ParameterError("the model holds no matrices", source, remedy)
        model = LinearModel.from_json(document["linear"], source)
    else:
        model = linearize(load_diagram(source), period or _TICK_S)
        if model.dt is not None and period is None:
            raise ParameterError("the diagram is sampled, and has no sample time", source, "give --period")
    for name, there, kind in ((input, model.inputs, "input"), (output, model.outputs, "output")):
        if len(there) > 1 if name is None else name not in there:
            option = "--measured" if where == "CONTROLLER" else f"--{kind}"
            raise ParameterError(f"it has {len(there)} {kind}s: {listed(there)}", source, f"name one: {option} NAME")
    return LoopTransfer.of(model, input or 0, output or 0, negate)


def cascade_loops(
    diagrams: Annotated[list[str] | None, argument(f"Default: the stock cascade. {DIAGRAM_HELP}", "DIAGRAM...")] = None,
    rig: Annotated[str, option("lab, paper, a rig's JSON file, or a model's from `identify --json`.", "RIG")] = "lab",
    gains: StockGains = "default",
    loop: Annotated[list[str] | None, option(f"Only this loop; repeatable. {', '.join(LOOPS)}.", "NAME")] = None,
    plot: Annotated[
        Path | None,
        option(
            "Draw Bode, Nyquist, Nichols, sensitivities and step responses; of one loop its root locus too "
            f"({', '.join(PICTURES)}).",
            "FILE",
        ),
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Compute the margins of each loop of the cascade, with the controllers and the rig as they fly.

    The loop is sampled, with all its delays. Each loop is opened at its own signal, with the loops inside it closed. A
    controller of the template attitude_control, position_control or motor_control takes the place of the stock one.

    Exit status 1: a loop is unstable.
    """
    if plot is not None:
        check_place(plot, force, PICTURES)
    flown = [load_diagram(one) for one in diagrams or []]
    values, stock = load_rig_or_model(rig), load_gains(gains)
    wanted = tuple(dict.fromkeys(loop)) if loop else tuple(LOOPS)
    found: dict[str, LoopMargins] = {}
    with progress() as say:
        for k, name in enumerate(wanted):
            say(f"margins of the {name} loop", k / len(wanted))
            found |= cascade_margins(stock, flown, values, [name])
    names = ", ".join(d.name for d in flown) or f"the stock cascade ({gains})"
    others = f", with the other loops' stock controllers ({gains})" if flown else ""
    lines = [f"{names} on {rig}{others}", *margin_lines(found)]
    if plot is not None:
        _draw(found, plot, f"{names} on {rig}", force)
        lines.append(f"written: {plot}")
    print_result(json, {"rig": rig, "loops": {name: m.to_json() for name, m in found.items()}}, lines)
    exit_unless(all(m.stable for m in found.values()))


def _step_line(
    time: NDArray[np.float64], value: NDArray[np.float64], final: float
) -> tuple[str, dict[str, float] | None]:
    """Return the figures of a step response as a line and as plain data; None if it ends at 0, where it began."""
    if final == 0.0:
        return f"final value 0, peak {value[np.argmax(np.abs(value))]:.4g}", None
    figures = step_figures(time, value, 0.0, final)
    settling = f"settling time {figures.settling_time:.3g} s (2 %)"
    if math.isnan(figures.settling_time):
        settling = f"not within 2 % after {time[-1]:.3g} s"
    ends = f"{settling}, final value {final:.4g}"
    return f"rise time {figures.rise_time:.3g} s, overshoot {100.0 * figures.overshoot:.1f} %, {ends}", asdict(figures)


def margin_lines(found: Mapping[str, LoopMargins]) -> list[Any]:
    """Return a table with a row for each loop, then the motion of each unstable loop."""
    margins = ("gain margin\ndB", "phase margin\ndeg", "delay margin\nms", "disk margin\ndB and deg", "Ms", "Mt")
    made = table("loop", "crossover\nrad/s", *margins, "bandwidth\nrad/s", right=range(1, 9))
    for name, m in found.items():
        made.add_row(name, *(_cells(m) if m.stable else ("unstable", *[""] * 7)))
    moving = {name: m for name, m in found.items() if not m.stable and m.motion is not None}
    return [made, *(f"{name}: unstable: {m.motion.text}{_cure(m)}" for name, m in moving.items() if m.motion)]


def _cells(m: LoopMargins) -> tuple[str, ...]:
    return (
        _number(m.crossover, 3),
        _gains(m),
        _number(m.phase_margin_deg, 3),
        _number(1e3 * m.delay_margin, 3),
        f"{_decibels(m.disk.gain[1])}, {math.degrees(m.disk.phase):.0f}",
        f"{m.ms:.2f}",
        f"{m.mt:.2f}",
        _number(m.bandwidth or math.inf, 3),  # 0: nowhere does the loop follow
    )


def _gains(m: LoopMargins) -> str:
    """Return the gain margin; a conditionally stable loop has a lower one, too."""
    up = _decibels(m.increase.factor) if m.increase else "-"
    return up if m.decrease is None else f"{_decibels(m.decrease.factor)}, {up}"


def _cure(m: LoopMargins) -> str:
    """Return the gain at which an unstable loop would be on the border, as a remark."""
    if m.decrease is not None and m.motion is not None and m.motion.omega > 0.0:
        return f" (with {m.decrease.factor:.2g} times the gain it would be on the border)"
    return ""


def _decibels(factor: float) -> str:
    return "-" if math.isinf(factor) else f"{20.0 * math.log10(factor):.1f}"


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}g}" if math.isfinite(value) else "-"
