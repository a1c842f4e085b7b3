"""The paper's simple method for the pitch rate (section 4.1), step by step as a student does it on a plot.

Experiment 1, an impulse: period -> natural frequency, settling time -> damping ratio. Experiment 2, a doublet: peak
over the peak simulated with mu = 1 -> gain; counting samples until the response overlays the simulated one -> delay.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from twodof.errors import IdentificationError
from twodof.identify.record import Record
from twodof.identify.validate import fit_percent, rmse
from twodof.models.plant import PitchRate

Array = NDArray[np.float64]

SETTLED = 0.01
"""A response is settled when its envelope is below this share of its first peak: exp(-4.6) = 1 %."""

# Half of the signal unexplained. Flights of the paper's experiments on the virtual rigs reach 66 to 92 %.
_POOR_FIT = 50.0

# What the model leaves unexplained, over the peak. Over 40 flights each it was .03 on the rig `paper`, where mu by hand
# scatters by 1 %, and .13 on the rig `lab`, where gusts make it scatter by 16 %.
_LEFT = 0.05

# In open loop the moment stands still between the edges. A controller moves it all the time.
_MOVED = 0.1


@dataclass(frozen=True, eq=False)
class FreeResponse:
    """Figures read off the response to the impulse; times on the log's axis [s].

    Every half swing has a peak (`peak_times`, `peaks`). `crossings` are the times of zero rate, and `period` [s] is
    their mean spacing times two. `settling_time` [s] lasts from the first peak until the envelope is below 1 % of it;
    `extrapolated` says that the record ended before.
    """

    crossings: Array
    peak_times: Array
    peaks: Array
    period: float
    settling_time: float
    extrapolated: bool
    w_n: float
    xi: float


@dataclass(frozen=True, eq=False)
class DoubletResponse:
    """Figures read off the response to a doublet about the trim moment.

    `edge` [s] and `amplitude` of the input's first edge; `peak` is the first peak of q [rad/s] above its rest,
    `unit_peak` that simulated with mu = 1, `peak_time` [s] when; `shift` counts the samples by which the simulated
    response must be delayed to lie on the measured one; `first_motion` counts the samples from the edge until q leaves
    three standard deviations of its noise. That is later than the delay, as q first has to climb out of the noise.
    `moved` is how far the input moves between its edges; in open loop it does not.
    """

    edge: float
    amplitude: float
    rest: float
    noise: float
    peak: float
    unit_peak: float
    peak_time: float
    shift: int
    first_motion: int
    mu: float
    tau: float
    moved: float = 0.0


@dataclass(frozen=True, eq=False)
class SimpleEstimate:
    """Common part of the simple methods: FIT [%] by record, of the identified record and of the others.

    `left` is the root mean square of what the model leaves unexplained in the record identified, over the peak.
    """

    output: ClassVar[str]

    identification: tuple[str, float]
    validation: tuple[tuple[str, float], ...]
    left: float = field(default=0.0, kw_only=True)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Return what a reader should know before using the figures, one sentence each with what to do about it."""
        return tuple(
            f"the model reproduces {self.output} in '{name}' with a FIT of only {value:.0f} %, so its figures are not "
            "to be trusted: check on a plot that the window holds one clean response, or estimate by output error "
            "(grey-box)"
            for name, value in (self.identification, *self.validation)
            if value < _POOR_FIT
        )

    def table_with(self, steps: Sequence[str]) -> str:
        """Return the lines `steps`, and below them fits and remarks."""
        name, value = self.identification
        lines = [*steps, f"identification '{name}': FIT {value:.1f} %"]
        lines.extend(f"validation '{name}': FIT {value:.1f} %" for name, value in self.validation)
        lines.extend(f"note: {remark}" for remark in self.remarks)
        return "\n".join(lines)

    def json_with(self, figures: Mapping[str, object]) -> str:
        """Return the `figures`, and below them fits and remarks, as JSON text."""
        fits = {"identification": dict([self.identification]), "validation": dict(self.validation)}
        return json.dumps({**figures, **fits, "remarks": self.remarks}, indent=2, default=np.ndarray.tolist)


