"""Ready-made fits of the paper's experiments: structures by name, priors, and values held from earlier flights."""

import functools
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from twodof.errors import IdentificationError, shown
from twodof.flightlog.log import FlightLog
from twodof.flightlog.rotor_speed import supply_of
from twodof.identify.disturbance.disturbance_model import Disturbance
from twodof.identify.estimate import Estimate
from twodof.identify.experiments import KINDS, free_swing, in_motion, kind_of, only
from twodof.identify.greybox import fit
from twodof.identify.record import SHORTEST_PIECE, Record
from twodof.identify.repeated import Repeated, check_repetitions
from twodof.identify.simple_pitch import SimplePitch, identify_pitch
from twodof.identify.simple_velocity import SimpleVelocity, identify_velocity
from twodof.identify.validate import deviations
from twodof.models.structure import Structure
from twodof.models.structures import RAIL_WALK, free_response, pitch_on_cart, pitch_rate, rail, velocity
from twodof.rig.parameters import NAMES, load_rig
from twodof.rig.rig import cart_parameters, gyro_walk, model_parameters, moment_gain, stiffness

POLES_PRIOR: Mapping[str, tuple[float, float]] = MappingProxyType({"w_n": (2.28, 0.31), "xi": (0.065, 0.04)})
"""Priors from the real drone's logs of the pendulum while the rotors run (docs/explanation/physics.md, section 9).

The stiffness is 5.2 +- 1.4 1/s2. The damping is between that of the free response beside dry friction, .036, and with
all of it taken for viscous, .10. The prior is almost all above 0, as no bearing pushes."""

FRICTION_PRIOR: Mapping[str, tuple[float, float]] = MappingProxyType({"coulomb": (0.065, 0.04)})
"""The bearing's dry friction: not less than nothing, and a fraction of the .26 rad/s2 with the rotors at rest.

Mean and deviation are those of a normal .05 +- .05 without what is below 0."""

RAIL_PRIOR: Mapping[str, tuple[float, float]] = MappingProxyType({"q_trim": (0.0, 0.001), "coulomb": (0.065, 0.04)})
"""Bias of the gyro [rad/s] and dry friction of the rail [m/s2].

In the real logs the integral of the gyro leaves the measured pitch by .0009 rad/s, the root of the mean square of seven
flights. A level rail lets the cart slide at .6 deg, which is .1 m/s2, and friction is not less than nothing: as in
`FRICTION_PRIOR`.
"""

BEND_PRIOR: Mapping[str, tuple[float, float]] = MappingProxyType({"bend": (0.0, 1.0)})
"""What a large moment may lack: of the hardest of the real logs, .35, an eighth."""

WAKE_PRIOR: Mapping[str, tuple[float, float]] = MappingProxyType({"wake": (0.0, 4.0)})
"""Pitch acceleration by the rotors' wake [rad/s2]: level drones held -4 to 6 of it in the real logs."""

FREE = 1e3
"""Play of a cart without rings [m]. Its modelled way drifts by metres in half a minute, and must meet no stop."""

_REAL = "lab"
_FRICTION = 0.7
"""Residual with dry friction over that without, from which on the structure is named."""
_SWING_STEPS = 4
"""Steps in a sample of the free response. With two, dry friction is found .4 of what is claimed too small."""
_MOVED_M = 0.1
"""The range sensor's noise stays within this in a flight with rings; a free cart moves three times as far [m]."""


@dataclass(frozen=True)
class FlownMachine:
    """The rig whose calibration holds for a flight, and whether its cart was `free` to slide.

    `supply` is the thrust over that at which k_v is stated, and its standard deviation, if the log tells it. It is of
    the flight, and not of the machine. A `virtual` rig has nothing that its parameters do not say.
    """

    rig: str = _REAL
    free: bool = False
    supply: tuple[float, float] | None = field(default=None, compare=False)
    virtual: bool = field(default=False, compare=False)

    @property
    def text(self) -> str:
        """In words."""
        return f"'{self.rig}' with its cart {'free' if self.free else 'in rings'}"

    def values(self, structure: Structure) -> dict[str, float]:
        """Return the structure's unknowns that the calibration gives: the cart, and its play within the rings."""
        return known_cart(load_rig(self.rig).snapshot(), structure, self.free)

    def prior(self, structure: Structure) -> dict[str, tuple[float, float]]:
        """Return mean and standard deviation of the unknowns with a prior; they are estimated too."""
        known = priors_of(None if self.rig == _REAL else load_rig(self.rig).snapshot(), structure)
        return {name: one for name, one in known.items() if name not in BEND_PRIOR or not self.virtual}

    def estimate(self, structure: Structure) -> tuple[str, ...]:
        """Return the unknowns to estimate in closed loop.

        Of `pitch_on_cart` they include `M_u` on a free cart, and what has a prior: `bend`, friction, and `wake`
        where it leaves a pitched drone.
        """
        fades = load_rig(self.rig)["wake_fade"] > 0.0
        more = ("bend", *(("M_u",) if self.free else ()), *(("wake",) if fades else ()))
        named = (*structure.estimate, *(name for name in more if name in structure.unknowns))
        known = self.prior(structure)
        held = ("bend", "coulomb", *self.values(structure))
        return tuple(name for name in named if name in known or name not in held)


