"""How the control loop keeps its time."""

from __future__ import annotations

from dataclasses import dataclass

WINDOW = 250
"""Steps that the figures are of: a second."""


@dataclass(slots=True)
class LoopTiming:
    """Counts since the start, and figures [us] of the last whole second.

    `overruns` are steps whose processor time was beyond the period, `missed` periods that were left out because the
    loop came too late to make up for them. `step_mean` and `step_worst` are the processor time of a step, `late_worst`
    is how long after it was due a step began. In lockstep nothing is late and nothing is measured.
    """

    overruns: int = 0
    missed: int = 0
    step_mean: float = 0.0
    step_worst: float = 0.0
    late_worst: float = 0.0
    _steps: int = 0
    _used: int = 0
    _worst: int = 0
    _late: int = 0

    def stepped(self, used: int, budget: int) -> bool:
        """A step used so much processor time [ns]; says whether that is beyond its budget."""
        self._steps += 1
        self._used += used
        self._worst = max(self._worst, used)
        over = used > budget
        self.overruns += over
        if self._steps == WINDOW:
            self.step_mean, self.step_worst = self._used * 1e-3 / WINDOW, self._worst * 1e-3
            self.late_worst = self._late * 1e-3
            self._steps = self._used = self._worst = self._late = 0
        return over

    def began(self, late: int) -> None:
        """A step began this long [ns] after it was due."""
        self._late = max(self._late, late)
