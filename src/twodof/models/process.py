"""Process models: a gain, up to three lags, a zero, an integrator and a dead time, as industry describes its plants.

K (1 + Tz s) exp(-Td s) / (s (1 + T1 s) (1 + T2 s) (1 + T3 s)), each part if there is one. Ljung, System Identification,
section 4.2 (models in continuous time); names as in MATLAB's `idproc`: P1D, P2DZ, P2DUZ, P1ID.
"""

import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.declarations import Param, Port
from twodof.errors import IdentificationError, shown
from twodof.models.structure import Structure
from twodof.models.structures import about_trim
from twodof.models.zero_order_hold import Matrix, ZohPlant

Array = NDArray[np.float64]

_FORM = re.compile(r"P([0-3])([DZIU]*)")
RING = 64
"""Least steps of the data that a dead time reaches, plus 2."""
_LAGS, _DEAD, _JUMPS, _DEAD_SHARE = 20, 12, 200, 0.3
"""Time constants and dead times that are tried for a first guess; longest dead time as a share of the record."""


class ProcessPlant(ZohPlant):
    """The plant of a process model: one lag after the other, then the integrator, all driven by a held input."""

    def __init__(self, lags: int, letters: str, input: str, output: str, ring: int = RING) -> None:
        self.lags, self.letters = lags, letters
        self.plant_inputs, self.plant_delays = (Port(input),), {input: "Td"}
        self.plant_outputs = ((output, ""),)
        chain = [f"x{i + 1}" for i in range(lags + ("I" in letters))]
        self.plant_states = tuple((name, "") for name in chain)
        pair = "U" in letters
        self.times = [f"T{i + 1}" for i in range(2 if pair else 0, lags)]
        self.plant_params = (
            Param("K", 1.0, text="gain"),
            *([Param("Tw", 1.0, unit="s", low=1e-6, text="1 / natural frequency")] if pair else []),
            *([Param("zeta", 0.5, low=0.0, text="damping ratio")] if pair else []),
            *(Param(name, 1.0, unit="s", low=1e-6, text="time constant") for name in self.times),
            *([Param("Tz", 0.0, unit="s", text="time constant of the zero")] if "Z" in letters else []),
        )
        super().__init__(ring)

    def matrices(self, p: Any) -> tuple[Matrix, Matrix]:
        """Return A and B: each lag is driven by the one before, the first by the input."""
        n = len(self.plant_states)
        a: list[list[Any]] = [[0.0] * n for _ in range(n)]
        b: list[Any] = [0.0] * n
        first = 0
        if "U" in self.letters:
            rate = 1.0 / p.Tw  # the second state is Tw times the speed of the first: both are of one size
            a[0][1], a[1][0], a[1][1], b[1] = rate, -rate, -2.0 * p.zeta * rate, rate
            first = 2
        for i in range(first, n):
            rate = 1.0 / p[self.times[i - first]] if i < self.lags else 1.0
            a[i][i] = -rate if i < self.lags else 0.0
            source = 0 if i == 2 and first == 2 else i - 1
            if i == 0:
                b[0] = rate
            else:
                a[i][source] = rate
        return a, [[one] for one in b]

    def readout(self, p: Any) -> tuple[Matrix, Matrix]:
        """Return K (x + Tz x') of the last state."""
        a, b = self.matrices(p)
        last = 0 if "U" in self.letters and len(a) == 2 else len(a) - 1
        zero = p.Tz if "Z" in self.letters else 0.0
        row = [p.K * ((1.0 if j == last else 0.0) + zero * value) for j, value in enumerate(a[last])]
        (driven,) = b[last]
        return [row], [[0.0 if isinstance(driven, float) and driven == 0.0 else p.K * zero * driven]]


