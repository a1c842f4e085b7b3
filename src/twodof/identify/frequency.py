"""Non-parametric frequency response: what a record says about q / M before any structure is supposed."""

import json
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twodof.errors import IdentificationError
from twodof.identify.record import Record

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """Frequency response from one input to one output, estimated from averaged spectra.

    `omega` [rad/s], `response` complex, `coherence` in [0, 1] and `sigma`, the standard deviation of |response|
    (and, divided by |response|, of its phase in radians), all of shape (n,); `averages` counts independent segments.
    """

    input: str
    output: str
    omega: Array
    response: NDArray[np.complex128]
    coherence: Array
    sigma: Array
    averages: float

    def trusted(self, coherence: float = 0.6) -> NDArray[np.bool_]:
        """Where the coherence is at least `coherence`, the usual limit of flight-test work (Tischler)."""
        return self.coherence >= coherence

    def table(self, coherence: float = 0.6) -> str:
        """Frequency, gain, phase and coherence of the trusted points as text."""
        lines = [
            f"{self.output} / {self.input}, {self.averages:.1f} averages",
            "  rad/s      gain  phase deg  coherence",
        ]
        phase = np.degrees(np.unwrap(np.angle(self.response)))
        lines.extend(
            f"{self.omega[i]:7.2f} {abs(self.response[i]):9.4g} {phase[i]:10.1f} {self.coherence[i]:10.3f}"
            for i in np.flatnonzero(self.trusted(coherence))
        )
        return "\n".join(lines)

    def to_json(self) -> str:
        """All points as JSON text."""
        return json.dumps(
            {
                "input": self.input,
                "output": self.output,
                "averages": self.averages,
                "omega": self.omega.tolist(),
                "real": self.response.real.tolist(),
                "imaginary": self.response.imag.tolist(),
                "coherence": self.coherence.tolist(),
                "sigma": self.sigma.tolist(),
            }
        )


def frequency_response(
    record: Record, input: str, output: str, *, segment: float | None = None, window: str = "hann"
) -> FrequencyResponse:
    """Welch's averaged cross-spectrum over the input's spectrum (H1), half-overlapped segments of `segment` [s].

    The default segment gives eight segments. Its length sets the resolution, 1/segment Hz; fewer than two leave the
    coherence without meaning. The input is the held one, so the response contains the hold: half a step of delay.
    The output is interpolated linearly onto the record's grid. H1 is unbiased for noise on the output; under feedback
    (a closed loop) it is not. sigma after Bendat and Piersol, Random Data, section 9.2.
    Raises IdentificationError for unknown channels, a segment that does not fit twice, an input that does not move.
    """
    where = f"record '{record.name}'"
    _, value, u = record.signals(input, output)
    steps, dt = record.steps, record.dt
    length = steps * 2 // 9 if segment is None else round(segment / dt)
    if length < 8 or 3 * length > 2 * steps:
        raise IdentificationError(
            f"segments of {length} samples do not fit at least twice into {steps} samples",
            where,
            "use a longer record or a shorter segment",
        )
    y = np.interp(np.arange(steps), record.outputs[output].position, value)
    if float(np.ptp(u)) == 0.0:
        raise IdentificationError(f"the input '{input}' does not move", where, "choose a window with excitation")
    from scipy.signal import get_window  # imported late: most commands start without it

    taper = get_window(window, length)
    starts = np.arange(0, steps - length + 1, length // 2)
    pieces = starts[:, None] + np.arange(length)
    spectrum_u, spectrum_y = (
        np.fft.rfft((one[pieces] - one[pieces].mean(axis=1, keepdims=True)) * taper)[:, 1:] for one in (u, y)
    )
    p_uu = (abs(spectrum_u) ** 2).mean(axis=0)
    p_yy = (abs(spectrum_y) ** 2).mean(axis=0)
    p_uy = (spectrum_u.conj() * spectrum_y).mean(axis=0)
    # A doublet has exact zeros in its spectrum; there the response is unknown, not infinite.
    lit = p_uu > 1e-12 * p_uu.max()
    response = np.divide(p_uy, p_uu, out=np.zeros_like(p_uy), where=lit)
    power = p_uu * p_yy
    coherence = np.divide(abs(p_uy) ** 2, power, out=np.zeros_like(p_uu), where=lit & (power > 0.0))
    averages = _independent(taper, starts.size, length // 2)
    spread = np.sqrt(np.maximum(1.0 - coherence, 0.0) / (2.0 * averages))
    sigma = np.divide(
        abs(response) * spread, np.sqrt(coherence), out=np.full_like(p_uu, math.inf), where=coherence > 0.0
    )
    omega = np.asarray(2.0 * math.pi * np.fft.rfftfreq(length, dt)[1:], dtype=np.float64)
    return FrequencyResponse(
        input, output, omega, response, np.asarray(np.minimum(coherence, 1.0)), np.asarray(sigma), averages
    )


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
