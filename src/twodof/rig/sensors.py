"""Sensors: accelerometer and gyro at 250 Hz, time-of-flight range at 18.35 Hz, with the errors that the logs show."""

from typing import Any

from twodof.blocks import Block, Param, Port, State, int32, maximum, sqrt, store, to_int32, to_real, to_uint32, where
from twodof.blocks.block import Clock
from twodof.blocks.elementary.functions import cos, floor, sin
from twodof.blocks.noise import normal4
from twodof.rig.dynamics import sine_cosine
from twodof.rig.rotors import PAIRS, STILL
from twodof.signals import GRAVITY, RAIL_CENTRE

STREAM = 1
"""Stream of the noise generator that makes the sensors' noise."""

RING = 32
"""Samples of x that the range sensor keeps: at 250 Hz its measurement may be up to 0.12 s old."""

PI = 3.141592653589793

TURN = 2.0**32
"""A full turn of the range sensor's phase accumulator."""


def rounded(value: Any, step: Any) -> Any:
    """Return `value` rounded to the nearest multiple of `step`, or unchanged if `step` is 0."""
    return where(step > 0.0, floor(value / where(step > 0.0, step, 1.0) + 0.5) * step, value)


def passed(turns: Any) -> Any:
    """Return the mean of a cosine over a sample that lasts `turns` >= 0 of its periods, over its middle value."""
    return where(turns > 1e-3, sin(PI * turns) / (PI * maximum(turns, 1e-3)), 1.0)


class NoiseSource(Block):
    """Four independent standard normal numbers per sample, for the sensors."""

    outputs = tuple(Port(f"n{i}") for i in range(4))
    params = (Param("seed", 1, "uint32", text="of all noise of the rig"),)

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return dict(zip(("n0", "n1", "n2", "n3"), normal4(p.seed, STREAM, t.tick), strict=True))