_FAST_HZ = 8.0
"""The drone's own motion is slower, but for the edges of a step."""


def gyro_noise(record: Record) -> float:
    """Return the standard deviation of the measured q about the true one [rad/s]: vibration and noise above 8 Hz.

    It is that of the middle half of the samples, which steps do not reach. A random signal does: then it is too large,
    and less is told of the friction.
    """
    from scipy.signal import butter, sosfiltfilt  # imported late: most commands start without it

    if record.steps < 50 or 2.0 * _FAST_HZ * record.dt >= 1.0:
        return 0.0
    fast = sosfiltfilt(butter(2, 2.0 * _FAST_HZ * record.dt, "high", output="sos"), record.inputs["gyro"])
    return float(np.subtract(*np.percentile(fast, (75, 25))) / 1.349)


def known_cart(rig: Mapping[str, float], structure: Structure, free: bool) -> dict[str, float]:
    """Return the structure's unknowns that a rig's parameters give: the cart, its play within the rings, the spring.

    Rotors without a lag have the least one that the structure can have.
    """
    springy = rig["spring"] / stiffness(rig, running=0.0)
    known = {**cart_parameters(rig), "play": FREE if free else rig["ring_play"], "springy": springy}
    known |= {} if rig["lag"] > 0.0 else {"lag": 0.0}
    own = structure.unknowns
    return {name: max(value, own[name].lower) for name, value in known.items() if name in own}


@functools.lru_cache(maxsize=64)
def _on_rail(structure: Structure, rig: str) -> Structure:
    """Return the structure with the pushes that a rig has: white noise of its gyro, and uneven dry friction if any."""
    own, (_, doubt) = load_rig(rig).snapshot(), RAIL_WALK["theta_0"]
    uneven = {name: one for name, one in RAIL_WALK.items() if name == "v_0" and own["rail_coulomb"] > 0.0}
    return replace(structure, pushed={"theta_0": (gyro_walk(own), doubt), **uneven})


def known_rail(rig: Mapping[str, float]) -> tuple[dict[str, float], dict[str, tuple[float, float]]]:
    """Return what a rig's parameters give of a motion along the rail: values of `rail`, and priors."""
    lever, dry = cart_parameters(rig)["lever"], rig["rail_coulomb"] > 0.0
    known = {"curve": rig["curve"], "rotor_delay": rig["delay"] + rig["lag"], "lever": lever}
    known |= {} if rig["tof_age"] > 0.0 else {"tau": 0.0}
    return known, {name: one for name, one in RAIL_PRIOR.items() if dry or name != "coulomb"}


def priors_of(rig: Mapping[str, float] | None, structure: Structure) -> dict[str, tuple[float, float]]:
    """Return mean and deviation of the poles, of the bearing's friction and of `bend`, where the structure has them.

    The poles' means are those of the `rig` with its rotors running; without one, those that the real logs tell. A rig
    has no `bend`, and where it has no dry friction no prior of it.
    """
    poles, rest = dict(POLES_PRIOR), {**FRICTION_PRIOR, **BEND_PRIOR}
    if rig is not None:
        rest = dict(FRICTION_PRIOR) if rig["coulomb_run"] > 0.0 else {}
        poles = {name: (model_parameters(rig)[f"{name}_run"], poles[name][1]) for name in poles}
    before = {**poles, **rest, **WAKE_PRIOR}
    return {name: one for name, one in before.items() if name in structure.unknowns}


