"""Calibration of the `lab` rig on logs of real flights, and its FIT on flights that were left out.

One set of parameters fits all flights in the least-squares sense: logged against simulated estimates, each channel over
its own spread. The simulation is in closed loop and noise-free, over the windows of the logs' registry. A weak prior
holds the parameters that a single flight does not determine.

The figures of flights that were left out are not wholly blind. The gains of the drone's estimator
(`sim.drone_estimator.GAINS`) and the priors in `UNKNOWNS` were chosen on all seven logs. Each search starts from the
optimum with that flight.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from twodof.calibrate.gusts import gust_ceiling
from twodof.errors import IdentificationError
from twodof.flight.gains import NAMED
from twodof.flightlog.files import read_log
from twodof.flightlog.public_data import PUBLIC_LOGS
from twodof.identify.least_squares import LeastSquaresMinimum, minimise
from twodof.parameters import ParameterSet
from twodof.rig.parameters import CALIBRATED, TABLE, load_rig
from twodof.rig.rotors import lift
from twodof.signals import GRAVITY, HOVER
from twodof.sim.closed_loop import ClosedLoop
from twodof.sim.resimulation import LoggedFlight, resimulation_loop

_CHARGE_TOLERANCE = 1e-3
_CHARGE_STEP = 0.05
_BLOCK = 250  # samples: about a second, as misfits are coloured


@dataclass(frozen=True)
class ChargeEstimate:
    """The state of charge [0, 1] at the start of a flight's window, and its standard deviation.

    `at_bound` says that the estimate is 0 or 1: the flight had less or more thrust than the rig's battery allows, and
    the deviation is meaningless.
    """

    charge: float
    deviation: float
    at_bound: bool


def estimate_charge(flight: LoggedFlight, loop: ClosedLoop, rig: Mapping[str, float]) -> ChargeEstimate:
    """Return the charge with which the noise-free `rig` comes closest to the flight, each channel over its own spread.

    It uses the estimates *inside* the window, so the FIT with it is not a prediction. The rig's charge 1 is the mean of
    the flights that it was calibrated on. The deviation counts all misfits within a second as one (as `calibrate`).
    Raises IdentificationError if the charge leaves no trace in the flight.
    """
    from scipy.optimize import minimize_scalar  # imported late: most commands start without it

    spread = {name: float(np.linalg.norm(values - values.mean())) for name, values in flight.logged.items()}
    moving = [
        name for name in (("theta", "q", "x", "v") if flight.flown.rails else ("theta", "q")) if spread[name] > 0.0
    ]

    def misfit(charge: float) -> NDArray[np.float64]:
        simulated = flight.simulate(loop, rig, {"charge_start": charge})
        return np.concatenate([np.empty(0), *((flight.logged[n] - simulated[n]) / spread[n] for n in moving)])

    found = minimize_scalar(
        lambda charge: float(np.sum(misfit(charge) ** 2)),
        bounds=(0.0, 1.0),
        method="bounded",
        options={"xatol": _CHARGE_TOLERANCE},
    )
    charge = float(found.x)
    low, high = max(0.0, charge - _CHARGE_STEP), min(1.0, charge + _CHARGE_STEP)
    slope, residual = (misfit(high) - misfit(low)) / (high - low), misfit(charge)
    curvature = float(slope @ slope)
    if not curvature > 0.0:
        raise IdentificationError(
            "the charge leaves no trace in the flight", "charge", "give one with thrust, on a rig whose battery sags"
        )
    blocks = range(0, len(residual), _BLOCK)
    push = np.array([slope[k : k + _BLOCK] @ residual[k : k + _BLOCK] for k in blocks])
    at_bound = min(charge, 1.0 - charge) < 2.0 * _CHARGE_TOLERANCE
    return ChargeEstimate(round(charge, 4), float(np.sqrt(push @ push)) / curvature, at_bound)


Array = NDArray[np.float64]
CalibrationProgress = Callable[[str, float], None]
"""Function that is called with the present task and the share of the whole work done, in [0, 1]."""


FLIGHTS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "free-response-impulse": {"q": 1.0},
        # Weighs less: in open loop a wrong trim moment grows without bound.
        "doublet-0.03": {"q": 0.5},
        "attitude-steps-10deg-default": {"theta": 1.0, "q": 1.0},
        "attitude-steps-10deg-student": {"theta": 1.0, "q": 1.0},
        "rate-doublets-30dps-student": {"q": 1.0, "theta": 0.3},
        "velocity-doublets-0.25": {"v": 1.0, "theta": 1.0, "x": 0.5, "q": 0.5},
        "position-sweep-default": {"x": 1.0, "v": 1.0, "theta": 0.5, "q": 0.5},
    }
)
"""Weight of each channel's misfit in the public flights that are calibrated on, by the flights' names.

