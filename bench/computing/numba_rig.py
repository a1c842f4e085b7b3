"""The rig as a loop in numba, written as one writes such a loop: the peer of the compiled rig.

The equations, rates and noise amounts are those of `twodof.rig`, with a sequential noise generator. Needs numba.
"""

from __future__ import annotations

import math
from collections import namedtuple
from collections.abc import Mapping
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

TICK, SAMPLE, BATTERY = 0.001, 0.004, 0.04
GRAVITY, HOVER, RAIL_CENTRE = 9.81, 0.4, 0.5
COMMANDS, PLACES = 64, 32
STILL, SLOW_PITCH, SLOW_CART = 1e-9, 0.02, 0.005
TURN = 4294967296.0

Array = NDArray[np.float64]

OUTPUTS = ("acc_x", "acc_z", "gyro_y", "dist", "dist_new", "dist_age", "theta", "q", "x", "v", "load", "voltage")
OUTPUTS = (*OUTPUTS, "charge")
ACC_X, ACC_Z, GYRO_Y, DIST, DIST_NEW, DIST_AGE, THETA, Q, X, V, LOAD, VOLTAGE, CHARGE = range(len(OUTPUTS))

MEMORY = ("theta", "q", "x", "v", "sine", "cosine", "fore", "aft", "wake", "gust", "gust_moment", "charge")
MEMORY = (*MEMORY, "battery_load", "supply", "imu_q", "imu_v")
"""What the loop keeps, in this order, in an array. Vibrations, rings and counters have arrays of their own."""

rig_function = njit(error_model="numpy", fastmath=False)
"""Division by zero as in C; no rounding is changed."""


@rig_function
def thrust_of(p: Any, supply: float, wake_moment: float, fore: float, aft: float) -> tuple[float, ...]:
    up_fore = fore * (1.0 - p.curve + p.curve * fore) * supply
    up_aft = aft * (1.0 - p.curve + p.curve * aft) * supply
    total = up_fore + up_aft
    load = total * p.per_hover
    moment = p.arm * p.pair_thrust * (up_fore - up_aft) + p.trim_start * load + wake_moment
    return p.pair_thrust * total, moment, min((fore + aft) * (0.5 / HOVER), 1.0), load


@rig_function
def holds(speed: float, load: float, friction: float, place: float, low: float, high: float) -> bool:
    if speed != 0.0:
        return False
    return abs(load) <= friction or (place >= high and load > 0.0) or (place <= low and load < 0.0)


@rig_function
def rates(
    p: Any,
    supply: float,
    wake_moment: float,
    gust: float,
    to_fore: float,
    to_aft: float,
    theta: float,
    q: float,
    x: float,
    v: float,
    sine: float,
    cosine: float,
    fore: float,
    aft: float,
) -> tuple[float, ...]:
    if p.direct:
        thrust, moment, running, _ = thrust_of(p, supply, wake_moment, to_fore, to_aft)
    else:
        thrust, moment, running, _ = thrust_of(p, supply, wake_moment, fore, aft)
    viscous = p.viscous_idle + (p.viscous_run - p.viscous_idle) * running
    coulomb = p.coulomb_idle + (p.coulomb_run - p.coulomb_idle) * running
    cable = (1.0 - running) * (p.hardening * theta * theta)
    spring = theta * (p.spring - p.softening * running + cable)
    torque = moment + gust - p.weight * sine - spring - viscous * q
    force = (p.offset_mass * q * q - thrust) * sine + p.rail_force - p.rail_viscous * v
    coupling, alone = p.offset_mass * cosine, torque * p.per_inertia
    stuck = holds(q, torque, coulomb, theta, -p.pitch_stop, p.pitch_stop)
    locked = holds(v, force if stuck else force - coupling * alone, p.rail_coulomb, x, p.low, p.high)
    cart = 0.0 if locked else force * p.per_mass
    if holds(q, torque - coupling * cart, coulomb, theta, -p.pitch_stop, p.pitch_stop):
        q_rate, v_rate = 0.0, cart
    elif locked:
        q_rate, v_rate = alone, 0.0
    else:
        per_determinant = 1.0 / (p.inertia_mass - coupling * coupling)
        q_rate = (p.mass * torque - coupling * force) * per_determinant
        v_rate = (p.inertia * force - coupling * torque) * per_determinant
    lag = p.per_lag
    return q, q_rate, v, v_rate, cosine * q, -sine * q, (to_fore - fore) * lag, (to_aft - aft) * lag


