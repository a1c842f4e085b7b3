"""Problem: the least squares of a fit, with the unknowns in x, residuals, Jacobian, prior and band."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twodof.errors import IdentificationError
from twodof.identify.covariance import ResidualRows
from twodof.identify.record import Record
from twodof.identify.record_simulator import RecordSimulator
from twodof.models.structure import Structure, UnknownParameter

Array = NDArray[np.float64]

# Relative steps of the differences: the optimum for rounding errors of 1e-16, one-sided and two-sided.
_ONE_SIDED = 1e-7
_TWO_SIDED = 1e-5


@dataclass(frozen=True)
class FreeUnknown:
    """One entry of x: an unknown, of one record or (`record` None) of all."""

    unknown: UnknownParameter
    record: int | None
    label: str


class Problem:
    """Weighted residuals (measured - simulated) / sigma of all outputs of all records as a function of x.

    `sigma` holds the standard deviation of each output of each record, by (index of the record, output). Records
    differ: one flown with the rotors at rest has a tenth of the noise. `values` are first guesses or fixed values by
    unknown, or by "unknown[record]" for one record. `band` (low, high) [Hz] keeps only the discrete Fourier
    coefficients of the residuals inside it. They are scaled so that white noise of standard deviation sigma still gives
    rows of standard deviation 1. `prior` holds (mean, standard deviation) of unknowns that are known from elsewhere,
    beside those that the structure has. Each is one more row, behind those of the data. `noises` has the blocks of each
    noise, by their number: an output has one in each flight, of which a record may be a piece.
    """

    def __init__(
        self,
        structure: Structure,
        records: Sequence[Record],
        estimate: Collection[str],
        values: Mapping[str, float],
        bounds: Mapping[str, tuple[float, float]],
        separate: Collection[str] = (),
        band: tuple[float, float] | None = None,
        prior: Mapping[str, tuple[float, float]] | None = None,
    ) -> None:
        self.structure, self.records, self.band = structure, tuple(records), band
        self._check(estimate, values, bounds, separate)
        unknowns = structure.unknowns
        given = dict(prior or {})
        check_prior(given, tuple(unknowns), f"structure '{structure.name}'")
        guesses = {name: unknown.value for name, unknown in unknowns.items()}
        guesses |= {name: mean for name, (mean, deviation) in given.items() if math.isfinite(deviation)}
        self.slots = tuple(_slots(unknowns, self.records, estimate, separate))
        self._fixed = [
            {
                name: float(values.get(f"{name}[{record.name}]", values.get(name, guess)))
                for name, guess in guesses.items()
            }
            for record in self.records
        ]
        self._pick = [
            {slot.unknown.name: i for i, slot in enumerate(self.slots) if slot.record in (None, r)}
            for r in range(len(self.records))
        ]
        self.x0 = np.array([self._fixed[slot.record or 0][slot.unknown.name] for slot in self.slots])
        # Bounds narrow what the structure's parameter allows; beyond that it would refuse the value.
        limits = [bounds.get(s.unknown.name, (-math.inf, math.inf)) for s in self.slots]
        self.lower = np.array([max(b[0], s.unknown.lower) for b, s in zip(limits, self.slots, strict=True)])
        self.upper = np.array([min(b[1], s.unknown.upper) for b, s in zip(limits, self.slots, strict=True)])
        self.scale = np.array([s.unknown.scale for s in self.slots])
        self.known = {
            name: one
            for name, one in {**structure.prior, **given}.items()
            if math.isfinite(one[1]) and any(slot.unknown.name == name for slot in self.slots)
        }
        places = [(i, self.known[s.unknown.name]) for i, s in enumerate(self.slots) if s.unknown.name in self.known]
        self.prior = Prior(places, len(self.slots))
        self._refuse_impossible()
        self._simulators = [RecordSimulator(structure, record) for record in self.records]
        for simulator, fixed in zip(self._simulators, self._fixed, strict=True):
            simulator.run(fixed)
        self._bands: dict[tuple[int, str], Band] = {}
        self.blocks = tuple(self._blocks())
        own = [[block.rows for block in self.blocks if block.record == r] for r in range(len(self.records))]
        self._spans = [slice(rows[0].start, rows[-1].stop) for rows in own]
        groups: dict[tuple[str, str], list[int]] = {}
        for k, block in enumerate(self.blocks):
            groups.setdefault((self._flight(block.record), block.output), []).append(k)
        self.noises = tuple(tuple(group) for group in groups.values())
        # A first weight: the signal's own standard deviation.
        self.sigma = {(block.record, block.output): 1.0 for block in self.blocks}
        for group in self.noises:
            keys = [(self.blocks[k].record, self.blocks[k].output) for k in group]
            measured = np.concatenate([self.records[r].outputs[o].value for r, o in keys])
            self.sigma |= dict.fromkeys(keys, float(measured.std()) or 1.0)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Outputs that at least one record has measured, in the structure's order."""
        measured = {block.output for block in self.blocks}
        return tuple(name for name in self.structure.outputs if name in measured)

    def set_noise(self, noise: Mapping[str, float]) -> set[tuple[int, str]]:
        """Fix sigma by output or "output[record]"; returns what was fixed. Raises IdentificationError for others."""
        fixed = set()
        for name, sigma in noise.items():
            keys = [(r, o) for r, o in self.sigma if name in (o, f"{o}[{self.records[r].name}]")]
            if not keys or not (math.isfinite(sigma) and sigma > 0.0):
                raise IdentificationError(
                    f"noise {sigma} for '{name}' is not a positive number for a measured output",
                    f"structure '{self.structure.name}'",
                    f"measured outputs: {', '.join(self.outputs)}",
                )
            for key in keys:
                self.sigma[key] = sigma
            fixed.update(keys)
        return fixed

    def noise(self) -> dict[str, float]:
        """Return sigma by output, or by "output[record]" if there are several records."""
        several = len(self.records) > 1
        return {(f"{o}[{self.records[r].name}]" if several else o): s for (r, o), s in self.sigma.items()}

    def noise_label(self, noise: int) -> str:
        """Return the name of `noises[noise]`: its output, or "output[flight]" if there are several flights."""
        block = self.blocks[self.noises[noise][0]]
        several = len({self._flight(one.record) for one in self.blocks}) > 1
        return f"{block.output}[{self._flight(block.record)}]" if several else block.output

    def _flight(self, record: int) -> str:
        return self.records[record].flight or self.records[record].name

    def values(self, x: Array, record: int) -> dict[str, float]:
        """Every parameter's value in one record."""
        return self._fixed[record] | {name: float(x[i]) for name, i in self._pick[record].items()}

    def simulate(self, x: Array, record: int) -> dict[str, Array]:
        """Each measured output of one record at its samples' times."""
        plain = x.tolist()
        return self._simulators[record].run({name: plain[i] for name, i in self._pick[record].items()})

    def residual(self, x: Array) -> Array:
        """Return the weighted residuals of all records, and how far x is from what was known before."""
        own = [self._rows(x, r) for r in range(len(self.records))]
        return _joined([*own, self.prior.rows(x)] if len(self.prior) else own)

    @property
    def size(self) -> int:
        """Number of rows of the data, those of the prior left out."""
        return int(self._spans[-1].stop)

    def jacobian(self, x: Array, residual: Array) -> Array:
        """One-sided differences of the residual; an unknown of one record re-simulates only that record."""
        step = _ONE_SIDED * np.maximum(np.abs(x), self.scale)
        return self._differences(x, x + np.where(x + step > self.upper, -step, step), x, residual)

    def central_jacobian(self, x: Array) -> Array:
        """Two-sided differences, one-sided where a bound leaves no room: for statistics, at the end of a fit."""
        step = _TWO_SIDED * np.maximum(np.abs(x), self.scale)
        return self._differences(x, np.minimum(x + step, self.upper), np.maximum(x - step, self.lower))

    def _differences(self, x: Array, high: Array, low: Array, residual: Array | None = None) -> Array:
        """(residual at `high` - that at `low`) / (high - low), unknown by unknown; `residual` is that at x = `low`."""
        columns = np.zeros((x.size, self.size))
        for i, slot in enumerate(self.slots):
            up = x.copy()
            up[i] = high[i]
            for r, span in enumerate(self._spans):
                if slot.record not in (None, r):
                    continue
                if residual is None:
                    down = x.copy()
                    down[i] = low[i]
                    columns[i, span] = self._rows(up, r) - self._rows(down, r)
                else:
                    np.subtract(self._rows(up, r), residual[span], out=columns[i, span])
        columns /= (high - low)[:, None]
        return np.hstack([columns, self.prior.slopes.T]).T if len(self.prior) else columns.T

    def _rows(self, x: Array, record: int) -> Array:
        simulated = self.simulate(x, record)
        measured = self.records[record].outputs
        return _joined(
            [
                self._banded(measured[name].value - simulated[name], record, name) / self.sigma[record, name]
                for name in self._simulators[record].outputs
            ]
        )

    def _banded(self, error: Array, record: int, output: str) -> Array:
        return error if self.band is None else self._bands[record, output].coefficients(error)

    def _blocks(self) -> list[ResidualRows]:
        blocks, start = [], 0
        for r, simulator in enumerate(self._simulators):
            for output in simulator.outputs:
                samples = self.records[r].outputs[output]
                when = np.floor(samples.position).astype(np.int64)
                if self.band is not None:
                    where = f"record '{self.records[r].name}', output '{output}'"
                    self._bands[r, output] = band = Band(self.band, samples.position, self.records[r].dt, where)
                    when = np.concatenate([band.bins, band.bins])
                blocks.append(ResidualRows(r, output, slice(start, start + when.size), when))
                start += when.size
        return blocks

    def _check(
        self,
        estimate: Collection[str],
        values: Mapping[str, float],
        bounds: Mapping[str, tuple[float, float]],
        separate: Collection[str],
    ) -> None:
        if not self.records:
            raise IdentificationError("no record is given", f"structure '{self.structure.name}'", "give at least one")
        names = [record.name for record in self.records]
        if len(set(names)) < len(names):
            raise IdentificationError("two records have one name", ", ".join(names), "name each differently")
        known = self.structure.unknowns
        keyed = [key.partition("[")[0] for key in values]
        for name in (*estimate, *keyed, *bounds, *separate):
            if name not in known:
                raise IdentificationError(
                    f"no unknown is called '{name}'",
                    f"structure '{self.structure.name}'",
                    f"there are: {', '.join(known)}",
                )

    def _refuse_impossible(self) -> None:
        for slot, x, low, high in zip(self.slots, self.x0, self.lower, self.upper, strict=True):
            if not low <= x <= high:
                raise IdentificationError(
                    f"the first guess {x:g} of '{slot.label}' is not within {low:g} to {high:g}",
                    f"structure '{self.structure.name}'",
                    "give another guess or other bounds",
                )


