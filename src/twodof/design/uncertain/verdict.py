"""Verdict: what a flight measured beside what was promised, channel by channel and figure by figure."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

CHANCE = 0.05
"""Steps outside are put down to chance as long as that many come by chance at least so often."""


@dataclass(frozen=True)
class Measured:
    """One step: `outside`, the share of its time that each channel was out of its band; its `figures`, and the
    intervals `promised` for them.
    """

    outside: Mapping[str, float]
    figures: Mapping[str, float]
    promised: Mapping[str, tuple[float, float]]

    def kept(self, name: str) -> bool:
        """Whether the channel or figure `name` was as promised."""
        if name in self.outside:
            return self.outside[name] == 0.0
        low, high = self.promised[name]
        return low <= self.figures[name] <= high


@dataclass(frozen=True)
class Verdict:
    """All `steps` of a flight, at least one, beside a promise at `level`."""

    level: float
    steps: tuple[Measured, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the channels, then of the figures."""
        return (*self.steps[0].outside, *self.steps[0].figures)

    def count(self, name: str) -> int:
        """In how many steps `name` was as promised."""
        return sum(step.kept(name) for step in self.steps)

    def kept(self, name: str) -> bool:
        """Whether the promise of `name` stands: no more steps broke it than chance explains."""
        n, broken = len(self.steps), len(self.steps) - self.count(name)
        rare = 1.0 - self.level
        tail = sum(math.comb(n, k) * rare**k * self.level ** (n - k) for k in range(broken, n + 1))
        return broken == 0 or tail > max(CHANCE, rare) + 1e-9

    @property
    def stands(self) -> bool:
        """Whether all of it was kept."""
        return all(self.kept(name) for name in self.names)

    def table(self) -> str:
        """Measured beside promised, as text for a terminal."""
        n = len(self.steps)
        lines = [f"{n} step{'s' * (n > 1)}, promised at {100.0 * self.level:g} %"]
        for name in self.names:
            word = "kept" if self.kept(name) else "BROKEN"
            lines.append(f"  {word:7}{name.replace('_', ' '):14}{self._said(name)}")
        return "\n".join(lines)

    def _said(self, name: str) -> str:
        inside = f"{self.count(name)} of {len(self.steps)}"
        first = self.steps[0]
        if name in first.outside:
            worst = max(step.outside[name] for step in self.steps)
            return f"{inside} inside the band" + (f", at worst {100.0 * worst:.0f} % outside" if worst else "")
        low, high = first.promised[name]
        seen = ", ".join(f"{step.figures[name]:.3g}" for step in self.steps)
        return f"{inside} within {low:.3g} to {high:.3g}: {seen}"

    def to_json(self) -> dict[str, Any]:
        """Plain data; a figure that is infinite is null."""
        return {
            "level": self.level,
            "stands": self.stands,
            "channels": {
                name: {"kept": self.kept(name), "outside": [step.outside[name] for step in self.steps]}
                for name in self.steps[0].outside
            },
            "figures": {
                name: {
                    "kept": self.kept(name),
                    "promised": [v if math.isfinite(v) else None for v in self.steps[0].promised[name]],
                    "measured": [v if math.isfinite(v := step.figures[name]) else None for step in self.steps],
                }
                for name in self.steps[0].figures
            },
        }