def machine_of(log: FlightLog, start: float, stop: float) -> FlownMachine:
    """Return the machine of a log, by the rig that it names and by the travel of the cart from `start` to `stop` [s].

    A log that names no virtual rig is one of the real drone, whose calibration is `lab`.
    """
    seen = log["dist"].slice(start, stop).value if "dist" in log else np.zeros(0)
    moved = seen.size > 0 and float(np.ptp(seen)) > _MOVED_M
    rig, virtual = _rig_in(log)
    supply = supply_of(log, start, stop) if moved else None
    return FlownMachine(rig or _REAL, moved, supply, virtual or "seed" in log.provenance)


def _rig_in(log: FlightLog) -> tuple[str | None, bool]:
    """Return the known rig that a flight's or a recording's log names, and whether the log says that it was virtual."""
    own = log.provenance
    tables = [own, *(table for key in ("flown", "drone") if isinstance(table := own.get(key), dict))]
    named = next((rig for table in tables if isinstance(rig := table.get("rig"), str)), None)
    return named if named in NAMES else None, any(table.get("virtual") is True for table in tables)


def reference_values(log: FlightLog, experiment: str, start: float, stop: float) -> dict[str, float]:
    """Return `true_values` if the log says that the rig was virtual; else none."""
    name, virtual = _rig_in(log)
    if name is None or not virtual:
        return {}
    return true_values(load_rig(name).snapshot(), experiment, log, start, stop)


def true_values(
    rig: Mapping[str, float], experiment: str, log: FlightLog, start: float, stop: float
) -> dict[str, float]:
    """Return the true unknowns of an experiment (`TRUTH`) flown on a rig with these parameters.

    mu and k_v are those at the battery's mean voltage from `start` to `stop` [s], mu also at the thrust. A log that
    lacks these signals has no truth.
    """
    if "T" not in log or "voltage" not in log:
        return {}
    thrust = log["T"].slice(start, stop)
    sampled = log["voltage"].slice(start - 1.0, stop)  # it comes twice a second, and rises when the motors stop
    if not thrust.value.size or not sampled.value.size:
        return {}
    # A pack that polarises falls by .2 % a second: the samples before `start` count for the time after it only.
    volts = np.interp(thrust.time, sampled.time, sampled.value)
    supply = float(np.mean((volts / (rig["voltage_full"] - rig["resistance"] * rig["hover_current"])) ** 2))
    known = model_parameters(rig)
    known |= {"mu": supply * moment_gain(rig, float(np.mean(thrust.value))), "k_v": supply * known["k_v"]}
    return {unknown: known[name] for unknown, name in TRUTH[experiment].items()}


ENOUGH_SHARE = 0.25
"""An unknown is known well enough if its 95 % interval is within this share of its value.

Of a gain that is 2 dB, a third of the margin of 6 dB that a controller commonly keeps."""

LEVEL = 0.95

PURPOSE: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"impulse": ("w_n", "xi"), "doublet": ("mu", "tau"), "attitude": ("mu", "tau"), "velocity": ("k_v", "p_v")}
)
"""What each experiment is flown for."""

_RUNNING = {"mu": "mu", "tau": "tau", "w_n": "w_n_run", "xi": "xi_run"}

TRUTH: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "impulse": {"w_n": "w_n", "xi": "xi", "coulomb": "coulomb", "hardening": "hardening"},
        "doublet": _RUNNING,
        "attitude": {**_RUNNING, "coulomb": "coulomb_run"},
        "velocity": {"k_v": "k_v", "p_v": "p_v", "coulomb": "rail_coulomb"},
    }
)
"""Unknowns of each experiment that a rig's parameters tell, by their names in `model_parameters`."""


@dataclass(frozen=True)
class Sufficiency:
    """`shares` are half the 95 % intervals over the values, by unknown; `reasons` say what is missing.

    `trusted`: the error bars can be believed. Where the residual wanders, they are too small by an unknown factor.
    """

    shares: Mapping[str, float]
    reasons: tuple[str, ...]
    trusted: bool = True

    @property
    def enough(self) -> bool:
        """Return True if nothing is missing."""
        return not self.reasons

    @property
    def text(self) -> str:
        """In a sentence."""
        known = ", ".join(f"{name} ± {100.0 * share:.2g} %" for name, share in self.shares.items())
        doubt = "" if self.trusted else ". But the residual wanders, so these are too narrow: fly it again and compare"
        if self.enough:
            return f"informative enough: {known} (95 % intervals){doubt}"
        return f"not informative enough: {'; '.join(self.reasons)}{doubt}"