Their windows and gains are those of `flightlog.public_data`.
"""


@dataclass(frozen=True)
class CalibratedUnknown:
    """One unknown: prior mean and standard deviation, and bounds.

    Unknowns are ratios that a flight shows (accelerations for a command or an angle), not masses and lengths.
    """

    name: str
    mean: float
    deviation: float
    low: float
    high: float
    text: str


UNKNOWNS: tuple[CalibratedUnknown, ...] = (
    # Priors of b and a: linear fits of single flights give mu 288 +- 8 at T = .4 (1.87 b) and 112 to 118 at T = 0.
    CalibratedUnknown("b", 154.0, 4.0, 50.0, 400.0, "rad/s2 of pitch for a pair at full command"),
    CalibratedUnknown("a", 0.3, 0.05, 0.0, 0.9, "quadratic share of the thrust curve"),
    CalibratedUnknown("delay", 0.010, 0.003, 0.002, 0.03, "s, pure delay"),
    CalibratedUnknown("lag", 0.012, 0.004, 0.002, 0.05, "s, rotor lag"),
    # Prior of k: half swings after two flights of the cart and the pitch, motors off, give 8.4 +- .2 and 7.2 +- .4.
    CalibratedUnknown("k", 8.0, 0.6, 1.0, 30.0, "1/s2, stiffness, rotors at rest"),
    CalibratedUnknown("k_run", 6.0, 4.0, -10.0, 30.0, "1/s2, stiffness, rotors running"),
    CalibratedUnknown("k3", 4.0, 3.0, 0.0, 40.0, "1/s2 per rad2, hardening, rotors at rest"),
    CalibratedUnknown("c_idle", 0.2, 0.3, 0.0, 5.0, "1/s, viscous friction, rotors at rest"),
    CalibratedUnknown("f_idle", 0.3, 0.2, 0.0, 3.0, "rad/s2, Coulomb friction, rotors at rest"),
    CalibratedUnknown("c_run", 0.3, 0.3, 0.0, 5.0, "1/s, viscous friction, rotors running"),
    CalibratedUnknown("f_run", 0.1, 0.1, 0.0, 3.0, "rad/s2, Coulomb friction, rotors running"),
    # Prior: the range as the cart's answer to the logged pitch, without any estimator, gives 5.0 to 5.15.
    CalibratedUnknown("k_v", 5.05, 0.15, 3.0, 7.0, "m/s2 per rad"),
    CalibratedUnknown("p_v", 0.7, 0.4, 0.0, 3.0, "1/s, linear friction of the rail"),
    CalibratedUnknown("f_v", 0.06, 0.04, 0.0, 0.5, "m/s2, Coulomb friction of the rail"),
    CalibratedUnknown("trim_start", -0.4, 0.5, -6.0, 6.0, "rad/s2, the rotors' trim before their wake stands"),
    CalibratedUnknown("wake_lag", 1.0, 0.7, 0.1, 5.0, "s"),
    CalibratedUnknown("wake_fade", 5.0, 5.0, 0.0, 100.0, "1/rad, how soon the wake fades with the pitch"),
    # Prior: the range against the twice integrated accelerometer, flight by flight, gives 20 to 37 ms.
    CalibratedUnknown("tof_age", 0.03, 0.01, 0.0, 0.1, "s, age of a range sample"),
    # Prior: acc_x of the five flights with rings, from 1 to 6 Hz, against the pitch and the turning: 9 to 12 mm.
    CalibratedUnknown("imu_below", 0.011, 0.001, -0.1, 0.1, "m"),
)

PRIOR_WEIGHT = 0.02
"""Misfit, as a share of a channel's spread, that weighs as much as one standard deviation from a prior."""

