"""Level hold: while the attitude loop holds the pitch, the mean of its moment is the trim moment."""

from typing import Any

from twodof.blocks import Block, Port, State, int32, maximum, minimum, to_int32, to_real, where
from twodof.flight.declarations import ports, tunables
from twodof.signals import ATTITUDE, RATE, VELOCITY


class LevelHold(Block):
    """Finds the moment M_trim that holds the pitch, and adds it to an open-loop excitation flown right after.

    The hold begins `settle` s after the attitude mode was entered with thrust on. From then on M_trim is the mean of
    the moment over at most the last `window` s; what is older is forgotten exponentially. It is kept when the mode
    changes, until the next hold. In open loop M_open = excitation + M_trim where `use_trim`, else the excitation alone.
    """

    inputs = (*ports("mode", "M", "thrust"), Port("excitation"), *ports("use_trim"))
    outputs = (*ports("M_open"), Port("M_trim"))
    states = (State("mean"), State("samples", 0, "int32"))
    derived = (Port("settle_samples", "int32"), Port("window_samples"))
    params = tunables("hold")

    def prepare(self, p: Any, t: Any) -> Any:
        return {"settle_samples": to_int32(p.settle / t.dt + 0.5), "window_samples": p.window / t.dt}

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"M_open": u.excitation + where(u.use_trim, x.mean, 0.0), "M_trim": x.mean}

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        holding = (u.mode == int32(ATTITUDE)) & (u.thrust > 0.0)
        samples = where(holding, minimum(x.samples + int32(1), int32(2**24)), int32(0))
        used = samples - p.settle_samples
        weight = 1.0 / minimum(maximum(to_real(used), 1.0), p.window_samples)
        return {
            "mean": where(used > int32(0), x.mean + weight * (u.M - x.mean), x.mean),
            "samples": samples,
        }


class ArmingReset(Block):
    """Reset of the integrals: while the drone gives no thrust, and for `samples` samples beyond the thrust's edge.

    There is thrust where the velocity loop makes it, and in rate and attitude mode where `thrust` > 0.
    """

    inputs = ports("mode", "thrust", "in_reset")
    outputs = ports("in_reset")
    states = (State("count", 0, "int32"),)
    # The drone's logs show two to four samples.
    params = tunables("arming")

    def _thrusting(self, u: Any) -> Any:
        return (u.mode >= int32(VELOCITY)) | ((u.mode >= int32(RATE)) & (u.thrust > 0.0))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return u.in_reset | ~self._thrusting(u) | (x.count < p.samples)

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return where(self._thrusting(u), minimum(x.count + int32(1), p.samples), int32(0))