class Imu(Block):
    """Accelerometer and gyro, body axes forward-right-down, `imu_below` m under the bearing and `imu_ahead` m ahead.

    The accelerometer gives the mean specific force since its last sample (it integrates, as flight controllers' IMUs
    do), so it sees impacts. Noise is white at rest. Running rotors add vibration in proportion to the thrust. One part
    is white noise through a band-pass about `vibration_hz`. The other part is lines: one rotor of each pair is out of
    balance. It turns `rotor_hz` times a second at the thrust of hover, and with the root of the thrust. The samples
    fold that frequency: 280 Hz is seen at 30 Hz. A line moves as the command and the battery change the speed.
    As each sample is a mean, a line near 250 Hz is hardly seen.
    """

    crossing = True
    inputs = (
        Port("theta", unit="rad"),
        Port("q", unit="rad/s"),
        Port("v", unit="m/s"),
        Port("load"),
        Port("load_fore"),
        Port("load_aft"),
        Port("n_x"),
        Port("n_z"),
        Port("n_q"),
    )
    outputs = (Port("acc_x", unit="m/s2"), Port("acc_z", unit="m/s2"), Port("gyro_y", unit="rad/s"))
    params = (
        Param("imu_below", 0.0, unit="m", low=-0.2, high=0.2, text="IMU under the bearing"),
        Param("imu_ahead", 0.0, unit="m", low=-0.2, high=0.2, text="IMU ahead of the bearing"),
        Param("acc_scale", 1.0, low=0.5, high=2.0, text="gain of the x axis"),
        Param("gyro_scale", 1.0, low=0.5, high=2.0, text="gain of the gyro"),
        Param("acc_bias", 0.0, unit="m/s2", low=-5.0, high=5.0, text="of the x axis"),
        Param("gyro_bias", 0.0, unit="rad/s", low=-1.0, high=1.0),
        Param("acc_x_idle", 0.17, unit="m/s2", low=0.0, high=100.0, text="white noise, motors idle"),
        Param("acc_z_idle", 0.07, unit="m/s2", low=0.0, high=100.0, text="white noise, motors idle"),
        Param("gyro_idle", 0.0014, unit="rad/s", low=0.0, high=10.0, text="white noise, motors idle"),
        Param("acc_x_hover", 1.0, unit="m/s2", low=0.0, high=100.0, text="vibration in hover"),
        Param("acc_z_hover", 2.5, unit="m/s2", low=0.0, high=100.0, text="vibration in hover"),
        Param("gyro_hover", 0.01, unit="rad/s", low=0.0, high=10.0, text="vibration in hover"),
        Param("vibration_hz", 38.0, unit="Hz", low=1.0, high=120.0, text="centre of the vibration's band"),
        Param("vibration_r2", 0.6, low=0.0, high=0.999, text="squared pole radius of that band"),
        Param("rotor_hz", 281.0, unit="Hz", low=1.0, high=1000.0, text="turns of a rotor in hover"),
        Param("acc_x_line", 0.0, unit="m/s2", low=0.0, high=100.0, text="rotors out of balance, in hover"),
        Param("acc_z_line", 0.0, unit="m/s2", low=0.0, high=100.0, text="rotors out of balance, in hover"),
        Param("gyro_line", 0.0, unit="rad/s", low=0.0, high=10.0, text="rotors out of balance, in hover"),
        Param("ring_shake", 1.0, low=0.0, high=100.0, text="factor on these lines of acc if the rings lock the cart"),
        Param("acc_step", 0.0024, unit="m/s2", low=0.0, high=1.0, text="quantisation"),
        Param("gyro_step", 0.00107, unit="rad/s", low=0.0, high=1.0, text="quantisation"),
        Param("noise", 1.0, low=0.0, high=100.0, text="gain of all noise; 0: none, and no quantisation"),
        Param("rings", False, "bool", text="the rings lock the cart (1DoF)"),
        Param("q_start", 0.0, unit="rad/s", low=-100.0, high=100.0),
        Param("v_start", 0.0, unit="m/s", low=-10.0, high=10.0),
    )
    derived = (
        Port("per_dt", unit="1/s"),
        Port("gain"),
        Port("turn"),
        Port("shake"),
        Port("per_passed"),
        Port("acc_grain", unit="m/s2"),
        Port("gyro_grain", unit="rad/s"),
    )
    states = (
        State("q", "q_start", unit="rad/s"),
        State("v", "v_start", unit="m/s"),
        *(State(f"{axis}_{part}") for axis in "xzq" for part in ("w1", "w2", "y1", "y2")),
        *(State(f"turned_{pair}") for pair in PAIRS),
    )

    def prepare(self, p: Any, t: Clock) -> Any:
        quantised = p.noise > 0.0
        return {
            "per_dt": 1.0 / t.dt,
            # Of variance 1: the band-pass (1 - A) / 2, A an all-pass, has (1 - r^2) / 2.
            "gain": sqrt(0.5 * (1.0 - p.vibration_r2)),
            "turn": (1.0 + p.vibration_r2) * cos(6.283185307179586 * p.vibration_hz * t.dt),
            "per_passed": 1.0 / maximum(abs(passed(t.dt * p.rotor_hz)), 1e-3),
            "shake": where(p.rings, p.ring_shake, 1.0),
            "acc_grain": where(quantised, p.acc_step, 0.0),
            "gyro_grain": where(quantised, p.gyro_step, 0.0),
        }

    def _vibration(self, axis: str, fresh: Any, x: Any, p: Any) -> Any:
        w2, y1, y2 = x[f"{axis}_w2"], x[f"{axis}_y1"], x[f"{axis}_y2"]
        return p.gain * (fresh - w2) + p.turn * y1 - p.vibration_r2 * y2

    def _turns(self, pair: str, u: Any, p: Any, t: Clock) -> Any:
        # Above 0, where the root has no slope; a rotor at rest shakes nothing.
        return t.dt * p.rotor_hz * sqrt(maximum(u[f"load_{pair}"], STILL))

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        sine, cosine = sine_cosine(u.theta)
        along, turning = (u.v - x.v) * p.per_dt, (u.q - x.q) * p.per_dt
        own_x = p.imu_below * turning - p.imu_ahead * (u.q * u.q)
        acc_x = p.acc_scale * (cosine * along + GRAVITY * sine + own_x) + p.acc_bias
        acc_z = sine * along - GRAVITY * cosine - p.imu_below * (u.q * u.q) - p.imu_ahead * turning

        fore, aft = (2.0 * PI * x[f"turned_{pair}"] for pair in PAIRS)
        # In hover each pair's line has the variance 1/2. Those of fore and aft pitch the drone in opposition.
        shake_fore, shake_aft = (
            u[f"load_{pair}"] * p.per_passed * passed(self._turns(pair, u, p, t)) for pair in PAIRS
        )
        along_x = shake_fore * cos(fore) + shake_aft * cos(aft)
        up_fore, up_aft = shake_fore * sin(fore), shake_aft * sin(aft)

        def error(axis: str, fresh: Any, idle: Any, hover: Any, line: Any) -> Any:
            # The band-pass is a sample behind, so that its noise is independent of the white one.
            return p.noise * (idle * fresh + hover * u.load * x[f"{axis}_y1"] + line)

        line_x, line_z = p.acc_x_line * p.shake * along_x, p.acc_z_line * p.shake * (up_fore + up_aft)
        error_q = error("q", u.n_q, p.gyro_idle, p.gyro_hover, p.gyro_line * (up_fore - up_aft))
        return {
            "acc_x": rounded(acc_x + error("x", u.n_x, p.acc_x_idle, p.acc_x_hover, line_x), p.acc_grain),
            "acc_z": rounded(acc_z + error("z", u.n_z, p.acc_z_idle, p.acc_z_hover, line_z), p.acc_grain),
            "gyro_y": rounded(p.gyro_scale * u.q + p.gyro_bias + error_q, p.gyro_grain),
        }

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        new = {"q": u.q, "v": u.v}
        for pair in PAIRS:
            turned = x[f"turned_{pair}"] + self._turns(pair, u, p, t)
            new[f"turned_{pair}"] = turned - floor(turned)
        for axis, fresh in (("x", u.n_x), ("z", u.n_z), ("q", u.n_q)):
            new[f"{axis}_w1"], new[f"{axis}_w2"] = fresh, x[f"{axis}_w1"]
            new[f"{axis}_y1"], new[f"{axis}_y2"] = self._vibration(axis, fresh, x, p), x[f"{axis}_y1"]
        return new


