"""`twodof margins`, `bode`, `rlocus` and `step` of a loop of your own: a plant and a controller."""

import importlib
import json as json_text
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from twodof.cli.input import read_input
from twodof.cli.margins import print_margins
from twodof.cli.options import Force, Json, argument, option
from twodof.cli.output import exit_unless, print_json, table_console
from twodof.compile.linear.linear_model import LinearModel
from twodof.compile.linear.linearize import linearize
from twodof.design import LoopMargins, LoopTransfer, own_loop, read_rational, step_response
from twodof.design import margins as margins_of
from twodof.errors import ParameterError, listed
from twodof.flight.starters import load_diagram
from twodof.models.lti import step_figures
from twodof.report.plots.flight_view import PICTURES, check_place

_TICK_S, _MAX_BYTES = 0.004, 1 << 24

Plant = Annotated[
    str,
    argument(
        "What `twodof identify --out` wrote, a diagram's JSON file, or a transfer function: "
        '"2 exp(-0.3 s) / (1.5 s + 1)", "0.1 / (z - 0.9)".',
        "PLANT",
    ),
]
Controller = Annotated[
    str, argument('From error to plant: a diagram, or a transfer function as "3 + 1 / s".', "CONTROLLER")
]
Period = Annotated[
    float | None, option("Sample time of a z, a diagram, or of a loop that is to be sampled.", "SECONDS")
]
Input = Annotated[str | None, option("Of a plant with several: the input that the controller moves.", "NAME")]
Output = Annotated[str | None, option("Of a plant with several: the output that the controller reads.", "NAME")]
Measured = Annotated[
    str | None, option("Of a controller's diagram with several inputs: the measured one, whose sign is turned.", "NAME")
]
Picture = Annotated[Path | None, option(f"Draw it there ({', '.join(PICTURES)}).", "FILE")]


def margins(
    plant: Plant,
    controller: Controller = "1",
    period: Period = None,
    input: Input = None,
    output: Output = None,
    measured: Measured = None,
    plot: Annotated[
        Path | None, option(f"Draw Bode, Nyquist, Nichols, sensitivities, step and root locus ({', '.join(PICTURES)}).")
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Say what may change before a loop of your own becomes unstable, at any sample time.

    A continuous plant is held over the steps of a sampled controller, exactly. A continuous controller of a sampled
    loop is taken by Tustin's rule. The drone's cascade: `twodof diagram margins`.

    Exit status 1: the loop is unstable.
    """
    _say(plant, controller, period, (input, output, measured), plot, force, json, "all")


def bode(
    plant: Plant,
    controller: Controller = "1",
    period: Period = None,
    input: Input = None,
    output: Output = None,
    measured: Measured = None,
    plot: Picture = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Draw the Bode plot of a loop with its margins marked; arguments as of `twodof margins`."""
    _say(plant, controller, period, (input, output, measured), plot, force, json, "bode")


def rlocus(
    plant: Plant,
    controller: Controller = "1",
    period: Period = None,
    input: Input = None,
    output: Output = None,
    measured: Measured = None,
    plot: Picture = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Draw the root locus of a loop: the closed loop's poles for .02 to 20 times the gain."""
    _say(plant, controller, period, (input, output, measured), plot, force, json, "rlocus")


def step(
    plant: Plant,
    controller: Controller = "1",
    period: Period = None,
    input: Input = None,
    output: Output = None,
    measured: Measured = None,
    plot: Picture = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Give rise time, overshoot and settling time of the closed loop, and draw its step response."""
    _say(plant, controller, period, (input, output, measured), plot, force, json, "step")


def _say(
    plant: str,
    controller: str,
    period: float | None,
    names: tuple[str | None, str | None, str | None],
    plot: Path | None,
    force: bool,
    json: bool,
    picture: str,
) -> None:
    if plot is not None:
        check_place(plot, force, PICTURES)
    if period is not None and not 0.0 < period < float("inf"):
        raise ParameterError(f"a period of {period:g} s", "--period", "give a time above 0")
    own = _system(plant, period, "PLANT", names[0], names[1])
    law = _system(controller, period or own.dt, "CONTROLLER", names[2], None, negate=names[2] is not None)
    found = margins_of(own_loop(own, law, period))
    title = f"{_short(controller)} on {_short(plant)}"
    document: dict[str, Any] = {"plant": plant, "controller": controller, "dt": found.loop.dt, **found.to_json()}
    lines = []
    if picture == "step" and found.stable:
        time, value = step_response(found)
        at_rest = complex(found.loop.at(0.0 if found.loop.dt is None else 1.0)[0])
        final = 1.0 if not np.isfinite(at_rest) else (at_rest / (1.0 + at_rest)).real
        figures = step_figures(time, value, 0.0, final)
        document["step"] = asdict(figures)
        lines.append(
            f"rise time {figures.rise_time:.3g} s, overshoot {100.0 * figures.overshoot:.1f} %, settling time "
            f"{figures.settling_time:.3g} s (2 %), final value {figures.final:.4g}"
        )
    if plot is not None:
        # Only this reads matplotlib.
        draw = importlib.import_module("twodof.report.plots.loop_plot").write_loop_plot
        draw({"loop": found.loop}, plot, title, force, picture)
        lines.append(f"written: {plot}")
    if json:
        print_json(document)
    else:
        _print(title, found, lines)
    exit_unless(found.stable)


def _print(title: str, found: LoopMargins, lines: list[str]) -> None:
    console = table_console()
    console.print(title + ("" if found.loop.dt is None else f", steps of {found.loop.dt:g} s"))
    print_margins(console, {"loop": found})
    for line in lines:
        console.print(line)


def _short(source: str) -> str:
    return Path(source).name if Path(source).suffix == ".json" else source


def _system(
    source: str, period: float | None, where: str, input: str | None, output: str | None, negate: bool = False
) -> LoopTransfer:
    """Return what a file or a text describes, from one input to one output. Raises ParameterError, DiagramError."""
    if not source.endswith(".json"):
        return read_rational(source).transfer(where, period)
    try:
        document = json_text.loads(read_input(source, _MAX_BYTES))
    except (ValueError, RecursionError) as reason:
        raise ParameterError(f"it is not JSON: {reason!s:.80}", source, "give a model or a diagram") from reason
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
