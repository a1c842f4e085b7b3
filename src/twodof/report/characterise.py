"""The paper's characterisation of one machine: its three experiments, by hand and by output error."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twodof.errors import IdentificationError
from twodof.identify.estimate import Estimate
from twodof.identify.greybox import fit
from twodof.identify.record import Record
from twodof.identify.simple_pitch import SimplePitch, identify_pitch, read_doublet, read_free_response
from twodof.identify.simple_velocity import SimpleVelocity, identify_velocity, read_step
from twodof.models.structures import free_response, pitch_rate, rail
from twodof.report.content import Uncertain
from twodof.report.experiments import only

# Below this many repetitions a spread says nothing about a standard deviation.
_REPETITIONS = 3
_TRAVELS = 3
# The range sensor's age beyond its stamp is estimated too: taken for zero it passes for less friction.
TRAVEL = ("k_v", "p_v", "tau", "theta_0", "x_0", "v_0")


@dataclass(frozen=True, eq=False)
class Flights:
    """Records of the three experiments; of each the first identifies and is drawn, the next two validate (of the
    velocity the first three identify).

    All repetitions together give the spread of the readings by hand. An experiment that was not flown is empty.
    `by_hand` names what the simple method may be read from: a drone that moves along the rail without having been
    given a doublet of pitch has no step response to read. `trim` is the moment that holds the drone level (default:
    the moment before the doublet).
    """

    impulses: Sequence[Record]
    doublets: Sequence[Record]
    velocities: Sequence[Record]
    by_hand: frozenset[str] = frozenset({"pitch", "velocity"})
    trim: float | None = None


@dataclass(frozen=True, eq=False)
class Characterisation:
    """Everything found out about one machine.

    `free`, `forced` and `travel` are the grey-box fits of the three experiments, `dry` that of the free response with
    dry friction and hardening; `simple` and `greybox` hold the parameters of Table 1 by key; `refusals` say what could
    not be identified and why.
    """

    flights: Flights
    pitch: SimplePitch | None
    velocity: SimpleVelocity | None
    free: Estimate | None
    dry: Estimate | None
    forced: Estimate | None
    travel: Estimate | None
    simple: Mapping[str, Uncertain]
    greybox: Mapping[str, Uncertain]
    refusals: Sequence[str]


def characterise(flights: Flights, dry_friction: bool) -> Characterisation:
    """Identify one machine by both methods.

    `dry_friction`: whether w_n and xi of the grey-box column come from the model with dry friction and a hardening
    spring (real bearings) or from the paper's linear one. What the data refuse is noted and left out, not raised.
    """
    refusals: list[str] = []

    def attempt(work: Callable[[], Estimate]) -> Estimate | None:
        try:
            return work()
        except IdentificationError as error:
            refusals.append(str(error))
            return None

    impulses, doublets, velocities = flights.impulses, flights.doublets, flights.velocities
    pitch = _pitch_by_hand(flights, refusals)
    along = _velocity_by_hand(flights, refusals)
    free = dry = forced = travel = None
    if impulses:
        free = attempt(lambda: fit(pitch_rate(), impulses[0], validation=impulses[1:3], values=_guess(pitch)))
        if dry_friction:
            dry = attempt(lambda: fit(free_response(), impulses[0], validation=impulses[1:3]))
    poles = dry if dry is not None else free
    if doublets and poles is not None:
        known = {"w_n": poles["w_n"], "xi": poles["xi"]} | ({"mu": pitch.model.mu} if pitch else {})
        forced = attempt(
            lambda: fit(
                pitch_rate(),
                doublets[0],
                estimate=("mu", "tau", "M_trim", "q_0"),
                values=known,
                validation=doublets[1:3],
            )
        )
    if velocities:
        seen = [only(record, "x") for record in velocities]
        # One doublet tells p_v to a tenth: several identify, if one is left to validate.
        first = min(_TRAVELS, max(1, len(seen) - 1))
        travel = attempt(lambda: fit(rail(), seen[:first], estimate=TRAVEL, validation=seen[first : first + 2]))
    greybox: dict[str, Uncertain] = {}
    for estimate, keys in ((poles, ("w_n", "xi")), (forced, ("mu", "tau")), (travel, ("k_v", "p_v"))):
        if estimate is not None:
            greybox |= {key: Uncertain(estimate[key], estimate.sigma(key)) for key in keys}
    if dry is not None:
        greybox |= {key: Uncertain(dry[key], dry.sigma(key)) for key in ("coulomb", "hardening")}
    simple = _readings(flights, pitch, along)
    return Characterisation(flights, pitch, along, free, dry, forced, travel, simple, greybox, refusals)


def _guess(pitch: SimplePitch | None) -> dict[str, float]:
    return {} if pitch is None else {"w_n": pitch.model.w_n, "xi": pitch.model.xi}


def _pitch_by_hand(flights: Flights, refusals: list[str]) -> SimplePitch | None:
    if not (flights.impulses and flights.doublets and "pitch" in flights.by_hand):
        return None
    try:
        return identify_pitch(flights.impulses[0], flights.doublets[:3], trim=flights.trim)
    except IdentificationError as error:
        refusals.append(str(error))
        return None


def _velocity_by_hand(flights: Flights, refusals: list[str]) -> SimpleVelocity | None:
    if not (flights.velocities and "velocity" in flights.by_hand):
        return None
    try:
        return identify_velocity(flights.velocities[:3])
    except IdentificationError as error:
        refusals.append(str(error))
        return None


def _readings(flights: Flights, pitch: SimplePitch | None, along: SimpleVelocity | None) -> dict[str, Uncertain]:
    """The first reading of each parameter by hand, with the spread of the same reading over all repetitions."""
    values: dict[str, list[float]] = {}
    if pitch is not None:
        model = pitch.model
        free = [read_free_response(record) for record in flights.impulses]
        forced = [read_doublet(record, model.w_n, model.xi, flights.trim) for record in flights.doublets]
        values |= {"w_n": [one.w_n for one in free], "xi": [one.xi for one in free]}
        values |= {"mu": [one.mu for one in forced], "tau": [one.tau for one in forced]}
    if along is not None:
        steps = [read_step(record) for record in flights.velocities]
        values |= {"k_v": [one.k_v for one in steps], "p_v": [one.p_v for one in steps]}
    return {key: Uncertain(found[0], _spread(found)) for key, found in values.items()}


def _spread(values: Sequence[float]) -> float:
    return float(np.std(values, ddof=1)) if len(values) >= _REPETITIONS else math.nan