def process(form: str, *, input: str = "u", output: str = "y", ring: int = RING) -> Structure:
    """Make the process model `form`: P and the number of lags, then D (dead time Td), Z (zero), I, U (complex pair).

    A fit begins at the best of a grid of equal lags and dead times, and lets the dead time become twice as long.
    Without a fit it reaches `ring` - 2 steps. `output`_bias and `input`_trim are 0 unless estimated. Raises
    IdentificationError for another form, for U with under two lags, and for a model without any dynamics.
    """
    found = _FORM.fullmatch(form)
    lags, letters = (int(found[1]), found[2]) if found else (0, "")
    if (
        found is None
        or len(set(letters)) < len(letters)
        or lags + ("I" in letters) == 0
        or ("U" in letters and lags < 2)
    ):
        raise IdentificationError(
            f"no process model is called {shown(form)}", "process", "write P1, P1D, P2DZ, P2DU, P1ID"
        )
    plant = ProcessPlant(lags, letters, input, output, ring)
    names = [param.name for param in plant.plant_params]
    starts = [f"{name}_0" for name, _ in plant.plant_states]
    estimate = [*names, *(["Td"] if "D" in letters else []), *starts]

    def begin(u: Array, y: Array, dt: float) -> Structure:
        found = _guess(lags, letters, u, y, dt)
        own = process(form, input=input, output=output, ring=max(ring, 2 * round(found.get("Td", 0.0) / dt) + 16))
        size = float(np.abs(u).max()) or 1.0
        return replace(own, scale=dict.fromkeys(starts, size)).with_guess(**found)

    return about_trim(f"process_{form}", "process model", plant, estimate, ring=ring, longest=math.inf, begin=begin)


def _guess(lags: int, letters: str, u: Array, y: Array, dt: float) -> dict[str, float]:
    """Return the unknowns of the best of a grid: gain, zero and a level at the start are linear in the output.

    A zero behind one lag jumps with its input, and a dead time is then found only from within a step of it.
    """
    from scipy.signal import lfilter  # imported late: most commands start without it

    best, found = math.inf, {}
    whole = dt * u.size
    longest = max(2.0, _DEAD_SHARE * u.size)
    jumps = lags == 1 and "Z" in letters
    tried = np.linspace(1.0, longest, min(int(longest), _JUMPS)) if jumps else np.geomspace(1.0, longest, _DEAD)
    late = sorted({0, *tried.astype(int).tolist()}) if "D" in letters else [0]
    for lag in np.geomspace(dt, whole, _LAGS) if lags else [dt]:
        share = math.exp(-dt / lag)
        x = u - u[0]
        before = x
        for _ in range(lags):
            before, x = x, lfilter([0.0, 1.0 - share], [1.0, -share], x)
        slope = (before - x) / lag
        if "I" in letters:
            slope, x = x, dt * np.append(0.0, np.cumsum(x)[:-1])
        moving = np.array([x, slope] if "Z" in letters else [x])
        still = [np.ones(x.size), *([dt * np.arange(x.size)] if "I" in letters else [])]
        for steps in late:
            moved = np.hstack([np.zeros((len(moving), steps)), moving[:, : x.size - steps]])
            table = np.column_stack([*moved, *still])
            told = np.linalg.lstsq(table, y, rcond=None)[0]
            rest = float(np.sum((y - table @ told) ** 2))
            if rest < best and told[0] != 0.0:
                best, found = rest, {"K": float(told[0]), "T": float(lag), "Td": max(steps, 0.5) * dt}
                found |= {"Tz": float(told[1] / told[0])} if "Z" in letters else {}
    if not found:
        return {}
    # Lags of different lengths: equal ones have equal effects.
    lag = found.pop("T")
    found |= {"Tw": lag, "zeta": 0.7} if "U" in letters else {}
    kept = {f"T{i + 1}": lag * 1.5 ** (1 - i) for i in range(lags)}
    found |= {name: one for name, one in kept.items() if "U" not in letters or name == "T3"}
    return found if "D" in letters else {name: one for name, one in found.items() if name != "Td"}
