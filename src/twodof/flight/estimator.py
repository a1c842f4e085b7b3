"""Estimator: pitch, pitch rate, position and velocity from the IMU at 250 Hz and the time-of-flight sensor."""

from typing import Any

from twodof.blocks import Block, Diagram, Port, State, int32, where
from twodof.blocks.elementary.functions import atan2, cos, sin
from twodof.errors import ParameterError
from twodof.flight.declarations import IMU, RANGE, add_inputs, ports, restarted, tunables
from twodof.flight.separate_filters import FixedGainPosition, KalmanPosition, PitchFilter, RailAcceleration
from twodof.signals import RAIL_CENTRE

STATES = ("theta", "bias", "x", "v")
PAIRS = tuple((a, b) for i, a in enumerate(STATES) for b in STATES[i:])
COVARIANCE = tuple(f"P_{a}_{b}" for a, b in PAIRS)
"""Names of the covariance's upper triangle, by rows."""

Matrix = dict[tuple[str, str], Any]


class LongitudinalFilter(Block):
    """theta, gyro bias b, x and v by an extended Kalman filter.

    Prediction, with noise of gyro, bias and acceleration: theta' = gyro_y - b, b' = 0, x' = v,
    v' = cos(theta) f_x + sin(theta) f_z. A range sample, s = `dist_age` seconds old, measures
    x - v s + v' s^2 / 2, where the cart was then. A tilt error d makes a false acceleration g d, so the range corrects
    the tilt within seconds, and the cart's own acceleration is not taken for tilt. A weak measurement 0 = v' + noise
    bounds the pitch error while the range sensor is silent. The first sample sets theta = atan2(f_x, -f_z).

    After a sample that makes a state NaN or implausible, it restarts with the next one (`declarations.restarted`).

    With the defaults theta, x and v come closest to the drone's own estimates on its logs. They assume four times the
    range's real noise of 4 mm.
    """

    inputs = ports(*IMU, *RANGE)
    outputs = (*ports("theta", "q"), Port("bias", unit="rad/s"), *ports("x", "v"), *(Port(name) for name in COVARIANCE))
    states = (
        State("theta", unit="rad"),
        State("bias", unit="rad/s"),
        State("x", unit="m"),
        State("v", unit="m/s"),
        *(State(name, f"{name}_0" if a == b else 0.0) for name, (a, b) in zip(COVARIANCE, PAIRS, strict=True)),
        State("started", False, "bool"),
    )
    derived = (
        *(Port(f"P_{name}_{name}_0") for name in STATES),
        *(Port(name) for name in ("gyro_q", "walk_q", "q_xx", "q_xv", "q_vv", "gravity_r", "range_r")),
    )
    params = tunables("estimator.filter")

    def prepare(self, p: Any, t: Any) -> Any:
        density = p.sigma_a * p.sigma_a
        first = {f"P_{n}_{n}_0": p[f"sigma_{n}_0"] * p[f"sigma_{n}_0"] for n in STATES}
        return first | {
            "gyro_q": p.sigma_gyro * p.sigma_gyro * t.dt,
            "walk_q": p.sigma_walk * p.sigma_walk * t.dt,
            "q_xx": density * t.dt * t.dt * t.dt * (1.0 / 3.0),
            "q_xv": density * t.dt * t.dt * 0.5,
            "q_vv": density * t.dt,
            "gravity_r": p.sigma_gravity * p.sigma_gravity,
            "range_r": p.sigma_range * p.sigma_range,
        }

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        s = {"theta": where(x.started, x.theta + (u.gyro_y - x.bias) * t.dt, atan2(u.acc_x, -u.acc_z)), "bias": x.bias}
        acceleration = cos(s["theta"]) * u.acc_x + sin(s["theta"]) * u.acc_z
        slope = cos(s["theta"]) * u.acc_z - sin(s["theta"]) * u.acc_x  # of the acceleration by theta, about -g
        s["x"] = x.x + where(x.started, (x.v + 0.5 * t.dt * acceleration) * t.dt, 0.0)
        s["v"] = x.v + where(x.started, acceleration * t.dt, 0.0)
        before = {pair: x[name] for pair, name in zip(PAIRS, COVARIANCE, strict=True)}
        after = self._predicted(before, slope, p, t)
        cov = {pair: where(x.started, after[pair], before[pair]) for pair in PAIRS}

        s, cov = _measured(s, cov, {"theta": slope}, -acceleration, p.gravity_r, x.started)
        age = u.dist_age
        half = 0.5 * age * age
        innovation = (u.dist - RAIL_CENTRE) - (s["x"] - s["v"] * age + acceleration * half)
        row = {"theta": slope * half, "x": 1.0, "v": -age}
        s, cov = _measured(s, cov, row, innovation, p.range_r, u.dist_new)
        return s | {"q": u.gyro_y - s["bias"]} | {name: cov[pair] for name, pair in zip(COVARIANCE, PAIRS, strict=True)}

    def _predicted(self, cov: Matrix, slope: Any, p: Any, t: Any) -> Matrix:
        """F P F' + Q."""
        step = {
            ("theta", "theta"): 1.0,
            ("theta", "bias"): -t.dt,
            ("bias", "bias"): 1.0,
            ("x", "theta"): slope * (0.5 * t.dt * t.dt),
            ("x", "x"): 1.0,
            ("x", "v"): t.dt,
            ("v", "theta"): slope * t.dt,
            ("v", "v"): 1.0,
        }
        noise = {
            ("theta", "theta"): p.gyro_q,
            ("bias", "bias"): p.walk_q,
            ("x", "x"): p.q_xx,
            ("x", "v"): p.q_xv,
            ("v", "v"): p.q_vv,
        }
        half = {
            (a, c): _total([(step[a, b], _at(cov, b, c)) for b in STATES if (a, b) in step])
            for a in STATES
            for c in STATES
        }
        new = {}
        for a, b in PAIRS:
            spread = _total([(step[b, c], half[a, c]) for c in STATES if (b, c) in step])
            new[a, b] = spread + noise[a, b] if (a, b) in noise else spread
        return new

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        new = self.output(u, x, p, t)
        new = {name: value for name, value in new.items() if name != "q"} | {"started": True}
        first = {f"P_{n}_{n}": p[f"P_{n}_{n}_0"] for n in STATES}
        return restarted(new, first | {"started": False})


