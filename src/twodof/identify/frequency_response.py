"""Non-parametric frequency response: what a record says about q / M before any structure is supposed."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from twodof.errors import is_number, nearest, shown
from twodof.identify.record import Record, check_record
from twodof.identify.validate import check_level

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


_FEWEST = 8
"""Samples of a segment."""


def _grid_signal(record: Record, name: str) -> Array:
    """Return a channel of the record on its grid: an input as it is held, an output interpolated linearly."""
    if name in record.inputs:
        return record.inputs[name]
    if name in record.outputs:
        samples = record.outputs[name]
        return np.asarray(np.interp(np.arange(record.steps), samples.position, samples.value))
    raise record.error(
        f"the record does not hold {shown(name)}", f"there are: {nearest(name, (*record.inputs, *record.outputs))}"
    )


def _spectra(signals: Array, taper: Array) -> Complex:
    """Return Welch's averaged spectral matrix of `signals` (n, steps), shape (k, n, n): means of conj(X_i) X_j.

    Segments overlap by half, and the mean of each is taken away.
    """
    length, (count, steps) = taper.size, signals.shape
    starts = np.arange(0, steps - length + 1, length // 2)
    # One segment at a time: all at once would need the record's memory many times over.
    total = np.zeros((length // 2, count, count), dtype=np.complex128)
    for start in starts:
        piece = signals[:, start : start + length]
        transform = np.fft.rfft((piece - piece.mean(axis=1, keepdims=True)) * taper)[:, 1:].T
        total += transform.conj()[:, :, None] * transform[:, None, :]
    return np.asarray(total / starts.size)


def _independent(taper: Array, steps: int) -> float:
    """Return how many independent segments the half-overlapping ones of `steps` samples are worth (Welch 1967)."""
    hop = taper.size // 2
    count = 1 + (steps - taper.size) // hop
    shares = [(float(taper[k * hop :] @ taper[: taper.size - k * hop]) / float(taper @ taper)) ** 2 for k in (1, 2)]
    return count / (1.0 + sum(2.0 * max(1.0 - k / count, 0.0) * share for k, share in enumerate(shares, 1)))


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """Frequency response from one input to one output, estimated from averaged spectra.

    All arrays have the shape (n,). `omega` [rad/s], `response` complex. `sigma` is the standard deviation of the real
    part, of the imaginary part and of |response|; divided by |response| it is that of the phase in radians.

    `coherence` in [0, 1] says how much of the output follows this input alone: the ordinary one, with `given` inputs
    the partial one. With a `reference` it is the coherence that would give the same error. `multiple` is the share of
    the output's power that all inputs explain. `averages` counts independent segments. `freedom` is what is left of
    them beside the inputs. `spacing` is how many points of the grid are worth one independent point. `dt` [s] is the
    step over which the input is held.
    """

    input: str
    output: str
    omega: Array = field(repr=False)
    response: Complex = field(repr=False)
    coherence: Array = field(repr=False)
    sigma: Array = field(repr=False)
    averages: float
    multiple: Array = field(repr=False)
    dt: float
    spacing: Array = field(repr=False)
    freedom: Array = field(repr=False)
    given: tuple[str, ...] = ()
    reference: tuple[str, ...] = ()

    def trusted(self, coherence: float = 0.6) -> NDArray[np.bool_]:
        """Where the coherence is at least `coherence`, the usual limit of flight-test work (Tischler)."""
        return self.coherence >= coherence

    def radius(self, level: float = 0.95) -> Array:
        """Radius of the disk around `response` that holds the true one with the probability `level`, shape (n,).

        |error|^2 / (2 sigma^2) is distributed as F with 2 and 2 `freedom` degrees of freedom (Bendat and Piersol,
        Random Data, section 9.2.3). Raises IdentificationError for a level that is not between 0 and 1.
        """
        check_level(level)
        ratio = self.freedom * np.expm1(-math.log1p(-level) / self.freedom)
        return np.asarray(self.sigma * np.sqrt(2.0 * ratio))

    def table(self, coherence: float = 0.6) -> str:
        """Frequency, gain, phase, their standard deviations and the coherence of the trusted points as text."""
        parts = [f"{self.output} / {self.input}"]
        parts += [f"with {', '.join(self.given)} taken away"] if self.given else []
        parts += [f"from {', '.join(self.reference)}"] if self.reference else []
        lines = [
            f"{', '.join(parts)}, {self.averages:.1f} averages",
            "  rad/s      gain       +-  phase deg    +-  coherence",
        ]
        phase = np.degrees(np.unwrap(np.angle(self.response)))
        share = self.sigma / np.maximum(abs(self.response), 1e-300)
        lines.extend(
            f"{self.omega[i]:7.2f} {abs(self.response[i]):9.4g} {self.sigma[i]:8.2g} {phase[i]:10.1f} "
            f"{math.degrees(share[i]):5.1f} {self.coherence[i]:10.3f}"
            for i in np.flatnonzero(self.trusted(coherence))
        )
        return "\n".join(lines)


def frequency_response(
    record: Record,
    input: str,
    output: str,
    *,
    segment: float | None = None,
    window: str = "hann",
    given: str | Sequence[str] = (),
    reference: str | Sequence[str] = (),
) -> FrequencyResponse:
    """Return the averaged cross-spectrum over the input's spectrum (H1), half-overlapped segments of `segment` [s].

    The default segment gives eight segments. Its length sets the resolution, 1/segment Hz; fewer than two leave the
    coherence without meaning.

    `given`: other inputs that moved at the same time. What the output owes to them is taken away. At each frequency H =
    S_uu^-1 S_uy is that of all inputs together (conditioned spectra). One input alone would carry what is correlated.

    `reference`: under feedback H1 is biased, since the controller answers the noise. Name what excites the loop from
    outside: theta0 in attitude mode, q0 in rate mode (an inner set-point answers the noise too). Then H = S_ry / S_ru,
    the joint input-output way. Give as many references as there are inputs.

    The input is the held one, so the response contains the hold: half a step of delay. The output is interpolated
    linearly onto the record's grid. Sources: Bendat and Piersol, Random Data, sections 7.3 and 9.2-9.3; Tischler and
    Remple, Aircraft and Rotorcraft System Identification, chapters 7-10 (FRESPID, MISOSA). For the
    reference: Ljung, System Identification, section 13.5.

    Raises IdentificationError for unknown channels and for a segment that does not fit twice. It is also raised for an
    input or reference that does not move, inputs that move alike, and fewer averages than inputs.
    """
    from scipy.signal import get_window  # imported late: most commands start without it

    check_record(record)
    others, references = ((one,) if isinstance(one, str) else tuple(one) for one in (given, reference))
    inputs = (input, *others)
    for name in inputs:
        record.signals(name, output)
    if segment is not None and not is_number(segment):
        raise record.error(f"the segment is {shown(segment)}", "give a length in seconds")
    signals = np.array([_grid_signal(record, name) for name in (*inputs, *references, output)])
    for names, role in ((inputs, "input"), (references, "reference")):
        if len(set(names)) < len(names):
            raise record.error(f"an {role} is named twice: {', '.join(names)}", "name each once")
    for name, signal in zip((*inputs, *references), signals, strict=False):
        if float(np.ptp(signal)) == 0.0:
            raise record.error(f"'{name}' does not move", "choose a window with excitation")
    count = len(inputs)
    if references and len(references) != count:
        what = f"{len(references)} references for {count} inputs"
        raise record.error(what, f"name one for each of {', '.join(inputs)}: what moves them from outside the loop")
    samples = record.steps * 2 // 9 if segment is None else segment / record.dt
    if not _FEWEST <= samples <= record.steps / 1.5:
        what = f"segments of {samples:g} samples do not fit at least twice into {record.steps} samples"
        raise record.error(what, "use a longer record or a shorter segment")
    length = round(samples)
    try:
        taper = np.asarray(get_window(window, length), dtype=np.float64)
    except ValueError as reason:
        raise record.error(f"no window is called {shown(window)}", "as 'hann' or 'blackman'") from reason
    averages = _independent(taper, record.steps)
    freedom = averages - count
    if freedom <= 0.0:
        raise record.error(
            f"{averages:.1f} averages for {count} input{'s' * (count > 1)}", "use a longer record or a shorter segment"
        )
    # With r = u for instruments this is least squares at each frequency. The covariance is that of regression:
    # cov H = S_vv A^-1 S_rr A^-H / (n - q). Here A = S_ru, and the noise is v = y - H u.
    matrix = _spectra(signals, taper)
    u, r = slice(0, count), slice(count, -1) if references else slice(0, count)
    between = matrix[:, r, u]
    powers = np.einsum("fii->fi", matrix).real
    usable = _usable(between, powers[:, u], powers[:, r])
    if not usable.any():
        what = f"the inputs {', '.join(inputs)} move alike at every frequency, or do not follow the references"
        raise record.error(what, "move one of them by itself, or leave it out")
    inverse = np.linalg.inv(np.where(usable[:, None, None], between, np.eye(count)))
    response = (inverse @ matrix[:, r, -1:])[:, :, 0]
    p_yy = powers[:, -1]
    explained = np.einsum("fi,fij,fj->f", response.conj(), matrix[:, u, u], response).real
    noise = np.maximum(p_yy - 2.0 * np.einsum("fi,fi->f", response.conj(), matrix[:, u, -1]).real + explained, 0.0)
    spread = np.einsum("fi,fij,fj->f", inverse[:, 0], matrix[:, r, r], inverse[:, 0].conj()).real
    # Half of the complex variance belongs to each of the two parts.
    variance = 0.5 * noise * np.maximum(spread, 0.0) / freedom
    first = np.where(usable, response[:, 0], 0.0)
    power = abs(first) ** 2
    total = power + 2.0 * freedom * variance
    coherence = np.divide(power, total, out=np.zeros_like(power), where=usable & (total > 0.0))
    multiple = np.divide(noise, p_yy, out=np.ones_like(noise), where=usable & (p_yy > 0.0))
    every = np.ones(first.size)
    return FrequencyResponse(
        input,
        output,
        np.asarray(2.0 * math.pi * np.fft.rfftfreq(length, record.dt)[1:], dtype=np.float64),
        first,
        coherence,
        np.where(usable, np.sqrt(variance), math.inf),
        averages,
        np.clip(1.0 - multiple, 0.0, 1.0),
        record.dt,
        # Neighbours share the taper's main lobe.
        every * float(length * (taper**2 @ taper**2) / np.sum(taper**2) ** 2),
        every * freedom,
        others,
        references,
    )


def _usable(between: Complex, p_uu: Array, p_rr: Array) -> NDArray[np.bool_]:
    """Return where the inputs hold power and can be told apart; a doublet has exact zeros in its spectrum."""
    lit = ((p_uu > 1e-12 * p_uu.max(axis=0)) & (p_rr > 1e-12 * p_rr.max(axis=0))).all(axis=1)
    scale = np.sqrt(np.maximum(p_rr[:, :, None] * p_uu[:, None, :], 1e-300))
    singular = np.linalg.svd(np.where(lit[:, None, None], between / scale, 0.0), compute_uv=False)
    return np.asarray(lit & (singular[:, -1] > 1e-6))