def _joined(parts: Sequence[Array]) -> Array:
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _slots(
    unknowns: Mapping[str, UnknownParameter],
    records: Sequence[Record],
    estimate: Collection[str],
    separate: Collection[str],
) -> list[FreeUnknown]:
    slots = []
    # In the order asked for; a set has none.
    for name in dict.fromkeys(estimate if isinstance(estimate, Sequence) else sorted(estimate)):
        unknown = unknowns[name]
        if not (unknown.local or name in separate):
            slots.append(FreeUnknown(unknown, None, name))
        elif len(records) == 1:
            slots.append(FreeUnknown(unknown, 0, name))
        else:
            slots.extend(FreeUnknown(unknown, r, f"{name}[{record.name}]") for r, record in enumerate(records))
    return slots


class Prior:
    """Normal distributions of some entries of x: each is one more row, (x - mean) / deviation.

    `places` are the entries, each with its (mean, standard deviation).
    """

    def __init__(self, places: Sequence[tuple[int, tuple[float, float]]], size: int) -> None:
        self.index = np.array([place for place, _ in places], dtype=np.int64)
        self.mean = np.array([mean for _, (mean, _) in places])
        self.deviation = np.array([deviation for _, (_, deviation) in places])
        self.slopes = np.zeros((len(places), size))
        self.slopes[np.arange(len(places)), self.index] = 1.0 / self.deviation

    def __len__(self) -> int:
        return self.index.size

    def rows(self, x: Array) -> Array:
        """How far x is from what was known, in standard deviations."""
        return np.asarray((x[self.index] - self.mean) / self.deviation)