class RangeSensor(Block):
    """Time-of-flight range with its own clock: a 32-bit phase accumulator that turns `tof_rate` times a second.

    `dist` holds the last sample, and `dist_new` is true only in the tick in which it arrives. `dist_age` is its age by
    its stamp; the x that was measured is `tof_age` old. Before the first sample `dist` is the range at the start.
    """

    crossing = True
    inputs = (Port("x", unit="m"), Port("n"))
    outputs = (Port("dist", unit="m"), Port("dist_new", "bool"), Port("dist_age", unit="s"))
    params = (
        Param("tof_rate", 18.35, unit="Hz", low=0.1, high=100.0),
        Param("tof_age", 0.03, unit="s", low=0.0, high=0.12, text="age of the measured x when handed over"),
        Param("tof_stamp", 0.0, unit="s", low=0.0, high=0.12, text="age that its stamp admits to"),
        Param("tof_noise", 0.004, unit="m", low=0.0, high=1.0, text="standard deviation"),
        Param("tof_bias", 0.0, unit="m", low=-1.0, high=1.0),
        Param("tof_step", 0.001, unit="m", low=0.0, high=0.1, text="quantisation"),
        Param("tof_phase", 0.0, low=0.0, high=0.999999, text="phase of its clock at the start, in turns"),
        Param("noise", 1.0, low=0.0, high=100.0, text="gain of all noise; 0: none, and no quantisation"),
        Param("x_start", 0.0, unit="m", low=-10.0, high=10.0),
    )
    derived = (
        Port("advance", "uint32"),
        Port("first", "uint32"),
        Port("whole", "int32"),
        Port("fraction"),
        Port("grain", unit="m"),
        Port("dist_start", unit="m"),
    )
    states = (
        State("ring", 0.0, width=RING, unit="m"),
        State("place", 0, "int32"),
        State("filled", 0, "int32"),
        State("phase", "first", "uint32"),
        State("dist", "dist_start", unit="m"),
    )

    def prepare(self, p: Any, t: Clock) -> Any:
        samples = p.tof_age / t.dt
        whole = to_int32(samples)
        return {
            "advance": to_uint32(p.tof_rate * t.dt * TURN),
            "first": to_uint32(p.tof_phase * TURN),
            "whole": whole,
            "fraction": samples - to_real(whole),
            "grain": where(p.noise > 0.0, p.tof_step, 0.0),
            "dist_start": p.x_start + RAIL_CENTRE,
        }

    def _past(self, back: Any, u: Any, x: Any, p: Any) -> Any:
        kept = where(back <= x.filled, x.ring[(x.place - back) & int32(RING - 1)], p.x_start)
        return where(back < 1, u.x, kept)

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        new = (x.phase + p.advance) < x.phase  # the accumulator wraps
        younger = self._past(p.whole, u, x, p)
        older = self._past(p.whole + 1, u, x, p)
        measured = younger + p.fraction * (older - younger)
        fresh = measured + (RAIL_CENTRE + p.tof_bias) + (p.noise * p.tof_noise) * u.n
        return {"dist": where(new, rounded(fresh, p.grain), x.dist), "dist_new": new, "dist_age": p.tof_stamp}

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return {
            "ring": store(x.ring, x.place, u.x),
            "place": (x.place + 1) & int32(RING - 1),
            "filled": where(x.filled < RING, x.filled + 1, x.filled),
            "phase": x.phase + p.advance,
            "dist": self.output(u, x, p, t)["dist"],
        }
