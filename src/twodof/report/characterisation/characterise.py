"""The paper's characterisation of one machine: its three experiments, by hand and by output error."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TypeVar

import numpy as np

from twodof.errors import IdentificationError, ParameterError
from twodof.identify.estimate import Estimate
from twodof.identify.experiments import only
from twodof.identify.greybox import fit
from twodof.identify.ready_made import SWING, TRAVEL, FlownMachine, by_output_error, structure_for
from twodof.identify.record import Record
from twodof.identify.repeated import Spread
from twodof.identify.simple_pitch import SimplePitch, identify_pitch, read_doublet, read_free_response
from twodof.identify.simple_velocity import SimpleVelocity, identify_velocity, read_step
from twodof.models.plant import thrust_curve
from twodof.models.structures import pitch_rate, rail
from twodof.report.content import Uncertain

# Below this many repetitions a spread says nothing about a standard deviation.
_REPETITIONS = 3
_TRAVELS = 3


@dataclass(frozen=True, eq=False)
class ExperimentRecords:
    """Records of the three experiments; an experiment that was not flown is empty.

    The first record of each identifies and is drawn, the next two validate; of the velocity the first three identify.
    All repetitions together give the spread of the readings by hand. `by_hand` names the experiments for the simple
    method: without a doublet of pitch, for example, a motion along the rail does not show a step response. `trim` is
    the moment that holds the drone level (default: the moment before the doublet). With `gyro_bias` the bias of a real
    gyro is estimated too. `machine` is the rig whose calibration holds. `surroundings` hold a longer stretch of a
    record's flight, by the record's name, for pictures.
    """

    impulses: Sequence[Record]
    doublets: Sequence[Record]
    velocities: Sequence[Record]
    by_hand: frozenset[str] = frozenset({"pitch", "velocity"})
    trim: float | None = None
    gyro_bias: bool = False
    machine: FlownMachine = field(default_factory=FlownMachine)
    surroundings: Mapping[str, Record] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Characterisation:
    """Results about one machine.

    `free`, `forced` and `travel` are the grey-box fits of the three experiments, `pulse` that of the impulse with the
    free swing held, for the gain without thrust. `simple` and `greybox` hold the parameters of Table 1 by key,
    `spreads` the standard deviation of the grey-box estimates among repetitions. `refusals` are the reasons for missing
    results.
    """

    flights: ExperimentRecords
    pitch: SimplePitch | None
    velocity: SimpleVelocity | None
    free: Estimate | None
    pulse: Estimate | None
    forced: Estimate | None
    travel: Estimate | None
    simple: Mapping[str, Uncertain]
    greybox: Mapping[str, Uncertain]
    spreads: Mapping[str, Spread]
    refusals: Sequence[str]

    @property
    def fits(self) -> dict[str, Estimate]:
        """Return the grey-box fits of Table 1, by experiment."""
        found = {"free response": self.free, "doublet": self.forced, "velocity": self.travel}
        return {name: estimate for name, estimate in found.items() if estimate is not None}


def characterise(flights: ExperimentRecords, dry_friction: bool) -> Characterisation:
    """Identify one machine by both methods.

    The free response is fitted as `twodof identify` does it. `dry_friction`: dry friction and hardening stand in the
    table too (real bearings), and the rail has dry friction. Failed identifications are noted in `refusals`, not
    raised.
    """
    refusals: list[str] = []
    pitch, along = None, None
    if flights.impulses and flights.doublets and "pitch" in flights.by_hand:
        doublets = flights.doublets[:3]
        pitch = _tried(lambda: identify_pitch(flights.impulses[0], doublets, trim=flights.trim), refusals)
    if flights.velocities and "velocity" in flights.by_hand:
        along = _tried(lambda: identify_velocity(flights.velocities[:3]), refusals)
    gain = {} if pitch is None else {"mu": pitch.model.mu}
    seen = [only(record, "x") for record in flights.velocities]
    greybox: dict[str, Uncertain] = {}
    spreads: dict[str, Spread] = {}

    def identify(
        records: Sequence[Record], keys: Sequence[str], work: Callable[..., Estimate], count: int = 1
    ) -> Estimate | None:
        """Fit the first `count` records, and enter the values of `keys` and their spread into the table."""
        if not records:
            return None
        unseen = records[count : count + 2]
        found = _tried(lambda: work(records[:count], validation=unseen), refusals)
        if found is None:
            return None
        greybox.update({key: Uncertain(found[key], found.sigma(key)) for key in keys})
        if keys and len(records) // count >= _REPETITIONS:
            # What the claimed standard deviations must stand up to.
            starts = range(0, len(records) - count + 1, count)
            again = [work(records[k : k + count]) for k in starts]
            spreads.update({key: Spread(_spread([one[key] for one in again]), len(again)) for key in keys})
        return found

    swing = structure_for("impulse")

    def swung(records: Sequence[Record], validation: Sequence[Record] = ()) -> Estimate:
        machines = [flights.machine] * (len(records) + len(validation))
        found, _ = by_output_error("impulse", swing, records, validation, machines=machines)
        assert isinstance(found, Estimate)  # of one record
        return found

    free = identify(flights.impulses, SWING if dry_friction else ("w_n", "xi"), swung)
    # A rig without dry friction has it fixed.
    held = {name: free.fixed[name] if name in free.fixed else free[name] for name in SWING} if free else {}
    told = tuple(name for name in swing.estimate if name not in held)
    pushed = partial(fit, swing, estimate=told, values={**flights.machine.values(swing), **held})
    pulse = identify(flights.impulses, (), pushed) if held else None
    poles = {key: greybox[key].value for key in ("w_n", "xi") if key in greybox}
    # With the rotors' lag: without it the noise model would take the misfit at each edge for a gust.
    driven = partial(fit, pitch_rate(lag=True), estimate=FORCED, values=poles | gain)
    forced = identify(flights.doublets, ("mu", "tau"), driven) if poles else None
    curve = _curve(pulse, forced, refusals)
    wanted = (*TRAVEL, *["q_trim"] * flights.gyro_bias, *["coulomb"] * dry_friction)
    moving = partial(fit, rail(thrust=bool(curve)), estimate=wanted, values=curve)
    # One doublet tells p_v to a tenth: several identify, if one is left to validate.
    travel = identify(seen, ("k_v", "p_v"), moving, min(_TRAVELS, max(1, len(seen) - 1)))
    simple = _readings(flights, pitch, along)
    return Characterisation(flights, pitch, along, free, pulse, forced, travel, simple, greybox, spreads, refusals)


def _curve(idle: Estimate | None, run: Estimate | None, refusals: list[str]) -> dict[str, float]:
    """Return the thrust curve of the gains without and with thrust; empty if there is none."""
    if idle is None or run is None:
        return {}
    try:
        return {"curve": thrust_curve(idle["mu"], run["mu"])}
    except ParameterError as error:
        refusals.append(f"{error.what}: the velocity’s model takes the thrust for constant")
        return {}


# What a doublet can tell, tau being the sum of dead time and lag; the poles show only after it is over.
FORCED = ("mu", "dead_time", "lag", "M_trim", "q_0")
_Found = TypeVar("_Found")


def _tried(work: Callable[[], _Found], refusals: list[str]) -> _Found | None:
    """Return the result of `work`, or None, with the reason in `refusals`."""
    try:
        return work()
    except IdentificationError as error:
        refusals.append(str(error))
        return None


def _readings(
    flights: ExperimentRecords, pitch: SimplePitch | None, along: SimpleVelocity | None
) -> dict[str, Uncertain]:
    """Return the first reading of each parameter by hand, with the spread of the reading over all repetitions."""
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
    read = {key: Uncertain(found[0], _spread(found)) for key, found in values.items()}
    if "tau" in read:
        # Samples are counted: readings that all agree are still uncertain by the width of a sample.
        width = flights.doublets[0].dt / math.sqrt(12.0)
        read["tau"] = Uncertain(read["tau"].value, math.hypot(read["tau"].sigma, width))
    return read


def _spread(values: Sequence[float]) -> float:
    return float(np.std(values, ddof=1)) if len(values) >= _REPETITIONS else math.nan