def check_prior(prior: Mapping[str, tuple[float, float]], unknowns: Sequence[str], where: str) -> None:
    """Check a prior: raise IdentificationError for an unknown name, and for a missing mean or standard deviation.

    A standard deviation may be infinite: then nothing is known.
    """
    for name, given in prior.items():
        if name not in unknowns:
            raise IdentificationError(f"no unknown is called '{name}'", where, f"there are: {', '.join(unknowns)}")
        try:
            mean, deviation = (float(one) for one in given)
            right = math.isfinite(mean) and deviation > 0.0
        except (TypeError, ValueError):
            right = False
        if not right:
            raise IdentificationError(
                f"the prior of '{name}' is {given!r:.80}", where, "give (mean, standard deviation), the latter above 0"
            )


# Jitter of a tenth of the interval turns the phase at the highest frequency by 18 degrees, in a band by far less.
_JITTER = 0.1
_MOST_LOST = 0.1


class Band:
    """The discrete Fourier coefficients between two frequencies (`low`, `high`) [Hz] of samples at `position` [steps].

    `dt` [s] is the step. The samples are on a uniform clock, of which single ones may be lost, one in ten at most.
    `where` names record and output in errors. Raises IdentificationError for other gaps and for a band without any
    coefficient.
    """

    def __init__(self, band: tuple[float, float], position: Array, dt: float, where: str) -> None:
        self._number = _numbers(position, where)
        self._size = int(self._number[-1]) + 1
        interval = float(position[-1] - position[0]) / (self._size - 1) * dt
        frequency = np.fft.rfftfreq(self._size, interval)
        # The coefficients at 0 and at half the sampling rate are real: they would be rows of another variance.
        inner = (frequency > 0.0) & (frequency < 0.5 / interval * (1.0 - 1e-9))
        self.bins = np.flatnonzero((frequency >= band[0]) & (frequency <= band[1]) & inner)
        if self.bins.size == 0:
            raise IdentificationError(
                f"no Fourier coefficient lies in {band[0]:g} to {band[1]:g} Hz",
                where,
                f"the resolution is {1.0 / (interval * self._size):g} Hz",
            )

    def coefficients(self, error: Array) -> Array:
        """Real parts, then imaginary parts, shape (2 * bins,); white noise keeps its standard deviation.

        The error of a lost sample is taken as that between its neighbours.
        """
        if self._size > error.size:
            error = np.interp(np.arange(self._size), self._number, error)
        spectrum = np.fft.rfft(error)[self.bins] * math.sqrt(2.0 / self._size)
        return np.concatenate([spectrum.real, spectrum.imag])


def _numbers(position: Array, where: str) -> NDArray[np.int64]:
    """Return the number of each sample on the uniform clock, counting lost samples."""
    interval = np.diff(position)
    if interval.size:
        count = np.maximum(1.0, np.round(interval / np.median(interval)))
        number = np.concatenate([[0.0], np.cumsum(count)])
        usual = float(position[-1] - position[0]) / number[-1]
        lost = number[-1] + 1.0 - position.size
        even = np.abs(interval - count * usual).max() <= _JITTER * usual
        if even and count.max() <= 2.0 and lost <= _MOST_LOST * position.size:
            return number.astype(np.int64)
    raise IdentificationError(
        "the frequency domain needs samples on a uniform clock, of which at most single ones are lost, one in ten",
        where,
        "fit in the time domain, or resample the log first",
    )
