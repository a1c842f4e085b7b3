"""Problem: the least squares of a fit, with the unknowns in x, residuals, Jacobian, prior and band."""

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.errors import IdentificationError, is_number, shown
from twodof.identify.covariance import ResidualRows
from twodof.identify.least_squares import LeastSquaresMinimum, minimise
from twodof.identify.record import Record
from twodof.identify.record_simulator import RecordSimulator
from twodof.models.structure import Structure, UnknownParameter

Array = NDArray[np.float64]

# Relative steps of the differences: the optimum for rounding errors of 1e-16, one-sided and two-sided.
_ONE_SIDED = 1e-7
_TWO_SIDED = 1e-5
# Distance of the points around a kink, in standard deviations, and most searches from one of them.
_NEAR = 0.2
_TURNS = 5


@dataclass(frozen=True)
class FreeUnknown:
    """One entry of x: an unknown, of one record or (`record` None) of all."""

    unknown: UnknownParameter
    record: int | None
    label: str


class Problem:
    """Weighted residuals (measured - simulated) / sigma of all outputs of all records as a function of x.

    `blocks` are the rows of each output of each record, and `sigma` their standard deviations, in the same order.
    Records differ: one flown with the rotors at rest has a tenth of the noise. `values` are first guesses or fixed
    values by unknown, or by "unknown[record]" for one record. `band` (low, high) [Hz] keeps only the discrete Fourier
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
        bounds: Mapping[str, tuple[float, float]] | None = None,
        separate: Collection[str] = (),
        band: tuple[float, float] | None = None,
        prior: Mapping[str, tuple[float, float]] | None = None,
    ) -> None:
        self.structure, self.records, self.band = structure, tuple(records), band
        limits, given = _checked_bounds(bounds or {}, structure), _checked_prior(prior or {}, structure)
        structure.check_names((*estimate, *(key.partition("[")[0] for key in values), *limits, *separate, *given))
        if wrong := [key for key, value in values.items() if not is_number(value)]:
            raise structure.error(f"the value of '{wrong[0]}' is {shown(values[wrong[0]])}", "give a finite number")
        low, high = (0.0, math.inf) if band is None else number_pair(band)
        if not low <= high:
            raise structure.error(f"the band is {shown(band)}", "give (from, to) in Hz")
        if len({record.name for record in self.records}) < max(1, len(self.records)):
            what = "two records have one name" if self.records else "no record is given"
            raise self.structure.error(what, "give at least one, each with a name of its own")
        unknowns = structure.unknowns
        guesses = {name: unknown.value for name, unknown in unknowns.items()}
        guesses |= {name: mean for name, (mean, deviation) in given.items() if math.isfinite(deviation)}
        self.slots = tuple(self._slots(estimate, separate))
        self._fixed = [
            {n: float(values.get(f"{n}[{record.name}]", values.get(n, guess))) for n, guess in guesses.items()}
            for record in self.records
        ]
        self._pick = [
            {slot.unknown.name: i for i, slot in enumerate(self.slots) if slot.record in (None, r)}
            for r in range(len(self.records))
        ]
        self.x0 = np.array([self._fixed[slot.record or 0][slot.unknown.name] for slot in self.slots])
        # Bounds narrow what the structure's parameter allows; beyond that it would refuse the value.
        own = [(s.unknown, *limits.get(s.unknown.name, (-math.inf, math.inf))) for s in self.slots]
        self.lower = np.array([max(low, unknown.lower) for unknown, low, _ in own])
        self.upper = np.array([min(high, unknown.upper) for unknown, _, high in own])
        self.scale = np.array([s.unknown.scale for s in self.slots])
        for slot, x, low, high in zip(self.slots, self.x0, self.lower, self.upper, strict=True):
            if not low <= x <= high:
                what = f"the first guess {x:g} of '{slot.label}' is not within {low:g} to {high:g}"
                raise self.structure.error(what, "give another guess or other bounds")
        names = [slot.unknown.name for slot in self.slots]
        known = {**structure.prior, **given}
        self.known = {n: one for n, one in known.items() if n in names and math.isfinite(one[1])}
        before = np.array([self.known.get(name, (0.0, math.inf)) for name in names]).reshape(-1, 2)
        self._mean, self._deviation = before.T
        self._slopes = np.diag(1.0 / self._deviation)[np.isfinite(self._deviation)]
        self._simulators = [RecordSimulator(structure, record) for record in self.records]
        for simulator, fixed in zip(self._simulators, self._fixed, strict=True):
            simulator.run(fixed)
        self._bands: list[Band | None] = []
        self.blocks = tuple(self._blocks())
        own_blocks = [[k for k, block in enumerate(self.blocks) if block.record == r] for r in range(len(self.records))]
        self._of_record = [
            (own, slice(self.blocks[own[0]].rows.start, self.blocks[own[-1]].rows.stop)) for own in own_blocks
        ]
        flights = [(self._flight(block), block.output) for block in self.blocks]
        self.noises = tuple(
            tuple(k for k, other in enumerate(flights) if other == one) for one in dict.fromkeys(flights)
        )
        # A first weight: the signal's own standard deviation.
        self.sigma = np.ones(len(self.blocks))
        for noise in self.noises:
            self.sigma[list(noise)] = float(np.concatenate([self.measured(k) for k in noise]).std()) or 1.0

    @property
    def outputs(self) -> tuple[str, ...]:
        """Outputs that at least one record has measured, in the structure's order."""
        measured = {block.output for block in self.blocks}
        return tuple(name for name in self.structure.outputs if name in measured)

    def measured(self, block: int) -> Array:
        """Return the measured samples of a block."""
        return self.records[self.blocks[block].record].outputs[self.blocks[block].output].value

    def set_noise(self, noise: Mapping[str, float]) -> set[int]:
        """Fix sigma by output or "output[record]"; returns the blocks. Raises IdentificationError for others."""
        fixed = set()
        for name, sigma in noise.items():
            of = [k for k, one in enumerate(self.blocks) if name in (one.output, self._named(one, in_full=True))]
            if not of or not (math.isfinite(sigma) and sigma > 0.0):
                what = f"noise {sigma} for '{name}' is not a positive number for a measured output"
                raise self.structure.error(what, f"measured outputs: {', '.join(self.outputs)}")
            self.sigma[of] = sigma
            fixed.update(of)
        return fixed

    def noise(self) -> dict[str, float]:
        """Return sigma by output, or by "output[record]" if there are several records."""
        several = len(self.records) > 1
        return {self._named(one, several): s for one, s in zip(self.blocks, self.sigma.tolist(), strict=True)}

    def noise_label(self, noise: int) -> str:
        """Return the name of `noises[noise]`: its output, or "output[flight]" if there are several flights."""
        block = self.blocks[self.noises[noise][0]]
        several = len({self._flight(one) for one in self.blocks}) > 1
        return f"{block.output}[{self._flight(block)}]" if several else block.output

    def _named(self, block: ResidualRows, in_full: bool) -> str:
        return f"{block.output}[{self.records[block.record].name}]" if in_full else block.output

    def _flight(self, block: ResidualRows) -> str:
        return self.records[block.record].flight or self.records[block.record].name

    def values(self, x: Array, record: int) -> dict[str, float]:
        """Every parameter's value in one record."""
        return self._fixed[record] | {name: float(x[i]) for name, i in self._pick[record].items()}

    def simulate(self, x: Array, record: int) -> dict[str, Array]:
        """Each measured output of one record at its samples' times."""
        plain = x.tolist()
        return self._simulators[record].run({name: plain[i] for name, i in self._pick[record].items()})

    def minimise(
        self, x: Array, whiten: Callable[[Array], Array] | None = None, tolerance: float = 1e-10
    ) -> LeastSquaresMinimum:
        """Search the least squares from `x` on; `whiten` takes a known noise out of residual and Jacobian.

        Dry friction makes kinks, where the derivatives promise a decrease that no step gives. There the search goes on
        from a better point at `_NEAR` along the axes of the confidence region, and has converged if there is none.
        """

        def residual(x: Array) -> Array:
            return self.residual(x) if whiten is None else whiten(self.residual(x))

        def jacobian(x: Array, known: Array) -> Array:
            return self.jacobian(x, known) if whiten is None else whiten(self.jacobian(x, self.residual(x)))

        found = minimise(residual, jacobian, x, self.lower, self.upper, tolerance=tolerance)
        for _ in range(_TURNS):
            if found.converged or not np.isfinite(slopes := jacobian(found.x, found.residual)).all():
                break
            _, reach, axes = np.linalg.svd(slopes, full_matrices=False)
            if not reach[-1] > 0.0:
                break
            steps = _NEAR * math.sqrt(2.0 * found.cost / found.residual.size) * axes / reach[:, None]
            around = np.clip(found.x + np.concatenate([steps, -steps]), self.lower, self.upper)
            costs = [0.5 * float(r @ r) for r in map(residual, around)]
            better = int(np.argmin(costs))
            if not costs[better] < found.cost:
                return replace(found, converged=True)
            found = minimise(residual, jacobian, around[better], self.lower, self.upper, tolerance=tolerance)
        return found

    def residual(self, x: Array) -> Array:
        """Return the weighted residuals of all records, and how far x is from what was known before."""
        own = [self._rows(x, r) for r in range(len(self.records))]
        before = ((x - self._mean) / self._deviation)[np.isfinite(self._deviation)]
        return _joined([*own, before] if before.size else own)

    @property
    def size(self) -> int:
        """Number of rows of the data, those of the prior left out."""
        return int(self.blocks[-1].rows.stop)

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
            up, down = x.copy(), x.copy()
            up[i], down[i] = high[i], low[i]
            for r, (_, span) in enumerate(self._of_record):
                if slot.record in (None, r):
                    before = self._rows(down, r) if residual is None else residual[span]
                    np.subtract(self._rows(up, r), before, out=columns[i, span])
        columns /= (high - low)[:, None]
        return np.hstack([columns, self._slopes.T]).T if len(self._slopes) else columns.T

    def _rows(self, x: Array, record: int) -> Array:
        simulated, rows = self.simulate(x, record), []
        for k in self._of_record[record][0]:
            error, band = self.measured(k) - simulated[self.blocks[k].output], self._bands[k]
            rows.append((error if band is None else band.coefficients(error)) / self.sigma[k])
        return _joined(rows)

    def _blocks(self) -> Iterator[ResidualRows]:
        start = 0
        for r, simulator in enumerate(self._simulators):
            for output in simulator.outputs:
                samples, band = self.records[r].outputs[output], None
                when = np.floor(samples.position).astype(np.int64)
                if self.band is not None:
                    where = f"record '{self.records[r].name}', output '{output}'"
                    band = Band(self.band, samples.position, self.records[r].dt, where)
                    when = np.concatenate([band.bins, band.bins])
                self._bands.append(band)
                yield ResidualRows(r, output, slice(start, start + when.size), when)
                start += when.size

    def _slots(self, estimate: Collection[str], separate: Collection[str]) -> Iterator[FreeUnknown]:
        unknowns = self.structure.unknowns
        # In the order asked for; a set has none.
        for name in dict.fromkeys(estimate if isinstance(estimate, Sequence) else sorted(estimate)):
            unknown = unknowns[name]
            if not (unknown.local or name in separate):
                yield FreeUnknown(unknown, None, name)
            elif len(self.records) == 1:
                yield FreeUnknown(unknown, 0, name)
            else:
                for r, record in enumerate(self.records):
                    yield FreeUnknown(unknown, r, f"{name}[{record.name}]")


