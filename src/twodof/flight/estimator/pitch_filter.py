"""Pitch from gyro and accelerometer: an extended Kalman filter about one axis, with the gyro's bias as second state."""

from typing import Any

from twodof.blocks import Block, Port, State, where
from twodof.blocks.elementary.functions import atan2, cos, sin
from twodof.flight.declarations import IMU, ports, tunables
from twodof.flight.finite import restarted
from twodof.signals import GRAVITY


class PitchFilter(Block):
    """Pitch theta and rate q by an extended Kalman filter with the states theta and gyro bias b.

    Prediction, with the gyro's noise and bias walk: theta' = gyro_y - b, b' = 0. Measurement: only the cart's
    acceleration makes a horizontal specific force, and it is taken for white noise of `sigma_acc`,
        0 = cos(theta) f_x + sin(theta) f_z + noise.
    Its derivative by theta, at f = (g sin, -g cos), is -g. The first sample sets theta = atan2(f_x, -f_z).
    After a sample that cannot be, such as NaN, it starts anew with the next one (`finite.restarted`).
    `variance` is that of theta, (rad)^2; `covariance` and `bias_variance` complete the matrix.
    """

    inputs = ports(*IMU)
    outputs = (
        *ports("theta", "q"),
        Port("bias", unit="rad/s"),
        *(Port(name) for name in ("variance", "covariance", "bias_variance")),
    )
    states = (
        State("theta", unit="rad"),
        State("bias", unit="rad/s"),
        State("variance", "variance_0"),
        State("covariance"),
        State("bias_variance", "bias_variance_0"),
        State("started", False, "bool"),
    )
    derived = tuple(Port(name) for name in ("variance_0", "bias_variance_0", "gyro_q", "walk_q", "acc_r"))
    # The noise densities are those of the drone in hover (q .06 rad/s a sample, acceleration and vibration together
    # some m/s2); with them theta stays within .3 deg RMS of the drone's own estimate on each of its logs.
    params = tunables("estimator.pitch")

    def prepare(self, p: Any, t: Any) -> Any:
        return {
            "variance_0": p.sigma_theta_0 * p.sigma_theta_0,
            "bias_variance_0": p.sigma_bias_0 * p.sigma_bias_0,
            "gyro_q": p.sigma_gyro * p.sigma_gyro * t.dt,
            "walk_q": p.sigma_walk * p.sigma_walk * t.dt,
            "acc_r": p.sigma_acc * p.sigma_acc,
        }

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        theta = where(x.started, x.theta + (u.gyro_y - x.bias) * t.dt, atan2(u.acc_x, -u.acc_z))
        # P = F P F' + Q with F = [[1, -dt], [0, 1]]
        p00 = x.variance - 2.0 * t.dt * x.covariance + t.dt * t.dt * x.bias_variance + p.gyro_q
        p01 = x.covariance - t.dt * x.bias_variance
        p11 = x.bias_variance + p.walk_q
        residual = cos(theta) * u.acc_x + sin(theta) * u.acc_z
        gain = GRAVITY / (GRAVITY * GRAVITY * p00 + p.acc_r)
        k0 = where(x.started, gain * p00, 0.0)
        k1 = where(x.started, gain * p01, 0.0)
        bias = x.bias + k1 * residual
        return {
            "theta": theta + k0 * residual,
            "q": u.gyro_y - bias,
            "bias": bias,
            "variance": where(x.started, p00 - k0 * GRAVITY * p00, x.variance),
            "covariance": where(x.started, p01 - k0 * GRAVITY * p01, x.covariance),
            "bias_variance": where(x.started, p11 - k1 * GRAVITY * p01, x.bias_variance),
        }

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        new = self.output(u, x, p, t)
        new = {name: value for name, value in new.items() if name != "q"} | {"started": True}
        return restarted(new, {n: p[f"{n}_0"] for n in ("variance", "bias_variance")} | {"started": False})