@rig_function
def rubbed(place: float, speed: float, loss: float) -> tuple[float, float]:
    lost = max(-loss, min(loss, speed))
    return place - TICK / 2 * lost, speed - lost


@rig_function
def bounced(
    place: float, speed: float, low: float, high: float, restitution: float, rest: float
) -> tuple[float, float]:
    if place > high and speed > 0.0:
        stop = high
    elif place < low and speed < 0.0:
        stop = low
    else:
        return place, speed
    back = -restitution * speed
    return (stop, 0.0) if abs(back) < rest else (stop - restitution * (place - stop), back)


@rig_function
def rounded(value: float, grain: float) -> float:
    return math.floor(value / grain + 0.5) * grain if grain > 0.0 else value


@rig_function
def shaken(p: Any, memory: Any, fresh: float) -> float:
    """A band of noise; `memory` is w1, w2, y1, y2."""
    late = memory[2]
    made = p.vibration_gain * (fresh - memory[1]) + p.vibration_turn * late - p.vibration_r2 * memory[3]
    memory[1], memory[0], memory[3], memory[2] = memory[0], fresh, late, made
    return late


@rig_function
def place_ago(p: Any, back: int, x: float, counts: NDArray[np.int64], places: Array) -> float:
    if back < 1:
        return x
    return places[(counts[2] - back) & (PLACES - 1)] if back <= counts[3] else p.x_start