_DIFFERENCE = 0.05  # of a prior's standard deviation: above the steps that sticking makes in the misfit
_TOLERANCE = 1e-5
_ITERATIONS = 30


def to_rig(unknowns: Mapping[str, float]) -> dict[str, float]:
    """Convert values of `UNKNOWNS`, by name, to rig parameters, with the masses and the arm of the built-in table."""
    built = {row.name: row.default for row in TABLE}
    mass = built["mass_drone"] + built["mass_cart"]
    u = unknowns
    pair_thrust = u["k_v"] * mass / (2.0 * lift(HOVER, u["a"]))
    inertia = built["arm"] * pair_thrust / u["b"]
    return {
        "pair_thrust": pair_thrust,
        "curve": u["a"],
        "inertia": inertia,
        "delay": u["delay"],
        "lag": u["lag"],
        "offset": u["k"] * inertia / (built["mass_drone"] * GRAVITY),
        "softening": (u["k"] - u["k_run"]) * inertia,
        "hardening": u["k3"] * inertia,
        "viscous_idle": u["c_idle"] * inertia,
        "coulomb_idle": u["f_idle"] * inertia,
        "viscous_run": u["c_run"] * inertia,
        "coulomb_run": u["f_run"] * inertia,
        "rail_viscous": u["p_v"] * mass,
        "rail_coulomb": u["f_v"] * mass,
        "trim_start": u["trim_start"] * inertia,
        "wake_lag": u["wake_lag"],
        "wake_fade": u["wake_fade"],
        "tof_age": u["tof_age"],
        "imu_below": u["imu_below"],
    }


@dataclass(frozen=True)
class Calibration:
    """Result of a calibration.

    `rig` is the calibrated set of parameters. `estimate` and `deviation` are the unknowns and their standard deviations
    (robust to misfits that are coloured over a second, as turbulence is). `fit[flight][channel]` is the FIT [%] of
    `rig` on all flights, `left_out[flight][channel]` [%] that on each flight of a set calibrated on the others.
    `ceiling[flight][channel]` [%] is the FIT that the gusts of `rig` allow (`gust_ceiling`). The last two are empty
    without `leave_one_out`. `converged` says that no further step promised a relative decrease of the misfit by 1e-5.
    """

    rig: ParameterSet
    estimate: Mapping[str, float]
    deviation: Mapping[str, float]
    fit: Mapping[str, Mapping[str, float]]
    left_out: Mapping[str, Mapping[str, float]]
    ceiling: Mapping[str, Mapping[str, float]]
    cost: float
    converged: bool


def find_flights(folder: str | Path, flights: Iterable[str] = FLIGHTS) -> dict[str, LoggedFlight]:
    """Read the logs of the `flights` in `folder`. Raises LogError if one is missing or broken."""
    logs = {name: PUBLIC_LOGS[name] for name in flights}
    return {
        name: LoggedFlight(read_log(Path(folder) / f"{name}.mat"), NAMED[log.gains], log.window)
        for name, log in logs.items()
    }


def calibrate(
    folder: str | Path,
    leave_one_out: bool = False,
    progress: CalibrationProgress | None = None,
    flights: Iterable[str] = FLIGHTS,
) -> Calibration:
    """Calibrate the `lab` rig on the logs in `folder` and, if `leave_one_out`, also on all flights but each one.

    `progress` is called often; an exception from it ends the calibration. Raises LogError for a missing or broken log,
    IdentificationError without a flight.
    """
    logged = find_flights(folder, flights)
    if not logged:
        raise IdentificationError("no flight to calibrate on", "calibrate", "name at least one")
    loop = resimulation_loop()
    start = np.array([u.mean for u in UNKNOWNS])
    runs = 1 + (len(logged) if leave_one_out and len(logged) > 1 else 0)

    def solve(
        run: int, what: str, on: Mapping[str, LoggedFlight], start: Array
    ) -> tuple[Array, Array, LeastSquaresMinimum]:
        """Run the minimisation number `run`, and report the progress of all by its iterations."""

        def tell(part: float) -> None:
            if progress is not None:
                progress(what, min(1.0, (run + part) / runs))

        tell(0.0)
        return _solve(loop, on, start, tell)

    x, deviation, best = solve(0, "all flights", logged, start)
    rig = to_rig(_named(x))
    left_out: dict[str, Mapping[str, float]] = {}
    for run, flight in enumerate(list(logged)[: runs - 1], 1):
        others = {name: data for name, data in logged.items() if name != flight}
        without = solve(run, f"without {flight}", others, x)[0]
        left_out[flight] = logged[flight].compare(loop, _whole(to_rig(_named(without)))).fit
    if progress is not None:
        progress("compare", 1.0)
    values = ParameterSet(rig | _untouched(), TABLE)
    ceiling = {name: gust_ceiling(data, loop, values) for name, data in logged.items()} if left_out else {}
    return Calibration(
        rig=values,
        estimate=MappingProxyType(_named(x)),
        deviation=MappingProxyType(_named(deviation)),
        fit={name: data.compare(loop, values).fit for name, data in logged.items()},
        left_out=left_out,
        ceiling=ceiling,
        cost=best.cost,
        converged=best.iterations < _ITERATIONS,
    )


