"""How the control loop keeps its time."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(slots=True)
class Window:
    """Figures of a stretch of time [ns]."""

    steps: int = 0
    used: int = 0
    used_worst: int = 0
    late_worst: int = 0


@dataclass(slots=True)
class Timing:
    """Counts since the start, and figures since `window` was taken last.

    `overruns` are steps whose processor time was beyond the period, `missed` periods that were left out because the
    loop came too late to make up for them, `late_steps` steps that began more than half a period after they were due.
    """

    overruns: int = 0
    missed: int = 0
    late_steps: int = 0
    _window: Window = field(default_factory=Window)

    def stepped(self, used: int, budget: int) -> bool:
        """A step used so much processor time [ns]; says whether that is beyond its budget."""
        window = self._window
        window.steps += 1
        window.used += used
        window.used_worst = max(window.used_worst, used)
        over = used > budget
        self.overruns += over
        return over

    def began(self, late: int) -> None:
        """A step began this long [ns] after it was due."""
        self._window.late_worst = max(self._window.late_worst, late)

    def window(self) -> Window:
        """The figures since this was asked last."""
        window, self._window = self._window, Window()
        return window
