"""What a test found: for each assertion whether it holds, and otherwise when and by how much it does not."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Judgement:
    """One assertion, judged. `text` says what was found.

    Where it does not hold, `tick`, `time` [s] and `value` are those of the first violation. `limit` is what the value
    passed, and `by` how far (NaN for a value that is NaN). They are None for an assertion that holds.
    """

    check: str
    signal: str
    passed: bool
    text: str
    tick: int | None = None
    time: float | None = None
    value: float | None = None
    limit: float | None = None
    by: float | None = None


@dataclass(frozen=True, eq=False)
class ScenarioResult:
    """One scenario, run. `time` [s] is of shape (n,), and so are `signals`; the axes of an array follow.

    `expected` are times [s] and values, of shape (m,), that a table expects, by the judgement's `check`.
    """

    name: str
    judgements: tuple[Judgement, ...]
    time: NDArray[np.float64]
    signals: Mapping[str, NDArray[Any]]
    expected: Mapping[str, tuple[NDArray[np.float64], NDArray[np.float64]]] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        """Whether all its assertions hold."""
        return all(j.passed for j in self.judgements)

    @property
    def failed(self) -> tuple[Judgement, ...]:
        """Those that do not hold."""
        return tuple(j for j in self.judgements if not j.passed)

    def __str__(self) -> str:
        """What does not hold, a line each: what pytest shows for `assert result.passed, result`."""
        lines = [f"{self.name}: {j.check}: {j.text}" for j in self.failed]
        return "\n".join(lines) or f"{self.name}: all {len(self.judgements)} assertions hold"


def first_violation(
    check: str,
    signal: str,
    values: NDArray[np.float64],
    limits: NDArray[np.float64],
    wrong: NDArray[np.int64],
    dt: float,
) -> Judgement:
    """The judgement of an assertion that the ticks `wrong` (some) violate; `limits` is what each value passed there.

    `values` and `limits` hold one number for each of those ticks.
    """
    with np.errstate(over="ignore"):
        by = np.abs(values - limits)
    first, worst = 0, int(np.argmax(np.where(np.isnan(by), np.inf, by)))

    def at(i: int) -> str:
        value, limit = float(values[i]), float(limits[i])
        side = "is not" if np.isnan(value) else "is above" if value > limit else "is below"
        return f"{value:.6g} at {wrong[i] * dt:.6g} s {side} {limit:.6g}" + (
            "" if np.isnan(by[i]) else f" by {by[i]:.3g}"
        )

    text = at(first)
    if len(wrong) > 1:
        text += f"; {len(wrong)} ticks in all" + ("" if worst == first else f", the worst: {at(worst)}")
    tick = int(wrong[first])
    return Judgement(
        check, signal, False, text, tick, tick * dt, float(values[first]), float(limits[first]), float(by[first])
    )