def _joined(parts: Sequence[Array]) -> Array:
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def number_pair(given: Any) -> tuple[float, float]:
    """Return two numbers, which may be infinite, as they are given, or NaN twice for anything else."""
    pair = tuple(given) if isinstance(given, Iterable) else ()
    if len(pair) != 2 or not all(is_number(one, -math.inf, math.inf) for one in pair):
        return math.nan, math.nan
    return float(pair[0]), float(pair[1])


def _checked_bounds(bounds: Mapping[str, Sequence[float]], structure: Structure) -> dict[str, tuple[float, float]]:
    """Return the bounds as numbers, the lower one first; either may be infinite."""
    found = {name: number_pair(given) for name, given in bounds.items()}
    if wrong := [name for name, (low, high) in found.items() if not low <= high]:
        raise structure.error(f"the bounds of '{wrong[0]}' are {shown(bounds[wrong[0]])}", "give (lower, upper)")
    return found


def _checked_prior(prior: Mapping[str, Sequence[float]], structure: Structure) -> dict[str, tuple[float, float]]:
    """Return the prior as numbers. A standard deviation may be infinite: then nothing is known."""
    found = {}
    for name, given in prior.items():
        mean, deviation = number_pair(given)
        if not (math.isfinite(mean) and deviation > 0.0):
            raise structure.error(
                f"the prior of '{name}' is {given!r:.80}", "give (mean, standard deviation), the latter above 0"
            )
        found[name] = (mean, deviation)
    return found


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
            what = f"no Fourier coefficient lies in {band[0]:g} to {band[1]:g} Hz"
            raise IdentificationError(what, where, f"the resolution is {1.0 / (interval * self._size):g} Hz")

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
    what = "the frequency domain needs samples on a uniform clock, of which at most single ones are lost, one in ten"
    raise IdentificationError(what, where, "fit in the time domain, or resample the log first")