@rig_function
def run_rig(
    p: Any,
    rng: np.random.Generator,
    memory: Any,
    shakes: Array,
    rings: Array,
    places: Array,
    counts: NDArray[np.int64],
    ask_fore: float,
    ask_aft: float,
    y: Array,
    stride: int,
    ticks: int,
) -> tuple[float, ...]:
    """`ticks` ticks of 1 ms; a `stride` of 0 writes all outputs to the first row of `y`."""
    theta, q, x, v, sine, cosine, fore, aft, wake, gust, gust_moment, charge, battery_load, supply, imu_q, imu_v = (
        memory
    )
    for k in range(ticks):
        out = y[k * stride]
        if stride:  # what is not new stays; the last row has what was before the first
            out[:] = y[k - 1]
        tick = counts[0]
        if tick % 40 == 0:
            current = p.hover_current * battery_load * math.sqrt(battery_load)
            full = p.voltage_empty + (p.voltage_full - p.voltage_empty) * charge
            voltage = max(full - p.resistance * current, 0.0)
            supply = (voltage * p.per_reference) ** 2
            out[VOLTAGE], out[CHARGE] = voltage, charge
            charge = min(max(charge - current * p.per_capacity * BATTERY, 0.0), 1.0)
        late, early = (counts[1] - p.whole) & (COMMANDS - 1), (counts[1] - p.whole - 1) & (COMMANDS - 1)
        to_fore = rings[0, late] + p.fraction * (rings[0, early] - rings[0, late])
        to_aft = rings[1, late] + p.fraction * (rings[1, early] - rings[1, late])
        wake_moment = (p.trim - p.trim_start) * wake
        if p.direct:
            _, _, running, load = thrust_of(p, supply, wake_moment, to_fore, to_aft)
        else:
            _, _, running, load = thrust_of(p, supply, wake_moment, fore, aft)
        if tick % 40 == 0:
            battery_load = max(load, 0.0)
        if tick % 4 == 0:
            along, turning = (v - imu_v) / SAMPLE, (q - imu_q) / SAMPLE
            n_x, n_z, n_q = rng.standard_normal(), rng.standard_normal(), rng.standard_normal()
            e_x = p.acc_x_idle * n_x + p.acc_x_hover * load * shaken(p, shakes[0], n_x)
            e_z = p.acc_z_idle * n_z + p.acc_z_hover * load * shaken(p, shakes[1], n_z)
            e_q = p.gyro_idle * n_q + p.gyro_hover * load * shaken(p, shakes[2], n_q)
            acc_x = p.acc_scale * (cosine * along + GRAVITY * sine + p.imu_below * turning) + p.acc_bias
            acc_z = sine * along - GRAVITY * cosine - p.imu_below * q * q
            out[ACC_X] = rounded(acc_x + p.noise * e_x, p.acc_grain)
            out[ACC_Z] = rounded(acc_z + p.noise * e_z, p.acc_grain)
            out[GYRO_Y] = rounded(p.gyro_scale * q + p.gyro_bias + p.noise * e_q, p.gyro_grain)
            imu_q, imu_v = q, v
            n = rng.standard_normal()
            phase = (counts[4] + p.advance) & 0xFFFFFFFF
            new = phase < counts[4]
            counts[4] = phase
            out[DIST_NEW], out[DIST_AGE] = 1.0 if new else 0.0, p.tof_stamp
            if new:
                young, old = place_ago(p, p.back, x, counts, places), place_ago(p, p.back + 1, x, counts, places)
                far = young + p.tof_fraction * (old - young) + RAIL_CENTRE + p.tof_bias
                out[DIST] = rounded(far + p.noise * p.tof_noise * n, p.tof_grain)
            places[counts[2]] = x
            counts[2] = (counts[2] + 1) & (PLACES - 1)
            counts[3] = min(counts[3] + 1, PLACES)
            gust_moment = p.noise * p.gust * load * gust
            gust = p.gust_keep * gust + p.gust_fresh * rng.standard_normal()
        out[THETA], out[Q], out[X], out[V], out[LOAD] = theta, q, x, v, load

        g = gust_moment
        s, w, a, b = supply, wake_moment, to_fore, to_aft
        h, i, j, m, n1, o, r, z = rates(p, s, w, g, a, b, theta, q, x, v, sine, cosine, fore, aft)
        d = TICK / 2
        h2, i2, j2, m2, n2, o2, r2, z2 = rates(
            p, s, w, g, a, b, theta + d * h, q + d * i, x + d * j, v + d * m,
            sine + d * n1, cosine + d * o, fore + d * r, aft + d * z,
        )  # fmt: skip
        h3, i3, j3, m3, n3, o3, r3, z3 = rates(
            p, s, w, g, a, b, theta + d * h2, q + d * i2, x + d * j2, v + d * m2,
            sine + d * n2, cosine + d * o2, fore + d * r2, aft + d * z2,
        )  # fmt: skip
        h4, i4, j4, m4, _, _, r4, z4 = rates(
            p, s, w, g, a, b, theta + TICK * h3, q + TICK * i3, x + TICK * j3, v + TICK * m3,
            sine + TICK * n3, cosine + TICK * o3, fore + TICK * r3, aft + TICK * z3,
        )  # fmt: skip
        c = TICK / 6
        theta, q = theta + c * (h + 2 * h2 + 2 * h3 + h4), q + c * (i + 2 * i2 + 2 * i3 + i4)
        x, v = x + c * (j + 2 * j2 + 2 * j3 + j4), v + c * (m + 2 * m2 + 2 * m3 + m4)
        fore, aft = fore + c * (r + 2 * r2 + 2 * r3 + r4), aft + c * (z + 2 * z2 + 2 * z3 + z4)

        q_free, v_free = q, v
        coulomb = p.coulomb_idle + (p.coulomb_run - p.coulomb_idle) * running
        x, v = rubbed(x, v, p.rail_coulomb * p.per_mass * TICK)
        slid = v
        x, v = bounced(x, v, p.low, p.high, p.bounce, SLOW_CART)
        theta, q = rubbed(theta, q, coulomb * p.per_inertia * TICK)
        turned = q
        theta, q = bounced(theta, q, -p.pitch_stop, p.pitch_stop, p.pitch_bounce, SLOW_PITCH)
        sine, cosine = math.sin(theta), math.cos(theta)
        coupling, speed, turning = p.offset_mass * cosine, v, q
        q -= coupling * p.per_inertia * (speed - (slid if turning == 0.0 else v_free))
        v -= coupling * p.per_mass * (turning - (turned if speed == 0.0 else q_free))
        fore, aft = 0.0 if fore < STILL else fore, 0.0 if aft < STILL else aft
        slant = p.wake_fade * out[THETA]
        wake += p.wake_step * (load / (1.0 + slant * slant) - wake)
        wake = 0.0 if wake < STILL else wake
        rings[0, counts[1]], rings[1, counts[1]] = min(max(ask_fore, 0.0), 1.0), min(max(ask_aft, 0.0), 1.0)
        counts[1] = (counts[1] + 1) & (COMMANDS - 1)
        counts[0] += 1
    return theta, q, x, v, sine, cosine, fore, aft, wake, gust, gust_moment, charge, battery_load, supply, imu_q, imu_v