@dataclass(frozen=True, eq=False)
class SimplePitch(SimpleEstimate):
    """The simple method's model of the pitch rate with the figures it came from."""

    output = "q"

    model: PitchRate
    free: FreeResponse
    doublet: DoubletResponse

    @property
    def remarks(self) -> tuple[str, ...]:
        """Return what a reader should know before using the figures, one sentence each with what to do about it."""
        name, amplitude = self.identification[0], abs(self.doublet.amplitude)
        found = list(super().remarks)
        if self.doublet.moved > _MOVED * amplitude:
            found.append(
                f"the moment in '{name}' moves by {self.doublet.moved:.2g} between its edges of {amplitude:.2g}: a "
                "controller makes it, and this method needs the loop open. Fly the doublet in open loop, or estimate "
                "by output error (grey-box), with w_n and xi held at those of a free response"
            )
        if self.left > _LEFT:
            found.append(
                f"the model leaves {100.0 * self.left:.0f} % of the peak of q unexplained in '{name}', and mu and tau "
                "by hand are not known better than that: gusts or noise are too large for one doublet. Repeat the "
                "flight, or estimate by output error (grey-box)"
            )
        return tuple(found)

    def table(self) -> str:
        """Each step as a line of text."""
        f, d, m = self.free, self.doublet, self.model
        halves = np.diff(f.crossings)
        late = " (extrapolated)" if f.extrapolated else ""
        return self.table_with(
            [
                f"period        T_P = {f.period:.3f} s -> w_n = {m.w_n:.3f} rad/s",
                f"              ({halves.size} half swings, the first {halves[0]:.3f} s, the last {halves[-1]:.3f} s)",
                f"settling time T_S = {f.settling_time:.2f} s{late} -> xi = 4.6 / (T_S w_n) = {m.xi:.4f}",
                f"peak {d.peak:.3f} rad/s over {d.unit_peak:.3e} rad/s with mu = 1 -> mu = {m.mu:.1f} rad/s2",
                f"the response lies {d.shift} samples behind the input -> tau = {1e3 * m.tau:.1f} ms",
                f"              (q leaves its noise {d.first_motion} samples after the edge)",
            ]
        )

    def to_json(self) -> str:
        """Model and intermediate figures as JSON text."""
        d = self.doublet
        read = ("period", "settling_time", "extrapolated", "crossings", "peak_times", "peaks")
        return self.json_with(
            {
                "model": asdict(self.model),
                "free_response": {name: getattr(self.free, name) for name in read},
                "doublet": {
                    **{name: getattr(d, name) for name in ("edge", "amplitude", "peak", "unit_peak")},
                    "shift_samples": d.shift,
                    "first_motion_samples": d.first_motion,
                },
            }
        )


def identify_pitch(impulse: Record, doublets: Sequence[Record], *, trim: float | None = None) -> SimplePitch:
    """Experiment 1 on `impulse`, experiment 2 on the first of `doublets`; the other doublets validate.

    `trim` is the moment that holds the drone level (default: the input before each doublet's first edge). Raises
    IdentificationError if a record lacks the excitation, or swings too little to read the figures.
    """
    if not doublets:
        raise IdentificationError("no doublet is given", "identify_pitch", "give at least one record")
    free = read_free_response(impulse)
    doublet = read_doublet(doublets[0], free.w_n, free.xi, trim)
    model = PitchRate(free.w_n, free.xi, doublet.mu, doublet.tau)
    pairs = [simulated_pair(model, record, trim) for record in doublets]
    scores = [(record.name, fit_percent(*pair)) for record, pair in zip(doublets, pairs, strict=True)]
    left = rmse(*pairs[0]) / doublet.peak
    return SimplePitch(scores[0], tuple(scores[1:]), model, free, doublet, left=left)


def simulated_pair(model: PitchRate, record: Record, trim: float | None = None) -> tuple[Array, Array]:
    """Measured q less its rest, and q simulated from rest at the moment `trim`, at the samples' times.

    `trim` defaults to the input's first value. Raises IdentificationError as `read_doublet` does.
    """
    time, q, u = record.signals("M", "q")
    edge = edges_of(record, u, "M")[0]
    rest = float(q[time < record.start + edge * record.dt].mean())
    simulated = model.state_space().zero_order_hold(record.dt).simulate(u - (u[0] if trim is None else trim))[:, 1]
    return q - rest, np.interp(time, record.time, simulated)