def _named(x: Array) -> dict[str, float]:
    return {u.name: float(value) for u, value in zip(UNKNOWNS, x, strict=True)}


@cache
def _untouched() -> dict[str, float]:
    """Return the parameters of the shipped `lab` set that are not calibrated: gusts, vibration, battery."""
    lab = load_rig("lab")
    default = ParameterSet(table=TABLE)
    return {name: lab[name] for name in lab if name not in CALIBRATED and lab[name] != default[name]}


def _whole(rig: dict[str, float]) -> dict[str, float]:
    return ParameterSet(rig | _untouched(), TABLE).snapshot()


def _solve(
    loop: ClosedLoop, logged: Mapping[str, LoggedFlight], start: Array, tell: Callable[[float], None]
) -> tuple[Array, Array, LeastSquaresMinimum]:
    """Return estimate, deviation and search by least squares; `tell` is given the share that is done.

    The unknowns are in units of the priors' standard deviations.
    """
    mean = np.array([u.mean for u in UNKNOWNS])
    unit = np.array([u.deviation for u in UNKNOWNS])
    spread = {
        (flight, name): float(np.linalg.norm(data.logged[name] - data.logged[name].mean()))
        for flight, data in logged.items()
        for name in FLIGHTS[flight]
    }
    calls = 0
    expected = 12 * (len(UNKNOWNS) + 2)

    def residual(z: Array) -> Array:
        nonlocal calls
        calls += 1
        tell(calls / (calls + expected))
        rig = _whole(to_rig(_named(mean + unit * z)))
        parts = [PRIOR_WEIGHT * z]
        for flight, data in logged.items():
            simulated = data.simulate(loop, rig)
            parts += [
                weight / spread[flight, name] * (data.logged[name] - simulated[name])
                for name, weight in FLIGHTS[flight].items()
            ]
        return np.concatenate(parts)

    def jacobian(z: Array, r: Array) -> Array:
        columns = [(residual(z + _DIFFERENCE * e) - r) / _DIFFERENCE for e in np.eye(len(z))]
        return np.stack(columns, axis=1)

    low = np.array([(u.low - u.mean) / u.deviation for u in UNKNOWNS])
    high = np.array([(u.high - u.mean) / u.deviation for u in UNKNOWNS]) - 2.0 * _DIFFERENCE
    found = minimise(residual, jacobian, (start - mean) / unit, low, high, tolerance=_TOLERANCE, iterations=_ITERATIONS)
    jac = jacobian(found.x, found.residual)
    deviation = unit * np.sqrt(np.diag(_covariance(jac, found.residual, len(UNKNOWNS))))
    return mean + unit * found.x, deviation, found


def _covariance(jac: Array, residual: Array, priors: int) -> Array:
    """Return the unknowns' covariance from the Jacobian (n, k) and the residual (n,), whose first rows are the priors.

    The sandwich estimator with the misfits of each block of samples taken as one (Newey and West, Econometrica 55-3,
    1987, with blocks in place of lags).
    """
    curvature = np.linalg.inv(jac.T @ jac)
    middle = jac[:priors].T @ jac[:priors] * PRIOR_WEIGHT**2
    for first in range(priors, len(residual), _BLOCK):
        push = jac[first : first + _BLOCK].T @ residual[first : first + _BLOCK]
        middle += np.outer(push, push)
    return np.asarray(curvature @ middle @ curvature)
