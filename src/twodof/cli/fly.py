"""`twodof fly`: fly a ready-made experiment over MAVLink, on a virtual drone or a real one."""

import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from math import degrees
from pathlib import Path
from types import MappingProxyType
from typing import Annotated

import typer

from twodof.cli.connection import KeyOfDrone, SystemOfDrone, connect
from twodof.cli.flown import Out, Plot, check_lines, check_places, keep
from twodof.cli.options import Force, Json, argument, flag, option
from twodof.cli.output import exit_unless, print_result, progress, say_line
from twodof.errors import LinkLost
from twodof.experiment.experiments import EXPERIMENTS
from twodof.experiment.experiments import experiment as named_experiment
from twodof.experiment.flight import Flight, Laboratory
from twodof.experiment.fly import fly as fly_experiment
from twodof.fleet.local_drone import controller_in_words
from twodof.fleet.virtual_drone import virtual_drone
from twodof.flightlog.files import write_log
from twodof.gcs.async_drone import DEFAULT_URL
from twodof.gcs.drone import Drone


def fly(
    experiment: Annotated[str, argument(f"One of {', '.join(EXPERIMENTS)}.")],
    url: Annotated[str | None, option(f"The drone's address, as `twodof up` prints it [{DEFAULT_URL}].")] = None,
    rig: Annotated[
        str | None, option("lab, paper, or a JSON file: start a virtual drone on this rig and fly it.")
    ] = None,
    controller: Annotated[
        list[str] | None, option("With --rig: fly this controller, in a sandbox; repeatable.", "DIAGRAM")
    ] = None,
    drone: SystemOfDrone = None,
    key: KeyOfDrone = None,
    seed: Annotated[int, option("Seed of a virtual drone's noise.", min=0, max=2**32 - 1)] = 1,
    start: Annotated[
        float | None,
        option("Start position of the cart [m]; default: chosen so that the flight fits on the rail.", "X"),
    ] = None,
    withhold_tuning: Annotated[
        bool, flag("Do not let other programs change parameters during the flight.", "--withhold-tuning")
    ] = False,
    out: Out = None,
    plot: Plot = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Arm, hold, excite on board, disarm, and check that the data are good enough.

    A virtual drone is reset to its start first. If something goes wrong, the flight ends early: the drone is levelled
    and disarmed, and the log keeps the flight up to there. Ctrl-C disarms at once, with exit status 130. Exit status 1:
    the flight ended early, or its data are not good enough.
    """
    asked = named_experiment(experiment)
    if url is not None and rig is not None:
        raise typer.BadParameter("--url and --rig name two drones: give one of them")
    if controller and rig is None:
        raise typer.BadParameter("--controller goes with --rig: another drone flies what it was given")
    check_places(out, plot, force)
    with ExitStack() as stack:
        shown = FlightValues()
        report = stack.enter_context(progress(shown))
        report("connecting" if rig is None else "starting the drone", 0.0)
        at = (
            url or DEFAULT_URL if rig is None else stack.enter_context(virtual_drone(rig, controllers=controller or ()))
        )
        there = shown.drone = stack.enter_context(connected(at, key, drone))
        report("goes to its start", 0.0)
        if withhold_tuning:
            there.withhold_tuning()
        stands = there.state.rig
        if stands.controller and not json:
            sys.stderr.write(
                f"drone {there.there.session.system} {controller_in_words(stands.controller, stands.changed)}\n"
            )
        laboratory = Laboratory(rig, controllers=controller) if rig is not None and controller else None

        def interrupted(flight: Flight) -> None:
            if out is not None:
                write_log(flight.log, out, overwrite=force)
                say_line(f"written: {out}, up to the interruption")

        flight = fly_experiment(
            asked,
            there,
            seed=seed,
            x_start=start,
            laboratory=laboratory,
            progress=lambda text, share: report(IN_WORDS.get(text, text), share),
            interrupted=interrupted,
        )
        machine = there.state.rig
        document = keep(flight, machine.name, out, plot, force)
    document |= {"controller": stands.controller, "changed": stands.changed}
    document |= {"virtual": machine.virtual, "reason": flight.reason or None}
    where = f"seed {flight.seed}, start x = {flight.x_start:+.3f} m"
    lines = [f"{experiment} flown on {machine.name}, {where}", *check_lines(flight, out, plot)]
    print_result(json, document, lines)
    exit_unless(flight.good)


@contextmanager
def connected(url: str, key: Path | None, system: int | None) -> Iterator[Drone]:
    """Connect to the drone at `url`; on leaving, ignore a lost link, which the flight has reported."""
    drone = connect(url, key=key, drone=system)
    try:
        yield drone
    finally:
        with suppress(LinkLost):
            drone.close()


IN_WORDS: Mapping[str, str] = MappingProxyType(
    {"arm": "arms", "hold": "holds still", "excite": "is excited", "disarm": "disarms"}
)
"""Step of a flight -> its words on the progress bar."""

_SHOWN = (
    ("theta", "estimate.theta", degrees(1.0), "+5.1f", " deg"),
    ("x", "estimate.x", 1.0, "+.3f", " m"),
    ("M", "command.M", 1.0, "+.3f", ""),
)


class FlightValues:
    """Latest values of `drone` in a line; "" before it is connected."""

    def __init__(self) -> None:
        self.drone: Drone | None = None

    def __call__(self) -> str:
        if self.drone is None:
            return ""
        if words := self.drone.state.safety.in_words():
            return f"FAILSAFE {words}"
        said = []
        for name, signal, scale, how, unit in _SHOWN:
            latest = self.drone.telemetry(signal).latest
            if latest is not None and isinstance(latest.value, float):
                said.append(f"{name} {scale * latest.value:{how}}{unit}")
        return "  ".join(said)