def sufficiency(found: Estimate, wanted: Collection[str] = ()) -> Sufficiency:
    """Judge a fit by the unknowns `wanted`, if it has them, else by every unknown that is not local to a record."""
    asked = [name for name in (*found.labels, *found.summed) if name in wanted]
    asked = asked or [name for name in found.labels if name not in found.local]
    shares, reasons, rough = {}, [], []
    if not found.converged:
        reasons.append("the search did not converge")
    for name in asked:
        value, sigma = found[name], found.sigma(name)
        if name in found.at_bound or not sigma >= 0.0:
            reasons.append(f"{name} is held by its bound")
            continue
        shares[name] = deviations(LEVEL) * sigma / abs(value) if value else float("inf")
        if shares[name] > ENOUGH_SHARE:
            rough.append(f"{name} ± {100.0 * shares[name]:.0f} %")
    if rough:
        reasons.append(f"the 95 % intervals are wide: {', '.join(rough)}")
    return Sufficiency(shares, tuple(reasons), not found.wanders)


AUTO = "auto"
"""The paper's structure for the experiment."""

STRUCTURES: Mapping[str, Callable[[], Structure]] = MappingProxyType(
    {
        "pitch-rate": pitch_rate,
        "pitch-rate-lag": lambda: pitch_rate(lag=True),
        "free-response": lambda: free_response(substeps=_SWING_STEPS),
        "pitch-on-cart": pitch_on_cart,
        "velocity": velocity,
        "rail": rail,
    }
)
"""The ready-made structures; `velocity` is the paper's, between on-board estimates."""

FLOWN_AS: Mapping[str, str] = MappingProxyType(
    {
        "velocity-doublet": "velocity",
        "velocity-doublets": "velocity",
        "position-sweep": "velocity",
        "attitude-steps": "attitude",
        "attitude-prbs": "attitude",
        "rate-doublets": "attitude",
    }
)
"""What an experiment of `KINDS` is called where it is flown, if it is another name."""

NOT_BY_HAND = "in closed loop nothing is read by hand: the controller answers what the ruler would measure"
"""Why the simple method refuses a flight in closed loop."""

SWING = ("w_n", "xi", "coulomb", "hardening")
"""What a free response tells and a doublet hardly does: it is over before the poles show."""

SWUNG = (*SWING, "theta_0", "q_0")
"""What is estimated of a free response by default; friction only where the rig has it."""

TRAVEL = ("k_v", "p_v", "tau", "theta_0", "x_0", "v_0")
"""What a motion along the rail tells. The range sensor's age beyond its stamp passes for less friction if it is 0."""


def released(structure: Structure) -> tuple[str, ...]:
    """Return the unknowns of a free response: the structure's own and the delay, without which it lags behind."""
    return tuple(dict.fromkeys((*structure.estimate, *filter(None, [structure.delay]))))


def experiment_in(log: FlightLog) -> str:
    """Return the experiment of `KINDS` that a log holds: by its own words, else by its signals.

    Raises LogError where none is found, IdentificationError where it says an experiment that tells no model.
    """
    flown = log.provenance.get("experiment")
    if not isinstance(flown, str):
        return kind_of(log).name
    name = FLOWN_AS.get(flown, flown)
    if name not in KINDS:
        what = f"nothing is identified from the experiment {shown(flown)}"
        raise IdentificationError(what, log.source, f"say which it is: {', '.join(KINDS)}")
    return name


@functools.lru_cache(maxsize=64)  # the same structure again has its program compiled
def structure_for(experiment: str, name: str = AUTO) -> Structure:
    """Return the structure `name` of `STRUCTURES`, or with `AUTO` the paper's for an experiment of `KINDS`.

    Raises IdentificationError for a name that is not there, and for a structure of another experiment's inputs.
    """
    if name == AUTO and experiment == "attitude":
        return pitch_on_cart()
    if name == AUTO:
        if experiment == "impulse":
            return STRUCTURES["free-response"]()
        return rail(thrust=True) if experiment == "velocity" else pitch_rate(lag=experiment == "doublet")
    if name not in STRUCTURES:
        raise IdentificationError(f"no structure called {shown(name)}", "", f"there are: {', '.join(STRUCTURES)}")
    structure = STRUCTURES[name]()
    if experiment in KINDS and not set(structure.inputs) <= set(KINDS[experiment].inputs):
        driven = ", ".join(KINDS[experiment].inputs)
        what = f"this structure is driven by {', '.join(structure.inputs)}, the experiment by {driven}"
        remedy = f"take the structure {AUTO!r}"
        raise IdentificationError(what, f"structure '{name}', experiment '{experiment}'", remedy)
    return structure


