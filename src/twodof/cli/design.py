"""`twodof design`: from an identified model to a controller and its promise, and from a flight to the verdict."""

import json as json_text
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from twodof.cli.flown import write_view
from twodof.cli.options import (
    Force,
    Json,
    Members,
    PromiseFile,
    PromisePlot,
    Seed,
    StockGains,
    argument,
    group,
    option,
    read_json,
)
from twodof.cli.output import exit_unless, print_result, progress, say_line
from twodof.design.cascade import SEPARATION, CascadeDesign
from twodof.design.designed_controller import CROSSOVER, design_controller
from twodof.design.pitch_family import PitchFamily
from twodof.design.promise import MEMBERS, STEPS, Promise
from twodof.design.specification import read_specification
from twodof.flight.gains import load_gains
from twodof.flight.starters import DIAGRAM_HELP, load_diagram, save_diagram
from twodof.flightlog.atomic import check_free, write_text
from twodof.flightlog.files import read_log
from twodof.report.plots.comparison_view import promise_view
from twodof.report.plots.flight_view import check_place
from twodof.sim.promised.rail_design import RailDesign, rail_design
from twodof.sim.promised.rail_promise import MEMBERS as RAIL_MEMBERS
from twodof.sim.promised.rail_promise import RailFamily, check_rail, rail_promise

design = group("Design a controller for an identified model, predict its flight, and compare it with a flight.")

_IDENTIFIED = "give what `twodof identify --json` printed"


@design.command()
def controller(
    model: Annotated[str, argument("What `twodof identify --json` printed; -: from standard input.", "MODEL")],
    out: Annotated[Path, option("Write the controller to this file, as a diagram in JSON.", "FILE")],
    crossover: Annotated[float, option("Crossover of the rate loop, which --phase-margin meets.", "RAD/S")] = CROSSOVER,
    phase_margin: Annotated[
        float | None, option("Phase margin of the rate loop; default: by the course's rule.", "DEG")
    ] = None,
    method: Annotated[
        Literal["cascade", "lqg"], option("The cascade of the drone, or LQG: state feedback with a Kalman filter.")
    ] = "cascade",
    spec: Annotated[
        Path | None, option("A specification (TOML): optimise the gains for it, and check them.", "FILE")
    ] = None,
    separation: Annotated[float, option("The rate loop's crossover over the attitude loop's.")] = SEPARATION,
    anti_windup: Annotated[
        Literal["none", "clamping", "back-calculation"],
        option("Of the cascade's rate PID, with M limited to what the motors give in hover."),
    ] = "none",
    promise_file: PromiseFile = None,
    plot: PromisePlot = None,
    goal: Annotated[float, option("Size of the predicted pitch step.", "DEG")] = 10.0,
    gust: Annotated[float | None, option("Standard deviation of the gusts' angular acceleration.", "RAD/S2")] = None,
    gust_time: Annotated[float | None, option("Correlation time of the gusts.", "S")] = None,
    q_noise: Annotated[float | None, option("Noise of a sample of q; default: the model's.", "RAD/S")] = None,
    members: Members = MEMBERS,
    seed: Seed = 1,
    force: Force = False,
    json: Json = False,
) -> None:
    """Design the cascade's rate PID and attitude P for an identified pitch, and predict the step response.

    2,000 drones are sampled from the model's estimate and covariance, and a local search looks for the worst one on the
    border of the 99.9 % region. If one of them is unstable, the controller is not
    written: exit status 1.

    With --spec the gains are those that meet the specification best, by structured H-infinity. Exit status 1 also if
    they miss it.
    """
    if spec is not None and method != "cascade":
        raise typer.BadParameter("--spec optimises the gains of the cascade: leave --method out")
    if anti_windup != "none" and method != "cascade":
        raise typer.BadParameter("--anti-windup is of the cascade's PID: leave --method out")
    _check_places(out, promise_file, plot, force)
    family = PitchFamily.from_identified(read_json(model, _IDENTIFIED), model).disturbed(gust, gust_time, q_noise)
    asked = None if spec is None else read_specification(spec)
    with progress() as report:
        made = design_controller(
            family,
            crossover,
            None if phase_margin is None else math.radians(phase_margin),
            separation,
            method,
            asked,
            math.radians(goal),
            members,
            seed,
            report,
            anti_windup,
        )
    sure, found = made.robustness, made.promise
    written: dict[str, str] = {}
    if sure.robust:
        save_diagram(made.diagram, out, overwrite=force)
        written = {"diagram": str(out), **_keep(found, promise_file, plot, force)}
    lines = [] if made.cascade is None else _cascade_lines(made.cascade)
    if made.cascade is not None and spec is None and phase_margin is None:
        why = f"  {crossover:g} rad/s is that of mu / s alone; the controller's integral and lead raise the crossover"
        lines.append(f"{why}. With --phase-margin DEG the loop crosses over there exactly")
    lines += [sure.text, made.saturation.text, found.table(), *(one.text for one in made.requirements)]
    print_result(json, {**made.to_json(), "written": written}, lines)
    _say_notes(family, () if json else written.values())
    if not sure.robust:
        say_line("note: nothing is written; ask for a lower crossover, or identify the model better")
    elif not made.ready:
        say_line("note: the specification is not met; ask for less, or identify the model better")
    if made.saturation.winds_up and anti_windup == "none" and method == "cascade":
        say_line("note: --anti-windup back-calculation keeps the integral from winding up")
    exit_unless(made.ready)


