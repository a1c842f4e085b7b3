"""`twodof simulate`, `replay` and `calibrate`: flights on the virtual rig, beside logs of the real one."""

import math
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import RenderableType

from twodof.blocks import Diagram
from twodof.calibrate import FLIGHTS, UNKNOWNS, Calibration, estimate_charge
from twodof.calibrate import calibrate as calibrate_rig
from twodof.cli.flown import Out, Plot, check_lines, check_places, keep
from twodof.cli.options import Force, Json, Precision, RealType, Rig, argument, flag, option
from twodof.cli.output import exit_unless, one_line, print_result, progress, say_line, table
from twodof.errors import LogError, ParameterError
from twodof.experiment.experiments import EXPERIMENTS
from twodof.experiment.experiments import experiment as named_experiment
from twodof.experiment.flight import Laboratory
from twodof.flight.controller_store import simulator_controllers
from twodof.flight.gains import load_gains
from twodof.flight.starters import DIAGRAM_HELP, load_diagram
from twodof.flightlog.files import check_folder, read_log
from twodof.flightlog.log import FlightLog
from twodof.flightlog.public_data import PUBLIC_LOGS, PublicLog, find
from twodof.report.plots.flight_view import failsafe_bands
from twodof.rig.parameters import load_rig, save_rig
from twodof.sim.flight_segment import FlownParameters
from twodof.sim.replay import replay as replay_log
from twodof.sim.resimulation import LoggedFlight, resimulation_loop