def by_hand(
    experiment: str, record: Record, others: Sequence[Record] = (), free: Record | None = None
) -> SimplePitch | SimpleVelocity:
    """Read a model by the paper's simple method; a doublet needs a `free` response. Raises IdentificationError."""
    if experiment == "velocity":
        return identify_velocity([record, *others])
    if experiment == "attitude":
        raise IdentificationError(NOT_BY_HAND, f"experiment '{experiment}'", "take output error with its noise model")
    if experiment == "impulse" or free is None:
        what = "by hand, the poles are read from a free response and the rest from a doublet"
        remedy = "give a doublet's log, and the impulse's beside it"
        raise IdentificationError(what, f"experiment '{experiment}'", remedy)
    return identify_pitch(free, [record, *others])


def by_output_error(
    experiment: str,
    structure: Structure,
    records: Sequence[Record],
    others: Sequence[Record] = (),
    estimate: Collection[str] | None = None,
    values: Mapping[str, float] | None = None,
    free: Record | None = None,
    disturbance: Disturbance = "auto",
    machines: Sequence[FlownMachine] = (),
    prior: Mapping[str, tuple[float, float]] | None = None,
) -> tuple[Estimate | Repeated, list[Record]]:
    """Fit by output error; return the estimate and the records as fitted and validated (in closed loop in pieces).

    `machines` are those of the flights, one for each of `records` and then of `others`. In closed loop
    the cart is held at its calibration, and less certain figures are priors. A prior that is not asked for is held at
    its mean. In open loop the poles have priors; along the rail the gyro's bias and the dry friction have them,
    and what a calibration gives of the rotors is held. `prior`, by unknown, takes the place of these. `free` is the
    impulse's record of a doublet: its fit with the same structure fixes the poles, if running rotors leave the rig's
    stiffness as it is. Several `records` are repetitions, each fitted by itself.
    Raises IdentificationError as `fit` and `repeat`, and for flights in closed loop of different machines.
    """
    if len(records) > 1:
        check_repetitions([record.name for record in records])
    structure.check_names(prior or {})
    given, checked = {name: one for name, one in (values or {}).items() if name not in (prior or {})}, list(others)
    wanted = tuple(estimate) if estimate else None
    machines = machines or [FlownMachine()] * len(records)
    machine = machines[0]
    softens = load_rig(machine.rig)["softening"] > 0.0
    if free is not None and not softens:
        swing = fit(structure, free, values=given, disturbance=disturbance)
        held = {name: swing[name] for name in SWING if name in swing.labels and name not in (estimate or ())}
        given = {**held, **given}
        wanted = wanted or tuple(name for name in structure.estimate if name not in held)
    before: dict[str, tuple[float, float]] | None = None
    if experiment == "impulse" and structure.name == "free_response" and not wanted:
        # What the rotors do is not part of the free response.
        freed = [free_swing(one) for one in (*records, *checked)]
        records, checked = [one for one, _ in freed[: len(records)]], [one for one, _ in freed[len(records) :]]
        first = {f"{name}[{one.name}]": guess for one, guesses in freed for name, guess in guesses.items()}
        smooth = {} if load_rig(machine.rig)["coulomb_idle"] > 0.0 else {"coulomb": 0.0}
        given = {**machine.values(structure), **smooth, "tau": 0.0, **first, **given}
        wanted = tuple(name for name in SWUNG if name not in given)
    elif experiment == "impulse":
        wanted = wanted or tuple(name for name in released(structure) if name not in given)
    pieces: list[tuple[Record, ...]] = [(one,) for one in records]
    if experiment == "attitude":
        if len(set(machines)) > 1:
            raise IdentificationError(
                f"these flights are of different machines: {' and '.join(dict.fromkeys(one.text for one in machines))}",
                ", ".join(record.name for record in (*records, *others)),
                "give the flights of one machine",
            )
        # What a lost command did to the drone comes back in the next ones: each piece between gaps has its own start.
        pieces = [record.pieces() for record in records]
        if not all(pieces):
            raise IdentificationError(
                f"the moment is lost so often that no stretch of {SHORTEST_PIECE} samples is whole",
                ", ".join(record.name for record, whole in zip(records, pieces, strict=True) if not whole),
                "give another window, or another log",
            )
        known = machine.prior(structure)
        wanted = wanted or tuple(name for name in machine.estimate(structure) if name not in given)
        before = {name: one for name, one in known.items() if name in wanted and name not in given}
        # What is not asked for is held where it is known to be, not at the paper's drone.
        held = {name: mean for name, (mean, _) in {**structure.prior, **known}.items() if name not in wanted}
        noisy = "q_noise" in structure.unknowns and "coulomb" in known
        noise = {"q_noise": gyro_noise(records[0])} if noisy else {}
        given = {**held, **machine.values(structure), **noise, **given}
    elif experiment == "doublet":
        # Slow noise passes for a swing of the pendulum.
        least = {n: value for n, value in machine.values(structure).items() if n == "lag" and n not in (estimate or ())}
        wanted = tuple(name for name in wanted or structure.estimate if name not in least)
        given = {**least, **given}
        asked = set(POLES_PRIOR) & set(wanted) - set(given)
        before = {name: one for name, one in machine.prior(structure).items() if name in asked}
    elif experiment == "velocity":
        # From the on-board pitch to the on-board velocity, as in the paper, or from the gyro to the range sensor.
        output = "v" if "theta" in structure.inputs else "x"
        pieces, checked = [(only(one, output),) for one in records], [only(other, output) for other in checked]
        if output == "x":
            pieces = [tuple(only(part, output) for part in in_motion(one)) for one in records]
            calibrated, before = known_rail(load_rig(machine.rig).snapshot())
            given = {**{name: value for name, value in calibrated.items() if name in structure.unknowns}, **given}
            supplied = tuple({"supply"} & set(structure.unknowns)) if all(one.supply for one in machines) else ()
            wanted = wanted or (*(name for name in TRAVEL if name not in calibrated), *before, *supplied)
            before = {name: one for name, one in before.items() if name in wanted and name not in given}
            if machine.rig != _REAL:
                structure = _on_rail(structure, machine.rig)
            # Even a short flight, whose residual does not show it, has the gyro's walk in its pitch.
            disturbance = "walk" if disturbance == "auto" else disturbance
    if prior:  # what it speaks of is estimated
        before = {**(before or {}), **prior}
        wanted = tuple(dict.fromkeys((*(wanted or structure.estimate), *prior)))
        given = {name: one for name, one in given.items() if name not in prior}
    options: dict[str, Any] = {"estimate": wanted, "values": given, "disturbance": disturbance, "prior": before}
    # Repetitions in open loop are checked on each other.
    unseen = checked if experiment == "attitude" or len(records) == 1 else ()
    found = []
    for whole, flown in zip(pieces, machines, strict=False):
        # How much thrust the battery gave is of each flight.
        known = {"supply": flown.supply} if flown.supply and "supply" in (wanted or ()) else {}
        found.append(fit(structure, whole, validation=unseen, **{**options, "prior": {**known, **(before or {})}}))
    if free is not None and softens:
        said = (
            f"the poles of the impulse are not used: on the rig {machine.rig} running rotors make the pitch softer "
            "than it is at rest"
        )
        found = [replace(one, suggestions=(*one.suggestions, said)) for one in found]
    if len(found) > 1:
        fitted = list(records) if experiment == "attitude" else [one for piece in pieces for one in piece]
        return Repeated(tuple(record.name for record in records), tuple(found)), fitted
    return (_with_friction(found[0], pieces[0]) if experiment == "impulse" else found[0]), [*pieces[0], *checked]


def _with_friction(found: Estimate, records: Sequence[Record]) -> Estimate:
    """Return the fit of a free response, with a suggestion where dry friction explains it better."""
    if "coulomb" in found.labels or found.fixed.get("coulomb"):
        return found
    rubbing, given = free_response(), {}
    wanted = released(rubbing)
    if "coulomb" in found.fixed:
        given = {**found.fixed, **dict(zip(found.labels, found.values.tolist(), strict=True)), "coulomb": 0.1}
        wanted = (*found.labels, "coulomb")
    try:
        other = fit(rubbing, records, estimate=wanted, values=given, disturbance="white")
    except IdentificationError:
        return found
    before, after = (sum(one.rmse for one in both.identification) for both in (found, other))
    if not after < _FRICTION * before:
        return found
    remedy = "the structure free-response (--model free-response)"
    if "coulomb" in found.fixed:
        remedy = (
            "prior={'coulomb': (0.2, math.inf)} (--prior coulomb=0.2,inf), though the rig that the log names has none"
        )
    said = (
        f"dry friction explains the free response: the residual falls from {before:.2g} to {after:.2g} rad/s with "
        f"{remedy}"
    )
    return replace(found, suggestions=(*found.suggestions, said))
