"""What a fit's notes name: data that look wrong, and changes with which the model would leave much less of them."""

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from twodof.errors import IdentificationError
from twodof.identify.disturbance.noise_search import Disturbed
from twodof.identify.estimate import Estimate
from twodof.identify.least_squares import LeastSquaresMinimum, minimise
from twodof.identify.problem import Problem
from twodof.identify.record import HOLDS, Record
from twodof.identify.validate import Comparison
from twodof.models.polynomial import PolynomialModel
from twodof.models.structure import Structure

Array = NDArray[np.float64]

_OFFSET = 5.0
"""Mean of a signal in its standard deviations above which it lies far from 0."""
_STILL_SHARE, _STILL_LEAST = 0.1, 20
"""Equal values in a row, as a share of an output and at least, that only a sensor that has stopped shows."""
_LIMITED, _LEAST_LIMITED = 0.02, 20
"""Share of an output's samples, and least number, at its largest or smallest value that only a limit makes."""
_BETTER = 0.8
"""Residual over the present one that makes a suggestion worth its words."""
_FAR_BETTER = 0.5
"""The same where the input seems to answer the output: feedback, too, makes a later input fit better."""
_ALIKE = 1.05
"""Residual of an offset over that of the best one, up to which both are named."""
_LONE, _BESIDE = 20.0, 0.5
"""Size of an outlier over the usual one, and the most of it that the samples beside it may reach."""
_TRIES, _TURNS = 20, 5
"""Steps of the search that tries a suggestion, and how often it looks for another delay."""
_TURN = {"rad": 2.0 * math.pi, "rad/s": 35.0}
"""A full turn, and the full scale of usual gyros, 2000 deg/s: no experiment comes there."""


def offsets(problem: Problem, wanted: Collection[str], poor: bool) -> Iterator[str]:
    """Yield the inputs and outputs far from 0 that no trim, bias or good fit accounts for."""
    structure = problem.structure
    bare = poor and not any(name.endswith(("_trim", "_bias")) for name in structure.unknowns)
    for r, record in enumerate(problem.records):
        held = problem.values(problem.x0, r)
        signals = [(name, f"{name}_trim", record.inputs[name]) for name in structure.inputs]
        signals += [(name, f"{name}_bias", record.outputs[name].value) for name in problem.outputs]
        if any(unknown in wanted or held.get(unknown) for _, unknown, _ in signals):
            continue
        far = [
            (f"{name} lies at {value.mean():.4g} +- {value.std():.2g}", unknown)
            for name, unknown, value in signals
            if 1e-12 < value.std() / max(abs(value.mean()), 1e-300) < 1.0 / _OFFSET
            and (bare or unknown in structure.unknowns)
        ]
        if far:
            remedies = [f"estimate {unknown} too" for _, unknown in far if unknown in structure.unknowns]
            yield (
                f"{' and '.join(text for text, _ in far)} in '{record.name}', far from 0, which the model does not "
                f"account for: {', or '.join([*remedies, 'subtract the means (`--detrend`, `record.detrend()`)'])}"
            )


def flaws(problem: Problem, found: Disturbed, poor: bool) -> Iterator[str]:
    """Yield what looks wrong in the signals themselves; of a `poor` fit also inputs that never move."""
    yield from _unmoved(problem) if poor else ()
    yield from _in_degrees(problem)
    yield from _standing_still(problem)
    yield from _limited(problem)
    yield from _outliers(problem, found)


def _in_degrees(problem: Problem) -> Iterator[str]:
    """Yield outputs too large to be in radians."""
    for k, block in enumerate(problem.blocks):
        bias, peak = problem.structure.unknowns.get(f"{block.output}_bias"), np.abs(problem.measured(k)).max()
        if bias is not None and peak > _TURN.get(bias.unit, math.inf):
            yield (
                f"{block.output} reaches {peak:.3g} {bias.unit} in '{problem.records[block.record].name}', more than "
                "such a machine does: if it is in degrees, multiply it by pi/180"
            )


def _standing_still(problem: Problem) -> Iterator[str]:
    """Yield the outputs that repeat one value for long although they move otherwise."""
    for k, block in enumerate(problem.blocks):
        moves = np.flatnonzero(np.diff(problem.measured(k), prepend=np.nan, append=np.nan) != 0.0)
        runs = np.diff(moves)
        longest = int(runs.argmax())
        size = block.rows.stop - block.rows.start
        # A coarse signal often repeats itself: this one moves at most samples besides.
        if runs[longest] >= max(_STILL_LEAST, _STILL_SHARE * size) and runs.size > 0.5 * (size - runs[longest]):
            record = problem.records[block.record]
            start, stop = record.output_time(block.output)[moves[longest] + np.array([0, runs[longest] - 1])]
            yield (
                f"{block.output} stands still from {start:.4g} to {stop:.4g} s in '{record.name}': if its sensor has "
                "stopped there, leave that stretch out (Record.part, --window)"
            )