def _at(cov: Matrix, a: str, b: str) -> Any:
    return cov[a, b] if (a, b) in cov else cov[b, a]


def _product(a: Any, b: Any) -> Any:
    return b if isinstance(a, float) and a == 1.0 else a * b


def _total(products: list[tuple[Any, Any]]) -> Any:
    first, *others = (_product(a, b) for a, b in products)
    for term in others:
        first = first + term
    return first


def _measured(
    s: dict[str, Any], cov: Matrix, row: dict[str, Any], innovation: Any, r: Any, use: Any
) -> tuple[dict[str, Any], Matrix]:
    """State and covariance after one scalar measurement with derivative `row` and variance `r`, where `use`."""
    spread = {a: _total([(slope, _at(cov, a, b)) for b, slope in row.items()]) for a in STATES}
    variance = _total([(slope, spread[b]) for b, slope in row.items()]) + r
    gain = {a: where(use, spread[a] / variance, 0.0) for a in STATES}
    e = where(use, innovation, 0.0)
    state = {a: s[a] + gain[a] * e for a in STATES}
    return state, {(a, b): cov[a, b] - gain[a] * spread[b] for a, b in PAIRS}


POSITION_FILTERS = ("joint", "fixed-gain", "kalman")


class Publisher(Block):
    """Position and velocity as published at 100 Hz: every second or third of the 250 Hz samples in turn.

    A value published at a sample is at the output from the next sample on.
    """

    inputs = outputs = ports("x", "v")
    states = (State("x", unit="m"), State("v", unit="m/s"), State("phase", 0, "int32"))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"x": x.x, "v": x.v}

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        # 100 / 250 = 2 / 5: an accumulator that overflows twice in five samples.
        phase = x.phase + int32(2)
        due = phase >= int32(5)
        return {"x": where(due, u.x, x.x), "v": where(due, u.v, x.v), "phase": where(due, phase - int32(5), phase)}


def estimator(position_filter: str = "joint") -> Diagram:
    """Return the diagram of the estimator, made for 250 Hz.

    `position_filter` "joint" is one extended Kalman filter for pitch and position, which comes closest to the drone's
    own estimates. The position filters "fixed-gain" and "kalman" take the pitch from a separate pitch filter.
    Inputs: `acc_x`, `acc_z` [m/s2] (specific force, body axes forward-right-down), `gyro_y` [rad/s] and `dist` [m].
    `dist_new` (bool) is true in the tick in which a range sample arrives; `dist_age` [s] is its age then. Outputs:
    `theta` [rad], `q` [rad/s], `x` [m], `v` [m/s]. `x_published` and `v_published` are held at 100 Hz. Raises
    ParameterError for another filter.
    """
    if position_filter not in POSITION_FILTERS:
        raise ParameterError(
            f"no filter called {position_filter!r:.80}", "position_filter", f"use one of {', '.join(POSITION_FILTERS)}"
        )
    d = Diagram("estimator", "pitch by an extended Kalman filter, position by the filter chosen")
    add_inputs(d, *IMU, "dist", "dist_age", "dist_new")
    if position_filter == "joint":
        d.add("filter", LongitudinalFilter())
        for name in d.inputs:
            d.connect(name, f"filter.{name}")
        pitch = position = "filter"
    else:
        pitch, position = _separate(d, position_filter)
    d.add("publisher", Publisher(), x=f"{position}.x", v=f"{position}.v")
    d.output("theta", f"{pitch}.theta")
    d.output("q", f"{pitch}.q")
    d.output("x", f"{position}.x")
    d.output("v", f"{position}.v")
    d.output("x_published", "publisher.x")
    d.output("v_published", "publisher.v")
    return d


def _separate(d: Diagram, position_filter: str) -> tuple[str, str]:
    """Add the pitch filter and, fed with its pitch, a position filter; return their names."""
    d.add("pitch", PitchFilter(), acc_x="acc_x", acc_z="acc_z", gyro_y="gyro_y")
    d.add("rail", RailAcceleration(), acc_x="acc_x", acc_z="acc_z", theta="pitch.theta")
    position = KalmanPosition() if position_filter == "kalman" else FixedGainPosition()
    sources = {"acceleration": "rail.acceleration"} | {name: name for name in RANGE}
    d.add("position", position, inputs=sources)
    return "pitch", "position"
