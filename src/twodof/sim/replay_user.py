"""Replay of a flight with the user's controllers: their diagrams, run over the log from one reset to the next."""

import itertools
import re
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np

from twodof.blocks import Diagram
from twodof.compile import build
from twodof.errors import ParameterError
from twodof.flight.control.cascade import cascade
from twodof.flight.control.level_hold import ArmingReset
from twodof.flight.gains import DEFAULT
from twodof.flight.templates import ATTITUDE, MOTOR, POSITION
from twodof.flightlog.log import FlightLog
from twodof.signals import PERIOD
from twodof.sim.flown_parameters import FlownParameters
from twodof.sim.time_alignment import AlignedLog, Flags, Floats

_ELEMENT = re.compile(r"(.+)\[(\d{1,6})\]")


class UserReplay(NamedTuple):
    """Outputs (n,) by channel on the steps of the log, and flags (n,) where they may be compared."""

    replayed: dict[str, Floats]
    compared: dict[str, Flags]


def replay_user(
    log: FlightLog, paired: AlignedLog, flown: FlownParameters, precision: str, unsure: Flags
) -> UserReplay:
    """Runs the cascade with the user's controllers over the whole log, at its modes and set-points.

    What a user's controller remembers is known where it is reset: with no thrust, and just after. So it is compared
    from there up to the first missing sample, except the `unsure` steps (n,). M is not compared where a user's motor
    controller flew, and nothing is where the log lacks the channel `mode`.

    Whoever wrote the log wrote the diagrams: they run in the sandbox, as on board. Raises LogError if the log lacks
    another channel, CompileError where a sandbox is missing, and ControllerFault where a step uses up its fuel.
    """
    if "mode" not in log.channels:
        return UserReplay({}, {})
    inputs, lost = _inputs(log, paired)
    machine = build(_diagram(flown), dt=PERIOD, precision=precision, target="wasm").machine()
    _tune(machine, flown.tuning)
    n = len(paired.time)
    places = [int(place) for place in np.searchsorted(paired.time, [row[0] for row in flown.changes], "right")]
    pieces, gains = [], flown.gains or DEFAULT
    for a, b in itertools.pairwise(sorted({0, n, *(place for place in places if place < n)})):
        changes = [row for place, row in zip(places, flown.changes, strict=True) if place == a]
        for _, name, value in changes:
            gains = gains.changed(name, value)
            _tune(machine, {**gains.parameters(), name: value})
        pieces.append(machine.run(b - a, {name: column[a:b] for name, column in inputs.items()}))
    out = {name: np.concatenate([np.asarray(piece[name]) for piece in pieces]) for name in pieces[0]}
    known = _known(out["reset"].astype(np.bool_), lost) & ~unsure
    names = ["q0", "theta0", "T"] if MOTOR.name in flown.controllers else ["M", "q0", "theta0", "T"]
    active = {name: paired.active[name] for name in names if paired.active[name].any()}
    replayed = {name: np.asarray(out[name], dtype=np.float64) for name in active}
    return UserReplay(replayed, {name: flags & known for name, flags in active.items()})


def _diagram(flown: FlownParameters) -> Diagram:
    """The cascade with the user's controllers, and the reset that comes before it on board."""
    item = cascade(flown.gains or DEFAULT, flown.controllers.get(ATTITUDE.name), flown.controllers.get(POSITION.name))
    d = Diagram("flown")
    for port in item.inputs.values():
        d.input(port.name, port.kind, unit=port.unit)
    d.add("arming", ArmingReset(), mode="mode", thrust="thrust", in_reset="in_reset")
    d.add("cascade", item, inputs={name: name for name in item.inputs} | {"in_reset": "arming"})
    for name in ("M", "q0", "theta0", "T"):
        d.output(name, f"cascade.{name}")
    d.output("reset", "arming")
    return d


def _inputs(log: FlightLog, paired: AlignedLog) -> tuple[dict[str, Any], Flags]:
    """What the cascade read at each step, (n,), and where something of it is missing."""
    n = len(paired.time)
    at = {"mode": log["mode"].index(paired.time, "next"), "x0": log["x0"].index(paired.time, "next")}
    at["x"] = log["x"].index(paired.time, "hold")
    lost = np.any([*paired.lost.values(), *(places < 0 for places in at.values())], axis=0)
    read = {name: log[name].value[np.maximum(places, 0)] for name, places in at.items()}
    mode = read.pop("mode").astype(np.int32)
    # In the modes without a velocity loop the thrust is given; in open loop nothing else is.
    given = {"thrust": paired.value["T"], "M_open": paired.value["M"], "mode": mode, "in_reset": np.zeros(n, np.bool_)}
    return given | read | {name: paired.value[name] for name in ("q0", "theta0", "v0", "q", "theta", "v")}, lost


def _tune(machine: Any, values: Mapping[str, Any]) -> None:
    """Sets parameters of the cascade by path, an array's element by its index.

    Anybody may have written them: unknown paths, and values that the parameter refuses, are left out.
    """
    for path, value in values.items():
        element = _ELEMENT.fullmatch(path)
        full = f"cascade.{element[1] if element else path}"
        if full not in machine.parameters:
            continue
        given = value
        if element:
            before, place = machine.get(full), int(element[2])
            if not isinstance(before, list) or place >= len(before):
                continue
            given = [*before[:place], value, *before[place + 1 :]]
        with suppress(ParameterError, OverflowError):  # a whole number may be larger than any float
            machine.set(full, given)


def _known(reset: Flags, lost: Flags) -> Flags:
    """Where the controllers' states are known, (n,): since the last reset nothing was lost."""
    step = np.arange(len(reset))
    since_reset = np.maximum.accumulate(np.where(reset, step, -1))
    since_loss = np.maximum.accumulate(np.where(lost, step, -1))
    return (since_reset >= 0) & (since_loss < since_reset)
