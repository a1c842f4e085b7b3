"""Separate filters of pitch and position in series, in place of the joint filter."""

from typing import Any

from twodof.blocks import Block, Port, State, where
from twodof.blocks.elementary.functions import atan2, cos, sin
from twodof.flight.declarations import IMU, RANGE, ports, restarted, tunables
from twodof.signals import GRAVITY, RAIL_CENTRE


class PitchFilter(Block):
    """Pitch theta and rate q by an extended Kalman filter with the states theta and gyro bias b.

    Prediction, with the gyro's noise and bias walk: theta' = gyro_y - b, b' = 0. Measurement: the horizontal specific
    force, which only the cart's acceleration causes, is taken for white noise of `sigma_acc`,
        0 = cos(theta) f_x + sin(theta) f_z + noise.
    The derivative of this force by theta, at f = (g sin, -g cos), is -g. The first sample sets theta =
    atan2(f_x, -f_z). After a sample that makes a state NaN or implausible, the filter restarts with the next one
    (`declarations.restarted`). `variance` [rad^2] is that of theta; `covariance` and `bias_variance` complete the
    covariance matrix.
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


class RailAcceleration(Block):
    """Acceleration along the rail, cos(theta) f_x + sin(theta) f_z: the horizontal part of the specific force."""

    inputs = ports("acc_x", "acc_z", "theta")
    outputs = ports("acceleration")

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return cos(u.theta) * u.acc_x + sin(u.theta) * u.acc_z


class FixedGainPosition(Block):
    """x and v as the real drone estimates them: a filter of fixed gains, whose position the output follows with a lag.

    The filter integrates the acceleration; at each range sample, with e = range - x, x += k_x e and v += k_v e. The
    output v is the filter's. The output x integrates the same velocity and follows the filter's x with the time
    constant `lag`, so corrections do not make it jump, as in the drone's logs. The first sample sets x, with v = 0. The
    age of a sample is not used, as on the drone. With the defaults x is within 5 mm and v within 20 mm/s RMS of the
    drone's own estimates on each of its logs. An error b of the acceleration gives v the constant error b k_x / k_v,
    which the logs show; `bias` adds such an error in a simulated flight.
    """

    inputs = ports("acceleration", *RANGE)
    outputs = (*ports("x", "v"), Port("x_filter", unit="m"))
    states = (
        State("x", unit="m"),
        State("v", unit="m/s"),
        State("x_filter", unit="m"),
        State("started", False, "bool"),
    )
    derived = (Port("follow"),)
    params = tunables("estimator.position", "k_x", "k_v", "bias", "lag")

    def prepare(self, p: Any, t: Any) -> Any:
        return where(p.lag > t.dt, t.dt / p.lag, 1.0)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        acceleration = u.acceleration + p.bias
        step = (x.v + 0.5 * t.dt * acceleration) * t.dt
        velocity = x.v + acceleration * t.dt
        measured = u.dist - RAIL_CENTRE
        e = where(u.dist_new, measured - (x.x_filter + step), 0.0)
        first = u.dist_new & ~x.started
        running = x.started | u.dist_new
        filtered = where(first, measured, x.x_filter + step + p.k_x * e)
        out = x.x + step
        return {
            "x": where(running, where(first, measured, out + p.follow * (filtered - out)), 0.0),
            "v": where(running & ~first, velocity + p.k_v * e, 0.0),
            "x_filter": where(running, filtered, 0.0),
        }

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        new = self.output(u, x, p, t) | {"started": x.started | u.dist_new}
        return restarted(new, {"started": False})


_PAIRS = ("xx", "xv", "xb", "vv", "vb", "bb")


class KalmanPosition(Block):
    """x, v and the accelerometer's bias b by a Kalman filter: x' = v, v' = a - b + noise, b' = noise.

    A range sample that is `dist_age` = s seconds old measures where the cart was then, to second order in s:
    x - v s + (a - b) s^2 / 2. So a late sample needs no history of states. `P_xx` ... `P_bb` are the covariance's upper
    triangle.
    """

    inputs = ports("acceleration", *RANGE)
    outputs = (
        *ports("x", "v"),
        Port("bias", unit="m/s2"),
        *(Port(f"P_{pair}") for pair in _PAIRS),
        Port("innovation", unit="m"),
        Port("innovation_variance", unit="m2"),
    )
    states = (
        State("x", unit="m"),
        State("v", unit="m/s"),
        State("bias", unit="m/s2"),
        *(State(f"P_{pair}", f"P_{pair}_0" if pair in ("xx", "vv", "bb") else 0.0) for pair in _PAIRS),
        State("started", False, "bool"),
    )
    derived = tuple(Port(n) for n in ("P_xx_0", "P_vv_0", "P_bb_0", "q_xx", "q_xv", "q_vv", "q_bb", "r"))
    params = tunables("estimator.position", "sigma_a", "sigma_walk", "sigma_tof", "sigma_v_0", "sigma_bias_0")

    def prepare(self, p: Any, t: Any) -> Any:
        density = p.sigma_a * p.sigma_a
        r = p.sigma_tof * p.sigma_tof
        return {
            "P_xx_0": r,
            "P_vv_0": p.sigma_v_0 * p.sigma_v_0,
            "P_bb_0": p.sigma_bias_0 * p.sigma_bias_0,
            "q_xx": density * t.dt * t.dt * t.dt * (1.0 / 3.0),
            "q_xv": density * t.dt * t.dt * 0.5,
            "q_vv": density * t.dt,
            "q_bb": p.sigma_walk * p.sigma_walk * t.dt,
            "r": r,
        }

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        dt, half = t.dt, 0.5 * t.dt * t.dt
        a = u.acceleration - x.bias
        position = x.x + x.v * dt + a * half
        velocity = x.v + a * dt
        # P = F P F' + Q with F = [[1, dt, -dt^2/2], [0, 1, -dt], [0, 0, 1]]; f_.. are the rows of F P that are needed
        f_xx = x.P_xx + dt * x.P_xv - half * x.P_xb
        f_xv = x.P_xv + dt * x.P_vv - half * x.P_vb
        f_xb = x.P_xb + dt * x.P_vb - half * x.P_bb
        f_vv = x.P_vv - dt * x.P_vb
        f_vb = x.P_vb - dt * x.P_bb
        xx = f_xx + dt * f_xv - half * f_xb + p.q_xx
        xv = f_xv - dt * f_xb + p.q_xv
        vv = f_vv - dt * f_vb + p.q_vv
        bb = x.P_bb + p.q_bb
        # H = [1, -s, -s^2/2]: where it was s seconds ago
        s = u.dist_age
        h = 0.5 * s * s
        innovation = (u.dist - RAIL_CENTRE) - (position - velocity * s + a * h)
        n_x, n_v, n_b = xx - s * xv - h * f_xb, xv - s * vv - h * f_vb, f_xb - s * f_vb - h * bb
        variance = n_x - s * n_v - h * n_b + p.r
        first = u.dist_new & ~x.started
        use = u.dist_new & x.started
        k_x, k_v, k_b = (where(use, n / variance, 0.0) for n in (n_x, n_v, n_b))
        e = where(use, innovation, 0.0)
        held = ~(x.started & ~first)

        def after(old: Any, new: Any) -> Any:
            return where(held, old, new)

        return {
            "x": where(first, u.dist - RAIL_CENTRE, after(x.x, position + k_x * e)),
            "v": after(x.v, velocity + k_v * e),
            "bias": after(x.bias, x.bias + k_b * e),
            "P_xx": after(x.P_xx, xx - k_x * n_x),
            "P_xv": after(x.P_xv, xv - k_x * n_v),
            "P_xb": after(x.P_xb, f_xb - k_x * n_b),
            "P_vv": after(x.P_vv, vv - k_v * n_v),
            "P_vb": after(x.P_vb, f_vb - k_v * n_b),
            "P_bb": after(x.P_bb, bb - k_b * n_b),
            "innovation": e,
            "innovation_variance": variance,
        }

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        new = self.output(u, x, p, t)
        new = {n: v for n, v in new.items() if not n.startswith("innovation")} | {"started": x.started | u.dist_new}
        return restarted(new, {f"P_{n}": p[f"P_{n}_0"] for n in ("xx", "vv", "bb")} | {"started": False})