def simulate(
    experiment: Annotated[str | None, argument(f"One of {', '.join(EXPERIMENTS)}.")] = None,
    like: Annotated[Path | None, option("Fly the set-points of this log instead.", "LOG")] = None,
    rig: Rig = "lab",
    gains: Annotated[
        str | None,
        option("default, student, or a JSON file of gains; by default: default, or with --like a public log's own."),
    ] = None,
    window: Annotated[
        tuple[float, float] | None,
        option("With --like: part of the log to fly [s]; default: found in the log.", "T0 T1"),
    ] = None,
    controller: Annotated[
        list[str] | None,
        option(
            f"Fly this controller in place of the stock one of its template; repeatable. {DIAGRAM_HELP} "
            "Or flashed: those that `twodof flash --to sim` put in place.",
            "DIAGRAM",
        ),
    ] = None,
    tune: Annotated[
        list[str] | None, option("Set a parameter, such as RATE_KP=0.05 or attitude_control.k_q=0.1.", "PATH=VALUE")
    ] = None,
    precision: Precision = "float64",
    seed: Annotated[int, option("Seed of the noise; the same seed gives the same flight.", min=0, max=2**32 - 1)] = 1,
    charge: Annotated[
        str,
        option(
            "State of charge of the battery at the start; a lower charge gives less thrust. With --like also: "
            "estimate, from the flight itself.",
            "0..1",
        ),
    ] = "1",
    out: Out = None,
    plot: Plot = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Fly an experiment on a virtual rig, or, with --like, a log's set-points without noise and compare.

    Exit status 1 says that the flight is not good for its purpose: a stop was hit or nothing moved.
    """
    if (experiment is None) == (like is None):
        raise typer.BadParameter("name an experiment or a log with --like, one of the two")
    if like is not None:
        if out is not None or plot is not None or controller or tune or precision != "float64":
            raise typer.BadParameter(
                "--out, --plot, --controller, --tune, --precision go with an experiment, not --like"
            )
        _fly_like(like, rig, gains, window, charge, json)
    elif window is not None:
        raise typer.BadParameter("--window goes with --like")
    elif experiment is not None:
        share = _charge(charge)
        check_places(out, plot, force)
        diagrams = _controllers(controller or [])
        laboratory = Laboratory(
            rig,
            load_gains(gains or "default"),
            conditions={"charge_start": share},
            controllers=diagrams,
            tuning=_tuning(tune or []),
            precision=precision,
        )
        _fly(laboratory, experiment, seed, out, plot, force, json)


def _registered(log: FlightLog) -> PublicLog | None:
    """Return the public log with this log's checksum, or None."""
    seen = log.provenance.get("file", {}).get("sha256")
    return next((row for row in PUBLIC_LOGS.values() if row.sha256 == seen), None)


def _charge(text: str) -> float:
    try:
        share = float(text)
    except ValueError:
        share = math.nan
    if not 0.0 <= share <= 1.0:
        raise ParameterError(f"{text!r:.80} is not a state of charge", "--charge", "give 0 (empty) to 1 (full)")
    return share


def _fly_like(
    like: Path, rig: str, gains: str | None, window: tuple[float, float] | None, charge: str, json: bool
) -> None:
    given = None if charge == "estimate" else _charge(charge)
    log = read_log(like)
    known = _registered(log)
    if known is not None and (gains is None or window is None):
        taken = [f"its gains ({known.gains})"] if gains is None else []
        taken += [f"its window ({known.window[0]:g} to {known.window[1]:g} s)"] if window is None else []
        say_line(f"note: this is the public log {known.name}: {' and '.join(taken)} taken")
        gains, window = gains or known.gains, window or known.window
    values, loop = load_rig(rig).snapshot(), resimulation_loop()
    flight = LoggedFlight(log, load_gains(gains or "default"), window)
    found = estimate_charge(flight, loop, values) if given is None else None
    share = given if found is None else found.charge
    result = flight.compare(loop, values, {"charge_start": share})
    fits = table("channel", "FIT, %", right=[1])
    for channel, fit in result.fit.items():
        # In the rings x and v stand still, and a FIT of what stands still says nothing.
        still = channel in ("x", "v") and not result.flight.rails
        fits.add_row(channel, "–" if still else f"{fit:.1f}")
    stretches = ", ".join(f"{start:.2f} to {end:.2f} s" for start, end in result.windows)
    lines: list[Any] = [fits, f"rig {rig}, without noise; compared: {stretches}"]
    document = result.to_json()
    if found is not None:
        document |= {"charge": asdict(found)}
        sure = "at its bound" if found.at_bound else f"+- {found.deviation:.2f} (1 sigma)"
        lines.append(f"charge, from the compared flight itself: {found.charge:.2f} {sure}")
    print_result(json, document, lines)


def _controllers(named: list[str]) -> list[Diagram]:
    """Return the diagrams that the options name. Raises ParameterError."""
    found: list[Diagram] = []
    for text in named:
        if text != "flashed":
            found.append(load_diagram(text))
            continue
        slot = simulator_controllers()
        flashed = slot.flashed()
        if not flashed:
            what = "nothing was flashed to the simulator"
            raise ParameterError(what, str(slot.folder), "flash a controller: twodof flash FILE --to sim")
        found += flashed.values()
    return found


def _tuning(texts: list[str]) -> dict[str, Any]:
    """Return values by path: a number, true or false, or several numbers between commas."""
    return dict(map(_setting, texts))


def _setting(text: str) -> tuple[str, Any]:
    path, sign, value = text.partition("=")
    if value in ("true", "false"):
        return path, value == "true"
    try:
        numbers = [_number(part) for part in value.split(",")]
    except ValueError:
        numbers = []
    if not sign or not numbers:
        raise ParameterError(f"{text!r:.80} sets nothing", "--tune", "write PATH=VALUE, a list as PATH=1,2,3")
    return path, numbers if "," in value else numbers[0]


def _number(text: str) -> int | float:
    return int(text) if text.strip().lstrip("+-").isdigit() else float(text)


def _fly(
    laboratory: Laboratory, experiment: str, seed: int, out: Path | None, plot: Path | None, force: bool, json: bool
) -> None:
    flight = laboratory.fly(named_experiment(experiment), seed)
    rig, controllers = laboratory.rig_name, laboratory.described_controllers()
    document = keep(flight, rig, out, plot, force)
    lines = [f"{experiment} on the rig {rig}, seed {seed}, start x = {flight.x_start:+.3f} m"]
    for kind, made in controllers.items():
        lines.append(f"{kind}: {made['name']}, in place of the stock one; its parameters:")
        lines += _parameter_lines(laboratory, kind)
    document |= {"controllers": controllers, "precision": laboratory.precision}
    print_result(json, document, lines + check_lines(flight, out, plot))
    exit_unless(flight.good)


def _parameter_lines(laboratory: Laboratory, kind: str) -> Iterator[str]:
    """Yield a controller's described parameters with value, bounds and unit, and the count of the others."""
    everything = laboratory.loop.controller_parameters()
    rows = {path: row for path, row in everything.items() if path.startswith(f"{kind}.")}
    shown = {path: row for path, row in rows.items() if row[0].text and not row[0].is_initial}
    for path, (declared, value) in shown.items():
        numbers = ", ".join(f"{v:.6g}" for v in value) if isinstance(value, list) else f"{value:.6g}"
        bounds = f"{declared.low:g} to {declared.high:g}"
        unit = f" {declared.unit}" if declared.unit else ""
        yield f"  {path} = {numbers}{unit} ({bounds}): {declared.text}"
    if len(rows) > len(shown):
        yield f"  and {len(rows) - len(shown)} more, initial values among them; --json lists them"


# The right gains leave less than 1e-5, in float32 too; a gain that is 1 % off leaves some 1e-2 of its loop's output.
_OTHER_GAINS = 1e-3
# Of what the failsafe did.
_SHOWN = 5


def replay(
    file: Annotated[Path, argument("A closed-loop flight log.", "LOG")],
    gains: Annotated[
        str | None,
        option("default, student, or a JSON file of gains; by default those named in the log, else default."),
    ] = None,
    precision: Annotated[RealType, option("Type of the reals in the compiled code.")] = "float64",
    json: Json = False,
) -> None:
    """Feed a log's inputs to the compiled flight code, and compare its outputs with the logged ones."""
    log, gains_given = read_log(file), gains is not None
    flown = FlownParameters.of(log.provenance)
    result = replay_log(log, None if gains is None else load_gains(gains), precision)
    gains = gains or ("default" if flown.gains is None else "that the log says")
    if flown.unknown or (flown.controllers and gains_given):
        names = one_line(", ".join(flown.unknown or flown.controllers))
        say_line(f"note: a controller of the user's flew ({names}), and the stock cascade is compared")
    bands = failsafe_bands(log)
    if bands:
        what = ", ".join(f"{band.start:.2f} to {band.stop:.2f} s {band.label}" for band in bands[:_SHOWN])
        say_line(f"note: the failsafe acted, whose set-points are not in the log: {what}")
    elif any(difference > _OTHER_GAINS for difference in result.nrms.values()):
        say_line(f"note: not the gains it was flown with? these are: {gains}; --gains takes others")
    rows = table("channel", "nrms", "coverage, %", right=(1, 2))
    for channel, share in result.coverage.items():
        difference = result.nrms.get(channel)
        rows.add_row(channel, "-" if difference is None else f"{difference:.2e}", f"{100.0 * share:.1f}")
    windows = ", ".join(f"{start:.2f} to {end:.2f} s" for start, end in result.windows)
    last = f"{precision}, gains {gains}; compared: {windows or 'nothing, no loop was active'}"
    print_result(json, result.to_json(), [rows, last])


def calibrate(
    data: Annotated[Path | None, option("Folder of the logs; default: searched for.", "FOLDER")] = None,
    leave_one_out: Annotated[
        bool,
        flag(
            "Also predict each flight from all others, and report how much gusts explain of the error.",
            "--leave-one-out",
        ),
    ] = False,
    out: Annotated[Path | None, option("Write the rig as JSON, for `--rig FILE`.")] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Calibrate the virtual rig on the logs of the real drone; exit status 1 if the search did not converge."""
    if out is not None:
        check_folder(out, force)  # before minutes of search
    folder = _folder() if data is None else data
    with progress() as report:
        found = calibrate_rig(folder, leave_one_out, report)
    if out is not None:
        save_rig(found.rig, out, force)
    fits = {"fit_percent": found.fit, "left_out_fit_percent": found.left_out, "ceiling_fit_percent": found.ceiling}
    document = {
        "converged": found.converged,
        "rig": dict(found.rig.snapshot()),
        "estimate": {name: {"value": value, "sigma": found.deviation[name]} for name, value in found.estimate.items()},
        **{key: {name: dict(row) for name, row in rows.items()} for key, rows in fits.items()},
        "file": None if out is None else str(out),
    }
    print_result(json, document, _calibration_lines(found, out))
    exit_unless(found.converged)


def _folder() -> Path:
    folders = {find(name).parent for name in FLIGHTS}
    if len(folders) > 1:
        raise LogError(
            "the public logs lie in several folders", ", ".join(map(str, sorted(folders))), "name one with --data"
        )
    return folders.pop()


def _calibration_lines(found: Calibration, out: Path | None) -> Iterator[RenderableType]:
    values = table("unknown", "value", "1 sigma", "meaning")
    for unknown in UNKNOWNS:
        value, sigma = found.estimate[unknown.name], found.deviation[unknown.name]
        values.add_row(unknown.name, f"{value:.5g}", f"{sigma:.2g}", unknown.text)
    yield values
    fits = table("flight", "theta", "q", "x", "v", "")
    for name in FLIGHTS:
        for word, fit in (("", found.fit), ("left out", found.left_out), ("ceiling", found.ceiling)):
            if name in fit:
                row = fit[name]
                fits.add_row(name, *(f"{row[channel]:.1f}" for channel in ("theta", "q", "x", "v")), word)
    yield "\nFIT, %:"
    yield fits
    yield "converged" if found.converged else "NOT converged: the best set seen is given"
    if out is not None:
        yield f"written: {out}"
