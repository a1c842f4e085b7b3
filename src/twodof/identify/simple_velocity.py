"""The paper's simple method for the velocity (section 4.2): initial slope -> gain, first-order response -> pole."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from twodof.errors import IdentificationError
from twodof.identify.record import Record
from twodof.identify.simple_pitch import SimpleEstimate, edges_of, rest_before
from twodof.identify.validate import fit_percent
from twodof.models.plant import Velocity

Array = NDArray[np.float64]

# Share of the pitch held by which its set-point may stray.
_STRAYED = 0.1

# The slope is read between 10 and 40 % of the peak: noise of a tenth of the peak is a third of that.
_NOISY = 0.1


@dataclass(frozen=True, eq=False)
class StepResponse:
    """Figures read off the first half of the doublet; times on the log's axis [s].

    `theta_bar` [rad] is the pitch that is held, and its set-point strays by `strayed` [rad] until the doublet turns.
    `slope` [m/s2] is that of the straight line through v between 10 and 40 % of its peak.
    That line meets the rest at `start`. The peak above the rest is `peak` [m/s], at `peak_time`. Before the edge v
    scatters by `noise` [m/s].
    """

    edge: float
    theta_bar: float
    strayed: float
    rest: float
    slope: float
    start: float
    peak: float
    peak_time: float
    k_v: float
    p_v: float
    noise: float = 0.0


@dataclass(frozen=True, eq=False)
class SimpleVelocity(SimpleEstimate):
    """The simple method's model of the velocity with the figures it came from."""

    output = "v"

    model: Velocity
    step: StepResponse

    @property
    def remarks(self) -> tuple[str, ...]:
        """Return what a reader should know before using the figures, one sentence each with what to do about it."""
        found = super().remarks
        if self.step.strayed > _STRAYED * abs(self.step.theta_bar):
            strayed = (
                f"the pitch's set-point strays by {math.degrees(self.step.strayed):.0f} deg before the doublet turns, "
                "and this method needs it held: fly the doublet in the attitude loop, or estimate by output error "
                "(grey-box)"
            )
            found = (*found, strayed)
        share = self.step.noise / abs(self.step.peak)
        if share > _NOISY:
            noisy = (
                f"v scatters by {100.0 * share:.0f} % of its peak before the doublet, and the slope is read from the "
                "first 40 %: the noise is too large for this method. Fly a larger doublet, or estimate by output error "
                "(grey-box)"
            )
            found = (*found, noisy)
        return found

    def table(self) -> str:
        """Each step as a line of text."""
        s = self.step
        return self.table_with(
            [
                f"slope {s.slope:.3f} m/s2 at theta = {math.degrees(s.theta_bar):.1f} deg -> k_v = {s.k_v:.3f} m/s2",
                f"peak {s.peak:.3f} m/s, {s.peak_time - s.start:.3f} s after the start -> p_v = {s.p_v:.3f} 1/s",
            ]
        )

    def to_json(self) -> str:
        """Model and intermediate figures as JSON text."""
        read = ("edge", "theta_bar", "slope", "start", "peak", "peak_time")
        step = {name: getattr(self.step, name) for name in read}
        return self.json_with({"model": asdict(self.model), "step": step})


def identify_velocity(doublets: Sequence[Record]) -> SimpleVelocity:
    """k_v and p_v from the first of `doublets`; the others validate.

    Each record holds the inputs theta0 and theta [rad] and the output v [m/s]. Raises IdentificationError if a
    record lacks a channel or the excitation, or if v does not stand out of its noise.
    """
    if not doublets:
        raise IdentificationError("no doublet is given", "identify_velocity", "give at least one record")
    step = read_step(doublets[0])
    model = Velocity(step.k_v, step.p_v)
    scores = [(record.name, fit_percent(*simulated_pair(model, record))) for record in doublets]
    return SimpleVelocity(scores[0], tuple(scores[1:]), model, step)


def simulated_pair(model: Velocity, record: Record) -> tuple[Array, Array]:
    """Measured v less its rest, and v simulated from the measured pitch less its rest, at the samples' times."""
    time, v, theta0 = record.signals("theta0", "v")
    _, _, theta = record.signals("theta", "v")
    first = edges_of(record, theta0, "theta0")[0]
    rest = float(v[rest_before(record, time, record.start + first * record.dt, "v")].mean())
    simulated = model.state_space().zero_order_hold(record.dt).simulate(theta - theta[:first].mean())[:, 1]
    return v - rest, np.interp(time, record.time, simulated)


def read_step(record: Record) -> StepResponse:
    """Gain and pole from the first half of a doublet, as if the pitch followed its set-point at once.

    The model is v = -(k_v theta_bar / p_v) (1 - exp(-p_v t)), and the line's slope is taken for that of the start. The
    peak, at the time T after the start, gives p_v from (1 - exp(-p_v T)) / (p_v T) = peak / (slope T). It is 0 where v
    grows as fast as the line or faster. The slope of a line through the first 40 % is lower than that of the start, so
    both come out low, as in the paper.
    Raises IdentificationError as `identify_velocity` does.
    """
    time, v, theta0 = record.signals("theta0", "v")
    edges = edges_of(record, theta0, "theta0")
    edge = record.start + edges[0] * record.dt
    theta_bar = float(theta0[edges[0]] - theta0[edges[0] - 1])
    before = rest_before(record, time, edge, "v")
    rest, noise = float(v[before].mean()), float(v[before].std())
    until = record.start + (edges[1] if len(edges) > 1 else record.steps) * record.dt
    # The pitch turns back some time after its set-point, and v with it.
    half = (time >= edge) & (time <= until + 0.5 * (until - edge))
    t, y = time[half], -math.copysign(1.0, theta_bar) * (v[half] - rest)
    top = int(np.argmax(y))
    peak = float(y[top])
    if peak < 5.0 * noise or top < 8:
        what = f"the peak of v, {peak:.3g} m/s, hardly exceeds its noise {noise:.3g} m/s"
        remedy = "use a larger or longer doublet: below the static friction the cart does not move"
        raise IdentificationError(what, f"record '{record.name}', channel 'v'", remedy)
    rising = np.flatnonzero(y[: top + 1] < 0.1 * peak)
    low = int(rising[-1]) + 1 if rising.size else 0
    high = max(low + 3, int(np.argmax(y > 0.4 * peak)))
    slope, offset = (float(c) for c in np.polyfit(t[low:high] - edge, y[low:high], 1))
    start = edge - offset / slope
    duration = float(t[top]) - start
    ratio = peak / (slope * duration)
    from scipy.optimize import brentq  # imported late: most commands start without it

    p_v = brentq(lambda z: -math.expm1(-z) / z - ratio, 1e-9, 1e3) / duration if ratio < 1.0 - 1e-9 else 0.0
    sign = -math.copysign(1.0, theta_bar)
    return StepResponse(
        edge=edge,
        theta_bar=theta_bar,
        strayed=float(np.ptp(theta0[edges[0] : edges[1] if len(edges) > 1 else record.steps])),
        rest=rest,
        slope=sign * slope,
        start=start,
        peak=sign * peak,
        peak_time=float(t[top]),
        k_v=slope / abs(theta_bar),
        p_v=float(p_v),
        noise=noise,
    )