@design.command()
def verdict(
    promised: Annotated[Path, argument("The file that `design controller` or `design rail` wrote.", "PROMISE")],
    log: Annotated[Path, argument("The log of a flight with steps of the pitch.", "LOG")],
    plot: Annotated[Path | None, option("Draw the steps over the promise (.png, .svg, .pdf, .html).", "FILE")] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Compare flown steps with the promise, channel by channel and figure by figure.

    Exit status 1: more steps broke part of the promise than chance explains.
    """
    if plot is not None:
        check_place(plot, force)
    made = Promise.from_json(read_json(promised, _IDENTIFIED), str(promised))
    flight = read_log(log)
    found = made.verdict_of(flight)
    if plot is not None:
        write_view(promise_view(made, flight), plot, force)
    print_result(json, {**found.to_json(), "plot": None if plot is None else str(plot)}, [found.table()])
    if plot is not None and not json:
        say_line(f"written: {plot}")
    exit_unless(found.stands)


def _check_places(out: Path | None, promise: Path | None, plot: Path | None, force: bool) -> None:
    """Raise LogError for a place that cannot be written; to be called before the design."""
    for path in (out, promise):
        if path is not None:
            check_free(path, force)
    if plot is not None:
        check_place(plot, force)


def _keep(made: Promise, promise: Path | None, plot: Path | None, force: bool) -> dict[str, str]:
    """Write and draw a promise as the options ask; return what was written."""
    if promise is not None:
        write_text(promise, json_text.dumps(made.to_json(), allow_nan=False))
    if plot is not None:
        write_view(promise_view(made), plot, force)
    return {name: str(path) for name, path in (("promise", promise), ("plot", plot)) if path is not None}


def _cascade_lines(made: CascadeDesign) -> list[Any]:
    kp, ki, kd = made.gains.rate
    lines = [f"rate PID: Kp {kp:.5g}, Ki {ki:.5g}, Kd {kd:.4g}; attitude P: Kp {made.gains.attitude:.4g}"]
    for name in ("rate", "attitude"):
        crossover, margin = made.crossovers[name], math.degrees(made.phase_margins[name])
        lines.append(f"{name} loop: crossover {crossover:.3g} rad/s, phase margin {margin:.3g} deg")
    return lines


def _say_notes(family: PitchFamily, written: Iterable[str]) -> None:
    for name in written:
        say_line(f"written: {name}")
    for note in family.notes:
        say_line(f"note: {note}")


_SEARCH, _FLOWN = 0.8, 0.9  # shares of the work that end there


@design.command()
def rail(
    pitch: Annotated[Path, argument("The pitch's model, of `twodof identify --out`.", "PITCH")],
    cart: Annotated[Path, argument("The cart's model, `twodof identify --out` of a velocity-doublet.", "CART")],
    controller: Annotated[
        list[str] | None, option(f"Fly this controller in place of a stock loop; repeatable. {DIAGRAM_HELP}", "DIAGRAM")
    ] = None,
    gains: StockGains = "default",
    loop: Annotated[
        Literal["velocity", "position"] | None, option("Loop whose set-point steps; default: the specification's.")
    ] = None,
    goal: Annotated[float | None, option("Size of the step; default: the specification's, or .15.", "M/S|M")] = None,
    spec: Annotated[Path | None, option("A specification (TOML) with a table [rail]: check it.", "FILE")] = None,
    out: Annotated[
        Path | None,
        option("Search the stock loops' gains for --spec, starting at --gains, and write them to this file.", "FILE"),
    ] = None,
    promise_file: PromiseFile = None,
    plot: PromisePlot = None,
    rig: Annotated[
        str | None,
        option("Rig for what the models do not hold, such as sensors; default: the rig that was flown.", "RIG"),
    ] = None,
    members: Members = RAIL_MEMBERS,
    seed: Seed = 1,
    force: Force = False,
    json: Json = False,
) -> None:
    """Predict a step of the velocity or position, by flights of the identified family on the virtual rig.

    All limits, sensors and the estimator are in these flights. `twodof design verdict` compares a log with the
    prediction.

    With --spec and --out the gains are those that meet the specification best. They are written in the format of
    `--gains`, here and in `twodof simulate`.

    Exit status 1: a sampled drone meets an end stop, or the specification is missed.
    """
    if out is not None and (spec is None or controller):
        raise typer.BadParameter("--out searches gains of the stock loops for --spec: give --spec, and no --controller")
    _check_places(out, promise_file, plot, force)
    family = RailFamily.from_identified(read_json(pitch, _IDENTIFIED), read_json(cart, _IDENTIFIED), rig)
    diagrams, flown = [load_diagram(one) for one in controller or []], load_gains(gains)
    asked = None if spec is None else read_specification(spec, "rail")
    which = loop if loop is not None else (asked.loop if asked is not None else "velocity")
    step = goal if goal is not None else (asked.step if asked is not None else STEPS[which].goal)
    found: RailDesign | None = None
    with progress() as report:
        if out is not None and asked is not None:
            found = rail_design(
                asked, family, flown, members, seed, lambda share: report("searching the gains", _SEARCH * share)
            )
            flown = found.gains
        begun = _SEARCH if found is not None else 0.0
        made = rail_promise(
            family,
            which,
            gains=flown,
            controllers=diagrams,
            goal=step,
            members=members,
            seed=seed,
            progress=lambda share: report("flying the members", begun + (_FLOWN - begun) * share),
        )
        report("the margins", _FLOWN)
        checked = () if asked is None else check_rail(asked, family, flown, diagrams, made)
    written: dict[str, str] = {}
    if made.robust:
        if out is not None:
            write_text(out, json_text.dumps(flown.to_json(), allow_nan=False))
            written["gains"] = str(out)
        written |= _keep(made, promise_file, plot, force)
    document = {
        "promise": made.to_json(),
        "specification": [one.to_json() for one in checked],
        "gains": flown.to_json(),
        "written": written,
    }
    kp, ki = flown.velocity
    searched = f"velocity PI: Kp {kp:.4g}, Ki {ki:.4g}; position P: Kp {flown.position:.4g}"
    print_result(json, document, [*[searched] * (found is not None), made.table(), *(one.text for one in checked)])
    _say_notes(family.pitch, () if json else written.values())
    exit_unless(made.robust and all(one.met for one in checked))
