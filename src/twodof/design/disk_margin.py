"""The disk margin: how much gain and phase may change at once before the loop becomes unstable."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class DiskMargin:
    """The loop stays stable for every factor (1 + (1 - skew) d / 2) / (1 - (1 + skew) d / 2), |d| < `alpha`, d complex.

    `alpha` is 1 / max |S + (skew - 1) / 2|, at the frequency `omega` [rad/s]: Seiler, Packard and Gahinet, An
    Introduction to Disk Margins, IEEE Control Systems 40-5 (2020), theorem 1. Skew 0 is balanced between S and T,
    1 measures S and -1 measures T.
    """

    alpha: float
    skew: float
    omega: float

    @property
    def gain(self) -> tuple[float, float]:
        """Within which factors the gain alone may change; below 0, and infinity, where a half plane is inside."""
        up, down = 1.0 - self.skew, 1.0 + self.skew
        low = (2.0 - self.alpha * up) / (2.0 + self.alpha * down)
        rest = 2.0 - self.alpha * down
        return low, (2.0 + self.alpha * up) / rest if rest > 0.0 else math.inf

    @property
    def phase(self) -> float:
        """By how much the phase alone may change either way [rad], at most pi: equation (15) there."""
        low, high = self.gain
        if math.isinf(high):
            cosine = low
        else:
            cosine = (1.0 + low * high) / (low + high) if low + high > 0.0 else -1.0
        return math.acos(max(-1.0, min(1.0, cosine)))
