"""State feedback of the pitch: LQI and LQG, with the moments under way as states.

The feedback acts on the state as it will be when the present moment arrives. The moments under way predict that state
over the dead time (Astrom and Wittenmark, Computer-Controlled Systems, sec. 2.3 and 4.4). So it is designed on the
plant without the whole steps of its dead time, and those steps give poles at 0. A stationary Kalman filter estimates
theta, q, the rotors and the gust of theta and q as they are measured.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twodof.blocks import Diagram
from twodof.blocks.library import DiscreteIntegrator, DiscreteStateSpace, Gain, Logic, Mux, Pid, Saturation, Sum, Switch
from twodof.blocks.library.delays import UnitDelay
from twodof.design.cascade import cascade_design
from twodof.design.pitch_family import PitchFamily, PitchMembers
from twodof.design.pitch_loop import AHEAD, GUST, PitchLoop, Q
from twodof.design.sampled_controller import SampledController
from twodof.errors import ParameterError
from twodof.flight.templates import ATTITUDE
from twodof.models.plant import PitchRate
from twodof.signals import PERIOD

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

THETA_NOISE = 0.002
"""Standard deviation of the published theta that the Kalman filter supposes [rad]."""

_LEAST_NOISE = 1e-3  # of q [rad/s] and of a gust's step: a filter that trusts a sensor wholly does not exist
_NO_CONTROLLER = SampledController(np.zeros((0, 0)), np.zeros((0, 3)), np.zeros((1, 0)), np.zeros((1, 3)))


@dataclass(frozen=True, eq=False)
class StateFeedback:
    """M = `goal` theta_0 - `state` . x - `integral` * (sum of T (theta - theta_0)), x as the observer estimates it.

    x are the states (m,) of `PitchLoop.plant`: theta, q, the rotors and the gust, then the moments under way and the
    published theta. `poles` [rad/s] are those that the feedback was designed for, without those at z = 0.
    """

    state: Array
    integral: float
    poles: Complex

    @property
    def goal(self) -> float:
        """Gain on theta_0 [1/rad] that puts a zero on the slowest real pole, so that theta does not show this pole."""
        real = self.poles[np.abs(self.poles.imag) < 1e-9].real
        if not real.size:
            return float(self.state[0])
        z = math.exp(float(real.max()) * PERIOD)
        return self.integral * PERIOD * z / (1.0 - z)


def lqi(
    family: PitchFamily,
    largest_theta: float = math.radians(5.0),
    largest_q: float = 2.0,
    largest_integral: float = 0.3,
    largest_moment: float = 0.1,
) -> StateFeedback:
    """Return the feedback that minimises a sum of squares, each over its largest size, for the family's estimate.

    The sum is that of (theta / largest_theta)^2 + (q / largest_q)^2 + (integral / largest_integral)^2 + (M /
    largest_moment)^2 (Bryson's rule). The units are rad, rad/s and rad s. Raises ParameterError for sizes that are not
    positive.
    """
    from scipy.linalg import solve_discrete_are  # imported late: most commands start without it

    sizes = (largest_theta, largest_q, largest_integral, largest_moment)
    if not all(0.0 < v < math.inf for v in sizes):
        what = f"the largest sizes {sizes!r:.80} are not all positive and finite"
        raise ParameterError(what, "state feedback", "give finite numbers > 0")
    a, b = _without_dead_time(family)
    weights = np.diag([largest_theta**-2, largest_q**-2, 0.0, 0.0, largest_integral**-2])
    effort = np.array([[largest_moment**-2]])
    cost = solve_discrete_are(a, b[:, None], weights, effort)
    gains = np.linalg.solve(effort + b @ cost @ b[:, None], (b @ cost @ a)[None])[0]
    poles = np.linalg.eigvals(a - np.outer(b, gains)).astype(np.complex128)
    moving = poles[np.abs(poles) > 1e-6]
    return _predicted(family, gains, np.asarray(np.log(moving) / PERIOD, dtype=np.complex128))


def observer(family: PitchFamily) -> tuple[Array, Array, Array, Array]:
    """Return (A, b, C) of the plant of `PitchLoop`, and the gain (m, 2) of its stationary Kalman filter on theta and q.

    The gust is that of the family, at least .3 rad/s2, so that the filter finds a constant load. Source: Astrom and
    Wittenmark, sec. 11.3.
    """
    from scipy.linalg import solve_discrete_are  # imported late: most commands start without it

    a, b = (part[0] for part in PitchLoop(family.nominal(), _NO_CONTROLLER, family.gust_time).plant)
    m = len(a)
    c = np.zeros((2, m))
    c[0, m - 1], c[1, Q] = 1.0, 1.0
    gust = max(family.gust, 0.3)
    disturbed = np.zeros((m, m))
    disturbed[GUST, GUST] = gust**2 * (1.0 - math.exp(-2.0 * PERIOD / family.gust_time))
    disturbed += 1e-12 * np.eye(m)
    noise = np.diag([THETA_NOISE**2, max(family.q_noise, _LEAST_NOISE) ** 2])
    p = solve_discrete_are(a.T, c.T, disturbed, noise)
    gain = np.linalg.solve(c @ p @ c.T + noise, c @ p).T
    return a, b, c, np.asarray(gain)


def lqg_attitude(family: PitchFamily) -> Diagram:
    """Return an LQG controller: `lqi` of the state of the family's Kalman filter, and in rate mode a PID.

    The observer gets the moment after its limit of +-1, so it does not count on what the motors cannot do. The integral
    is bounded to +-.5 rad s. The rate PID is that of `cascade_design` at 20 rad/s.
    """
    feedback = lqi(family)
    a, b, c, gain = observer(family)
    keep = np.eye(len(a)) - gain @ c
    # The state is what was predicted without the moment of the step before, which comes through a delay of one step.
    first = np.concatenate([(keep @ b)[:, None], gain], axis=1)
    row = feedback.state[None]
    v = family.values
    plant = PitchRate(v["w_n"], v["xi"], v["mu"], v["dead_time"])
    used = cascade_design(plant, 20.0, lag=v["lag"]).gains.rate
    d = Diagram(
        "lqg_attitude", "state feedback of theta, q, rotors and gust as observed, with the integral of the pitch error"
    )
    for asked in ATTITUDE.inputs:
        d.input(asked.name, asked.kind, unit=asked.unit)
    d.param("k_integral", feedback.integral, unit="1/rad/s", low=-100.0, high=100.0, text="gain on the integral")
    d.param("k_goal", feedback.goal, unit="1/rad", low=-100.0, high=100.0, text="gain on the pitch set-point")
    bounds = (("q_kp", "s/rad", 1.0), ("q_ki", "1/rad", 5.0), ("q_kd", "s2/rad", 0.05))
    for (parameter, unit, high), value in zip(bounds, used, strict=True):
        d.param(parameter, value, unit=unit, low=0.0, high=high, text=f"rate mode: {parameter[-1].upper()}")
    d.add("M_before", UnitDelay(0.0), u="limit", position=(200.0, 260.0))
    mux = Mux(3)
    d.add("seen", mux, position=(320.0, 200.0))
    for port, source in zip(mux.inputs, ("M_before", "theta", "q"), strict=True):
        d.connect(source, f"seen.{port.name}")
    d.add(
        "observed",
        DiscreteStateSpace((a @ keep).tolist(), (a @ first).tolist(), (row @ keep).tolist(), (row @ first).tolist()),
        u="seen",
        position=(440.0, 200.0),
    )
    d.add("error", Sum("+-", unit="rad"), a="theta_0", b="theta", position=(200.0, 40.0))
    d.add("in_rate_mode", Logic("not"), a="FLAG_ATTITUDE_ENABLED", position=(200.0, 360.0))
    d.add("clear", Logic("or"), a="FLAG_RESET_INT", b="in_rate_mode", position=(320.0, 360.0))
    d.add(
        "integral",
        DiscreteIntegrator("backward", limits=(-0.5, 0.5), reset=True, unit="rad*s"),
        u="error",
        clear="clear",
        position=(320.0, 100.0),
    )
    d.add("on_integral", Gain(1.0), params={"k": "k_integral"}, u="integral", position=(560.0, 100.0))
    d.add("on_goal", Gain(1.0), params={"k": "k_goal"}, u="theta_0", position=(560.0, 40.0))
    d.add("pitch", Sum("++-"), a="on_goal", b="on_integral", c="observed", position=(700.0, 100.0))
    d.add("rate_error", Sum("+-", unit="rad/s"), a="q_0", b="q", position=(440.0, 440.0))
    d.add(
        "rate",
        Pid(*used, 100.0, reset="integral", unit="rad/s"),
        params={"Kp": "q_kp", "Ki": "q_ki", "Kd": "q_kd"},
        e="rate_error",
        clear="FLAG_RESET_INT",
        position=(560.0, 440.0),
    )
    d.add("mode", Switch(), condition="FLAG_ATTITUDE_ENABLED", a="pitch", b="rate", position=(820.0, 200.0))
    d.add("limit", Saturation(-1.0, 1.0), u="mode", position=(940.0, 200.0))
    d.output("M", "limit")
    return d


def _without_dead_time(family: PitchFamily) -> tuple[Array, Array]:
    """Return (A, b) of theta, q, rotors, last moment and integral, without the whole steps of the dead time."""
    whole = _whole(family)
    part = family.values["dead_time"] - whole * PERIOD
    a, b = (one[0] for one in PitchLoop(PitchMembers.of({**family.values, "dead_time": part}), _NO_CONTROLLER).plant)
    return _with_integral(*_cut(a, b))


def _predicted(family: PitchFamily, gains: Array, poles: Complex) -> StateFeedback:
    """Convert gains on the state when the moment arrives (theta, q, rotors, last moment, integral) to the present."""
    a, b = (part[0] for part in PitchLoop(family.nominal(), _NO_CONTROLLER).plant)
    m = len(a)
    full, _ = _with_integral(*_cut(a, b))
    ahead = np.linalg.matrix_power(full, _whole(family))
    n = len(full)
    then = np.zeros((5, n))
    then[:3], then[4] = ahead[:3], ahead[-1]
    then[3, 3] = 1.0
    row = gains @ then
    state = np.zeros(m)
    state[:3], state[4 : m - 1] = row[:3], row[3:-1]
    # What the gust does to the rate like a moment is taken away by the moment itself.
    state[GUST] = 1.0 / family.values["mu"]
    return StateFeedback(state, float(row[-1]), np.asarray(poles, dtype=np.complex128))


def _cut(a: Array, b: Array) -> tuple[Array, Array]:
    """Return the plant without the gust and the published theta."""
    kept = [i for i in range(len(a) - 1) if i != GUST]
    return a[np.ix_(kept, kept)], b[kept]


def _with_integral(a: Array, b: Array) -> tuple[Array, Array]:
    """Return the plant with the sum of T theta, the published theta a sample later, as the last state."""
    n = len(a)
    whole = np.zeros((n + 1, n + 1))
    whole[:n, :n], whole[n, n], whole[n, :2] = a, 1.0, (PERIOD, PERIOD * AHEAD)
    return whole, np.append(b, 0.0)


def _whole(family: PitchFamily) -> int:
    """Return the whole steps of the dead time, as `PitchLoop` counts them."""
    return int(PitchLoop(family.nominal(), _NO_CONTROLLER).plant[0].shape[1]) - 6
