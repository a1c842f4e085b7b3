"""Non-parametric frequency response: what a record says about q / M before any structure is supposed."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twodof.errors import IdentificationError, nearest, shown
from twodof.identify.record import Record

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


_FEWEST = 8
"""Samples of a segment."""


@dataclass(frozen=True, eq=False)
class Spectra:
    """Spectral matrix of n signals at k frequencies, averaged over tapered segments.

    `matrix[f, i, j]` is the mean of conj(X_i) X_j. The matrix has shape (k, n, n). Its frequencies are `omega` [rad/s],
    shape (k,). `averages` is how many independent segments the overlapping ones are worth. `spacing` is how many points
    of the grid are worth one independent point, since neighbours share the taper's main lobe. `length` [s] is that of a
    segment.
    """

    names: tuple[str, ...]
    omega: Array
    matrix: Complex
    averages: float
    spacing: float
    length: float

    def block(self, rows: Sequence[str], columns: Sequence[str]) -> Complex:
        """Return the part of the matrix between these signals, shape (k, rows, columns)."""
        i, j = ([self.names.index(name) for name in part] for part in (rows, columns))
        return np.asarray(self.matrix[np.ix_(range(self.omega.size), i, j)])


def spectra(record: Record, names: Sequence[str], length: int, *, window: str = "hann") -> Spectra:
    """Welch's averaged spectra of the channels `names`, over half-overlapped segments of `length` samples.

    The mean of each segment is taken away. Outputs are interpolated linearly onto the record's grid.
    Raises IdentificationError for a channel or window that is not there, and a segment that does not fit 1.5 times.
    """
    check_segment(record, length)
    signals = np.array([grid_signal(record, name) for name in names])
    taper = _taper(window, length)
    starts = np.arange(0, record.steps - length + 1, length // 2)
    # One segment at a time: all at once would need the record's memory many times over.
    total = np.zeros((length // 2, len(names), len(names)), dtype=np.complex128)
    for start in starts:
        piece = signals[:, start : start + length]
        transform = np.fft.rfft((piece - piece.mean(axis=1, keepdims=True)) * taper)[:, 1:].T
        total += transform.conj()[:, :, None] * transform[:, None, :]
    squares = taper**2
    return Spectra(
        tuple(names),
        np.asarray(2.0 * math.pi * np.fft.rfftfreq(length, record.dt)[1:], dtype=np.float64),
        total / starts.size,
        _independent(taper, starts.size, length // 2),
        float(length * (squares @ squares) / squares.sum() ** 2),
        length * record.dt,
    )


def check_segment(record: Record, length: int) -> None:
    """Raise IdentificationError for segments of `length` samples that are too short or fit less than 1.5 times."""
    if length < _FEWEST or 3 * length > 2 * record.steps:
        raise IdentificationError(
            f"segments of {length} samples do not fit at least twice into {record.steps} samples",
            f"record '{record.name}'",
            "use a longer record or a shorter segment",
        )


def grid_signal(record: Record, name: str) -> Array:
    """Return a channel of the record on its grid: an input as it is held, an output interpolated linearly."""
    if name in record.inputs:
        return record.inputs[name]
    if name in record.outputs:
        samples = record.outputs[name]
        return np.asarray(np.interp(np.arange(record.steps), samples.position, samples.value))
    raise IdentificationError(
        f"the record does not hold {shown(name)}",
        f"record '{record.name}'",
        f"there are: {nearest(name, (*record.inputs, *record.outputs))}",
    )


def _taper(window: str, length: int) -> Array:
    from scipy.signal import get_window  # imported late: most commands start without it

    try:
        return np.asarray(get_window(window, length), dtype=np.float64)
    except (ValueError, TypeError) as reason:
        raise IdentificationError(
            f"no window is called {shown(window)}", "frequency response", "as 'hann' or 'blackman'"
        ) from reason


def _independent(taper: Array, count: int, hop: int) -> float:
    """How many independent segments the overlapping ones are worth (Welch 1967)."""
    energy = float(taper @ taper)
    total = 1.0
    for k in range(1, count):
        if k * hop >= taper.size:
            break
        overlap = float(taper[k * hop :] @ taper[: taper.size - k * hop]) / energy
        total += 2.0 * (1.0 - k / count) * overlap**2
    return count / total


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
    omega: Array
    response: Complex
    coherence: Array
    sigma: Array
    averages: float
    multiple: Array
    dt: float
    spacing: Array
    freedom: Array
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
        if not (isinstance(level, (int, float)) and 0.0 < level < 1.0):
            raise IdentificationError(f"the level is {shown(level)}", "radius", "give one between 0 and 1, as 0.95")
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
        phase, share = (
            np.degrees(np.unwrap(np.angle(self.response))),
            self.sigma / np.maximum(abs(self.response), 1e-300),
        )
        lines.extend(
            f"{self.omega[i]:7.2f} {abs(self.response[i]):9.4g} {self.sigma[i]:8.2g} {phase[i]:10.1f} "
            f"{math.degrees(share[i]):5.1f} {self.coherence[i]:10.3f}"
            for i in np.flatnonzero(self.trusted(coherence))
        )
        return "\n".join(lines)

    def to_json(self) -> str:
        """All points as JSON text; sigma is null where nothing is known."""
        return json.dumps(
            {
                "input": self.input,
                "output": self.output,
                "given": list(self.given),
                "reference": list(self.reference),
                "averages": self.averages,
                "omega": self.omega.tolist(),
                "real": self.response.real.tolist(),
                "imaginary": self.response.imag.tolist(),
                "coherence": self.coherence.tolist(),
                "multiple_coherence": self.multiple.tolist(),
                "sigma": [one if math.isfinite(one) else None for one in self.sigma.tolist()],
            },
            allow_nan=False,
        )


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
    if not isinstance(record, Record):
        raise IdentificationError(
            f"a {type(record).__name__} is not a record",
            "frequency_response",
            "cut one from a log, or Record.from_columns",
        )
    inputs, references = (input, *_names(given, "given")), _names(reference, "reference")
    for name in inputs:
        record.signals(name, output)
    length = record.steps * 2 // 9 if segment is None else _samples(segment, record)
    check_segment(record, length)
    _check_channels(record, inputs, references)
    made = spectra(record, (*inputs, *references, output), length, window=window)
    return _response(made, inputs, output, references, record)


def _names(names: str | Sequence[str], where: str) -> tuple[str, ...]:
    found = (names,) if isinstance(names, str) else tuple(names) if isinstance(names, Sequence) else None
    if found is None or not all(isinstance(name, str) for name in found):
        raise IdentificationError(f"{where}={shown(names)}", "frequency_response", "name one input, or a list of them")
    return found


def _samples(segment: float, record: Record) -> int:
    if not (isinstance(segment, (int, float)) and math.isfinite(segment) and segment > 0.0):
        raise IdentificationError(f"the segment is {shown(segment)}", "segment", "give a length in seconds")
    return round(min(segment / record.dt, 1e12))


def _check_channels(record: Record, inputs: Sequence[str], references: Sequence[str]) -> None:
    where = f"record '{record.name}'"
    for names, role in ((inputs, "input"), (references, "reference")):
        if len(set(names)) < len(names):
            raise IdentificationError(f"an {role} is named twice: {', '.join(names)}", where, "name each once")
        for name in names:
            if float(np.ptp(grid_signal(record, name))) == 0.0:
                raise IdentificationError(
                    f"the {role} '{name}' does not move", where, "choose a window with excitation"
                )
    if references and len(references) != len(inputs):
        raise IdentificationError(
            f"{len(references)} references for {len(inputs)} inputs",
            where,
            f"name one for each of {', '.join(inputs)}: what moves them from outside the loop",
        )


def _response(
    made: Spectra, inputs: Sequence[str], output: str, references: Sequence[str], record: Record
) -> FrequencyResponse:
    """Return the response to the first of the inputs, from all inputs and references (instruments) together.

    With r = u for instruments this is least squares at each frequency. The covariance is that of regression: cov H =
    S_vv A^-1 S_rr A^-H / (n - q). Here A = S_ru, and the noise is v = y - H u.
    """
    instruments = references or inputs
    count = len(inputs)
    freedom = made.averages - count
    if freedom <= 0.0:
        raise IdentificationError(
            f"{made.averages:.1f} averages for {count} input{'s' * (count > 1)}",
            f"record '{record.name}'",
            "use a longer record or a shorter segment",
        )
    between = made.block(instruments, inputs)
    usable = _usable(made, inputs, instruments, between, record)
    safe = np.where(usable[:, None, None], between, np.eye(count))
    inverse = np.linalg.inv(safe)
    response = (inverse @ made.block(instruments, [output]))[:, :, 0]
    own, cross = made.block(inputs, inputs), made.block(inputs, [output])[:, :, 0]
    p_yy = made.block([output], [output])[:, 0, 0].real
    explained = np.einsum("fi,fij,fj->f", response.conj(), own, response).real
    noise = np.maximum(p_yy - 2.0 * np.einsum("fi,fi->f", response.conj(), cross).real + explained, 0.0)
    spread = np.einsum("fi,fij,fj->f", inverse[:, 0], made.block(instruments, instruments), inverse[:, 0].conj()).real
    # Half of the complex variance belongs to each of the two parts.
    variance = 0.5 * noise * np.maximum(spread, 0.0) / freedom
    first = np.where(usable, response[:, 0], 0.0)
    power = abs(first) ** 2
    total = power + 2.0 * freedom * variance
    coherence = np.divide(power, total, out=np.zeros_like(power), where=usable & (total > 0.0))
    multiple = np.divide(noise, p_yy, out=np.ones_like(noise), where=usable & (p_yy > 0.0))
    return FrequencyResponse(
        inputs[0],
        output,
        made.omega,
        first,
        coherence,
        np.where(usable, np.sqrt(variance), math.inf),
        made.averages,
        np.clip(1.0 - multiple, 0.0, 1.0),
        record.dt,
        np.full(made.omega.size, made.spacing),
        np.full(made.omega.size, freedom),
        tuple(inputs[1:]),
        tuple(references),
    )


def _usable(
    made: Spectra, inputs: Sequence[str], instruments: Sequence[str], between: Complex, record: Record
) -> NDArray[np.bool_]:
    """Where the inputs hold power and can be told apart; a doublet has exact zeros in its spectrum.

    Raises IdentificationError where no frequency is left.
    """
    p_uu, p_rr = (np.einsum("fii->fi", made.block(one, one)).real for one in (inputs, instruments))
    lit = ((p_uu > 1e-12 * p_uu.max(axis=0)) & (p_rr > 1e-12 * p_rr.max(axis=0))).all(axis=1)
    scale = np.sqrt(np.maximum(p_rr[:, :, None] * p_uu[:, None, :], 1e-300))
    singular = np.linalg.svd(np.where(lit[:, None, None], between / scale, 0.0), compute_uv=False)
    usable = lit & (singular[:, -1] > 1e-6)
    if not usable.any():
        raise IdentificationError(
            f"the inputs {', '.join(inputs)} move alike at every frequency"
            if len(inputs) > 1
            else f"the input '{inputs[0]}' does not follow the reference",
            f"record '{record.name}'",
            "move one of them by itself, or leave it out",
        )
    return np.asarray(usable)