def _limited(problem: Problem) -> Iterator[str]:
    """Yield the outputs that lie at their largest or smallest value again and again, although they move otherwise."""
    for k, block in enumerate(problem.blocks):
        value = problem.measured(k)
        ends = [end for end in (value.min(), value.max()) if np.sum(value == end) >= _LEAST_LIMITED]
        held = np.isin(value, ends)
        beside = value[~held]
        if held.mean() >= _LIMITED and beside.size > 1 and np.mean(np.diff(beside) != 0.0) > 0.5:
            yield (
                f"{block.output} lies at {' and '.join(f'{end:.4g}' for end in ends)} in {100.0 * held.mean():.0f} % "
                f"of '{problem.records[block.record].name}': if that is a limit, the structure needs it too; or excite "
                "it less"
            )


def _unmoved(problem: Problem) -> Iterator[str]:
    """Yield the inputs that have one value, not 0, in every record."""
    for name in problem.structure.inputs:
        if name not in problem.structure.measured and all(
            np.ptp(one.inputs[name]) == 0.0 and one.inputs[name][0] != 0.0 for one in problem.records
        ):
            yield (
                f"{name} never moves: beside a gain, what is found comes from how the start dies away. Take a record "
                f"in which {name} moves"
            )


def _outliers(problem: Problem, found: Disturbed) -> Iterator[str]:
    """Yield the single samples far off the model, and those of inputs far from all others."""
    own, x = found.predictor or (problem, found.minimum.x)
    residual = own.residual(x) if problem.band is None else np.zeros(0)
    signals = []
    for block in problem.blocks if residual.size else ():
        record = problem.records[block.record]
        signals.append((block.output, record, record.output_time(block.output), residual[block.rows], "off the model"))
    for record in problem.records:
        for name in problem.structure.inputs:
            value = record.inputs[name]
            signals.append((name, record, record.time, value - np.median(value), "from the others"))
    for name, record, time, value, off in signals:
        size = np.abs(value)
        usual = float(np.sqrt(np.mean(np.sort(size)[: int(0.99 * size.size)] ** 2))) if size.size > 1 else 0.0
        beside = np.maximum(np.append(size[1:], 0.0), np.append(0.0, size[:-1]))
        lone = np.flatnonzero((size > _LONE * usual) & (beside < _BESIDE * size)) if usual > 0.0 else ()
        if len(lone):
            most = lone[int(np.argmax(size[lone]))]
            more = f" ({len(lone)} samples are like this)" if len(lone) > 1 else ""
            yield (
                f"{name} at {time[most]:.6g} s in '{record.name}' is {size[most] / usual:.2g} times as far {off} as "
                f"usual{more}: if it is an outlier, leave its row out"
            )


def _lag(problem: Problem, x: Array) -> int:
    """Return by how many steps the outputs come later than the model's at x, where they correlate best."""
    from scipy.signal import correlate  # imported late: most commands start without it

    most = min(record.steps for record in problem.records) // 4
    total = np.zeros(2 * most + 1)
    simulated = [problem.simulate(x, r) for r in range(len(problem.records))]
    for k, block in enumerate(problem.blocks):
        record = problem.records[block.record]
        at, model = record.outputs[block.output].position, simulated[block.record][block.output]
        y, own = (np.interp(np.arange(record.steps), at, one - one.mean()) for one in (problem.measured(k), model))
        size = float(np.linalg.norm(y) * np.linalg.norm(own))
        if 0.0 < size < math.inf:
            total += correlate(y, own)[record.steps - 1 - most : record.steps + most] / size
    return int(np.argmax(total)) - most