def derived(p: Mapping[str, Any]) -> dict[str, Any]:
    """Compute the derived parameters."""
    mass, offset_mass = p["mass_drone"] + p["mass_cart"], p["mass_drone"] * p["offset"]
    ticks, samples = max(p["delay"] / TICK, 1.0), p["tof_age"] / SAMPLE
    keep, noisy = math.exp(-SAMPLE / p["gust_time"]), p["noise"] > 0.0
    low, high = p["ring_place"] - p["ring_play"], p["ring_place"] + p["ring_play"]
    direct = p["lag"] < TICK / 2
    return {
        "mass": mass,
        "offset_mass": offset_mass,
        "weight": offset_mass * GRAVITY,
        "per_inertia": 1.0 / p["inertia"],
        "per_mass": 1.0 / mass,
        "inertia_mass": p["inertia"] * mass,
        "low": low if p["rings"] else -p["rail_stop"],
        "high": high if p["rings"] else p["rail_stop"],
        "bounce": 0.0 if p["rings"] else p["rail_bounce"],
        "whole": int(ticks),
        "fraction": ticks - int(ticks),
        "direct": direct,
        "per_lag": 0.0 if direct else 1.0 / p["lag"],
        "wake_step": TICK / p["wake_lag"],
        "per_hover": 0.5 / (HOVER * (1.0 - p["curve"] + p["curve"] * HOVER)),
        "per_capacity": 1.0 / (3600.0 * p["capacity"]),
        "per_reference": 1.0 / (p["voltage_full"] - p["resistance"] * p["hover_current"]),
        "gust_keep": keep,
        "gust_fresh": math.sqrt(1.0 - keep * keep),
        "vibration_gain": math.sqrt(0.5 * (1.0 - p["vibration_r2"])),
        "vibration_turn": (1.0 + p["vibration_r2"]) * math.cos(math.tau * p["vibration_hz"] * SAMPLE),
        "acc_grain": p["acc_step"] if noisy else 0.0,
        "gyro_grain": p["gyro_step"] if noisy else 0.0,
        "tof_grain": p["tof_step"] if noisy else 0.0,
        "advance": int(p["tof_rate"] * SAMPLE * TURN),
        "back": int(samples),
        "tof_fraction": samples - int(samples),
    }


class NumbaRig:
    """One rig with these parameters, by their plain names."""

    def __init__(self, parameters: Mapping[str, Any], seed: int = 1) -> None:
        values = {**parameters, **derived(parameters)}
        self._constants = namedtuple("Constants", values)(**values)  # type: ignore[misc]  # numba reads its fields
        self._rng = np.random.default_rng(seed)
        theta = parameters["theta_start"]
        start = {name: parameters.get(f"{name}_start", 0.0) for name in MEMORY}
        start |= {"sine": math.sin(theta), "cosine": math.cos(theta)}
        start |= {"imu_q": parameters["q_start"], "imu_v": parameters["v_start"]}
        self._memory = tuple(float(start[name]) for name in MEMORY)
        self._shakes, self._rings, self._places = np.zeros((3, 4)), np.zeros((2, COMMANDS)), np.zeros(PLACES)
        self._counts = np.zeros(5, np.int64)  # tick, place in the rings, place of the range, places filled, phase
        self._counts[4] = int(parameters["tof_phase"] * TURN)
        self._last = np.zeros((1, len(OUTPUTS)))
        self._last[0, DIST] = parameters["x_start"] + RAIL_CENTRE

    def run(self, ticks: int, fore: float, aft: float) -> dict[str, NDArray[Any]]:
        """All outputs of `ticks` ticks, (ticks,) each."""
        y = np.zeros((ticks, len(OUTPUTS)))
        y[-1] = self._last
        self._run(y, 1, ticks, fore, aft)
        self._last[:] = y[-1]
        return {name: y[:, i].copy() for i, name in enumerate(OUTPUTS)}

    def spin(self, ticks: int, fore: float, aft: float) -> None:
        """The same, keeping only the last outputs."""
        self._run(self._last, 0, ticks, fore, aft)

    def _run(self, y: NDArray[Any], stride: int, ticks: int, fore: float, aft: float) -> None:
        kept = self._shakes, self._rings, self._places, self._counts
        self._memory = run_rig(self._constants, self._rng, self._memory, *kept, fore, aft, y, stride, ticks)