def read_free_response(record: Record) -> FreeResponse:
    """Period and settling time of the free response after the input's last edge.

    Raises IdentificationError without an edge, or with fewer than three half swings above the noise.
    """
    time, q, u = record.signals("M", "q")
    released = record.start + edges_of(record, u, "M")[-1] * record.dt
    after = time >= released
    t, y = time[after], q[after]
    tail = y[-max(10, y.size // 10) :]
    y = y - tail.mean()
    noise = float(np.std(np.diff(y))) / math.sqrt(2.0)
    level = max(3.0 * noise, 0.5 * SETTLED * float(np.abs(y).max()))
    runs = _runs(y, level)
    if len(runs) < 3:
        what = f"only {len(runs)} half swings stand out of the noise ({noise:.2g} rad/s)"
        remedy = "excite more strongly or take a longer window after the impulse"
        raise IdentificationError(what, f"record '{record.name}', channel 'q'", remedy)
    crossings = np.array([_crossing(t, y, a, b) for (_, a), (b, _) in pairwise(runs)])
    tops = [_top(t, y, a, b) for a, b in runs]
    times, peaks = np.array([p[0] for p in tops]), np.array([p[1] for p in tops])
    period = 2.0 * float(crossings[-1] - crossings[0]) / (crossings.size - 1)
    settling, extrapolated = _settling(t, y, times, np.abs(peaks), period)
    w_n = 2.0 * math.pi / period
    return FreeResponse(crossings, times, peaks, period, settling, extrapolated, w_n, 4.6 / (settling * w_n))


def read_doublet(record: Record, w_n: float, xi: float, trim: float | None = None) -> DoubletResponse:
    """Gain and delay from the response to a doublet, given the poles.

    Both peaks, measured and simulated, are read from signals averaged over the same five samples. So noise does not
    lift the peak, and the average rounds both corners alike. Raises IdentificationError without an edge, without rest
    before it, or for a response within the noise.
    """
    time, q, u = record.signals("M", "q")
    edges = edges_of(record, u, "M")
    edge = record.start + edges[0] * record.dt
    before = rest_before(record, time, edge, "q")
    rest, noise = float(q[before].mean()), float(q[before].std())
    grid = np.interp(record.time, time, q - rest)
    level = u[0] if trim is None else trim
    unit = PitchRate(w_n, xi, 1.0, 0.0).state_space().zero_order_hold(record.dt).simulate(u - level)[:, 1]
    first = slice(edges[0], edges[1] + 15 if len(edges) > 1 else record.steps)
    sign = math.copysign(1.0, u[edges[0]] - u[0])
    measured, expected = (_averaged(sign * signal)[first] for signal in (grid, unit))
    peak, unit_peak = float(measured.max()), float(expected.max())
    if peak < 5.0 * noise:
        what = f"the response's peak {peak:.3g} rad/s hardly exceeds its noise {noise:.3g} rad/s"
        raise IdentificationError(what, f"record '{record.name}', channel 'q'", "use a larger or longer doublet")
    mu = peak / unit_peak
    shift = _best_shift(grid, mu * unit)
    loud = sign * grid[edges[0] :] > 3.0 * noise
    return DoubletResponse(
        edge=edge,
        amplitude=float(u[edges[0]] - u[0]),
        rest=rest,
        noise=noise,
        peak=peak,
        unit_peak=unit_peak,
        peak_time=float(record.time[first][int(measured.argmax())]),
        shift=shift,
        first_motion=int(np.argmax(loud[:-2] & loud[1:-1] & loud[2:])),
        mu=mu,
        tau=shift * record.dt,
        moved=_moved(u, edges),
    )


def rest_before(record: Record, time: Array, edge: float, output: str) -> NDArray[np.bool_]:
    """Which samples precede the first edge [s]. Raises IdentificationError for fewer than five."""
    before = time < edge
    count = np.count_nonzero(before)
    if count < 5:
        what = f"{count} samples precede the first edge at {edge:g} s"
        remedy = "start the window at least 0.05 s earlier"
        raise IdentificationError(what, f"record '{record.name}', channel '{output}'", remedy)
    return before


def edges_of(record: Record, u: Array, input: str) -> list[int]:
    """Return the steps where the input jumps by over a fifth of its range. Raises IdentificationError if none."""
    span = float(np.ptp(u))
    jumps = np.flatnonzero(np.abs(np.diff(u)) > 0.2 * span) + 1 if span > 0.0 else np.array([], dtype=int)
    if jumps.size == 0:
        raise record.error(f"the input '{input}' has no edge", "choose a window with the excitation")
    return [int(k) for k in jumps]


def _moved(u: Array, edges: Sequence[int]) -> float:
    """Return the largest peak-to-peak of the input before the first edge and between edges.

    The edge may take a sample or two, as a telemetry channel shows it.
    """
    bounds = [0, *edges]
    pieces = [u[a + 2 : b - 1] for a, b in pairwise(bounds)]
    return max((float(np.ptp(piece)) for piece in pieces if piece.size), default=0.0)


def _runs(y: Array, level: float) -> list[tuple[int, int]]:
    """First and last index of each half swing: where |y| exceeds `level` with one sign."""
    index = np.flatnonzero(np.abs(y) > level)
    if index.size == 0:
        return []
    change = np.flatnonzero(np.diff(np.sign(y[index])) != 0.0)
    starts = np.concatenate([[0], change + 1])
    ends = np.concatenate([change, [index.size - 1]])
    return [(int(index[a]), int(index[b])) for a, b in zip(starts, ends, strict=True)]


def _crossing(t: Array, y: Array, a: int, b: int) -> float:
    """Zero of the straight line through the samples between two half swings."""
    piece = slice(max(0, a - 2), b + 3)
    slope, offset = np.polyfit(t[piece] - t[a], y[piece], 1)
    return float(t[a] - offset / slope)


def _top(t: Array, y: Array, a: int, b: int) -> tuple[float, float]:
    """Time and value of a half swing's extreme, from a parabola through the samples around it."""
    k = a + int(np.argmax(np.abs(y[a : b + 1])))
    half = max(2, (b - a) // 8)
    low, high = max(a, k - half), min(b, k + half)
    if high - low < 4 or k - low < 2 or high - k < 2:
        return float(t[k]), float(y[k])
    c2, c1, c0 = np.polyfit(t[low : high + 1] - t[k], y[low : high + 1], 2)
    top = float(np.clip(-c1 / (2.0 * c2), t[low] - t[k], t[high] - t[k])) if c2 != 0.0 else 0.0
    return float(t[k] + top), float(c0 + top * (c1 + top * c2))


def _settling(t: Array, y: Array, times: Array, peaks: Array, period: float) -> tuple[float, bool]:
    """When the swings fall below 1 % of the first peak, counted from it, and whether that is beyond the record.

    Between two peaks the envelope is straight in the logarithm. A drone that stops dead (dry friction) has no later
    peak: there the last moment outside the limit counts.
    """
    limit = SETTLED * peaks[0]
    below = np.flatnonzero(peaks < limit)
    if below.size:
        k = int(below[0])
        share = math.log(peaks[k - 1] / limit) / math.log(peaks[k - 1] / peaks[k])
        return float(times[k - 1] + share * (times[k] - times[k - 1]) - times[0]), False
    last = t[np.flatnonzero(np.abs(_averaged(y)) > limit)[-1]]
    if t[-1] - last > 0.5 * period:
        return float(last - times[0]), False
    rate = float(np.polyfit(times, np.log(peaks), 1)[0])
    if rate >= 0.0:
        raise IdentificationError("the oscillation does not decay", "free response", "check the window")
    return float(times[-1] - times[0] + math.log(limit / peaks[-1]) / rate), True


def _averaged(y: Array) -> Array:
    """Mean over five samples around each."""
    return np.convolve(np.pad(y, 2, mode="edge"), np.full(5, 0.2), mode="valid")


def _best_shift(measured: Array, simulated: Array) -> int:
    """By how many samples (0..25) `simulated` must be delayed for the smallest squared difference."""
    costs = [
        float(np.mean((measured[n:] - simulated[: simulated.size - n]) ** 2))
        for n in range(min(26, simulated.size // 2))
    ]
    return int(np.argmin(costs))