def suggestions(
    problem: Problem,
    posed: Callable[[Sequence[Record], Mapping[str, float] | None], Problem],
    x: Array,
    poor: bool,
    answered: bool,
) -> Iterator[str]:
    """Yield the offset, the hold and the delay of inputs with which output error would leave much less of the data."""

    def tried(own: Problem) -> LeastSquaresMinimum:
        own.sigma[:] = problem.sigma
        start = np.append(x, own.x0[x.size :])
        return minimise(own.residual, own.jacobian, start, own.lower, own.upper, iterations=_TRIES)

    def left(own: Problem) -> float:
        cost = tried(own).cost
        return math.sqrt(2.0 * cost / own.size) if math.isfinite(cost) else math.inf

    structure, records, before = problem.structure, problem.records, left(problem)
    names = [f"{one}_bias" for one in problem.outputs] + [f"{one}_trim" for one in structure.inputs]
    free = {n for n in names if n in structure.unknowns and not problem.values(x, 0)[n]} - {
        s.unknown.name for s in problem.slots
    }
    found = {name: left(posed(records, {name: 0.0})) for name in names if name in free} if poor else {}
    best = min(found, key=lambda name: found[name], default="")
    if best and found[best] < _BETTER * before:
        alike = " or ".join(name for name, one in found.items() if one <= _ALIKE * found[best])
        yield f"with {alike} the residual falls to {found[best] / before:.2g} of itself: estimate it too"
    moving = [
        name
        for name in structure.inputs
        if name not in structure.measured
        and all(np.count_nonzero(np.diff(one.inputs[name])) > 0.5 * one.steps and not one.hold for one in records)
    ]
    held = {
        hold: left(posed([replace(one, hold=dict.fromkeys(moving, hold)) for one in records], None))
        for hold in HOLDS[1:]
        if moving
    }
    best = min(held, key=lambda hold: held[hold], default="")
    if best and held[best] < (_FAR_BETTER if answered else _BETTER) * before:
        yield (
            f"{' and '.join(moving)} may move on between samples: with hold='{best}' the residual falls to "
            f"{held[best] / before:.2g} of itself. Make the record with it (--hold {moving[0]}={best})"
        )
    late, own, there = 0, problem, x
    # A wrong delay has made the other unknowns wrong. The better ones tell the delay better.
    for _ in range(_TURNS if poor else 0):
        lag = _lag(own, there)
        if not lag or 2 * abs(late + lag) > records[0].steps:
            break
        late += lag
        own = posed([_later(one, -late) for one in records], None)
        there = tried(own).x
    if late and (share := left(own) / before) < _FAR_BETTER:
        when = f"{abs(late) * records[0].dt:.3g} s {'after' if late > 0 else 'before'}"
        yield (
            f"{' and '.join(structure.inputs)} may act about {when} the time stamps: with that the residual falls to "
            f"{share:.2g} of itself. Move the stamps{', or estimate a dead time' * (late > 0)}"
        )


def drift(
    refit: Callable[[Sequence[Record]], Estimate], records: Sequence[Record], compared: Sequence[Comparison]
) -> Iterator[str]:
    """Yield that the signals drift, where a fit without their straight lines leaves less than half of the residual."""
    level = [one.detrend(linear=True) for one in records]
    pairs = [
        (a.outputs[name].value, one.value)
        for a, b in zip(records, level, strict=True)
        for name, one in b.outputs.items()
    ]
    if all(np.abs(before - after).max() <= 1e-6 * after.std() for before, after in pairs):
        return
    try:
        found = refit(level)
    except IdentificationError:
        return
    share = max(two.rmse / one.rmse for one, two in zip(compared, found.identification, strict=True))
    if share < _FAR_BETTER:
        yield (
            f"the signals drift: without their straight lines the residual falls to {share:.2g} of itself. Take the "
            "lines away (`--detrend-line`, `record.detrend(linear=True)`)"
        )


def _later(record: Record, steps: int) -> Record:
    """Return the record with its outputs this much later than its inputs, as far as these are known."""
    outputs = {}
    for name, one in record.outputs.items():
        inside = (one.position + steps >= 0.0) & (one.position + steps <= record.steps - 1)
        outputs[name] = replace(one, position=one.position[inside] + steps, value=one.value[inside])
    return replace(record, outputs=outputs)


def gaps_of(structure: Structure | PolynomialModel, records: Sequence[Record]) -> Iterator[str]:
    """Where inputs of the structure were held although nobody knows what they did."""
    for record in records:
        for name in structure.inputs:
            if stretches := record.gaps.get(name, ()):
                a, b = max(stretches, key=lambda one: one[1] - one[0])
                yield (
                    f"{name} has {len(stretches)} gap{'s' if len(stretches) > 1 else ''} in '{record.name}', the "
                    f"longest of {1e3 * (b - a):.0f} ms at {a:.2f} s, and was held there"
                )
