"""Job: a computation that takes long, as clients see it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

State = Literal["running", "done", "failed", "cancelled"]


@dataclass
class Job:
    """How far a job is: `fraction` 0 to 1, `text` what it does now; at its end its `result`, or its `error`.

    `bound`: what it does now cannot be ended half way.
    """

    id: str
    kind: str
    state: State = "running"
    fraction: float = 0.0
    text: str = ""
    result: Any = None
    error: dict[str, str] | None = None
    bound: bool = False

    @property
    def over(self) -> bool:
        """Whether it has ended, one way or another."""
        return self.state != "running"

    def told(self, with_result: bool = True) -> dict[str, Any]:
        """As clients get it."""
        rows = {key: value for key, value in vars(self).items() if not key.startswith("_")}
        return rows if with_result else {key: value for key, value in rows.items() if key != "result"}
