"""Estimate of mu, the gain from moment to pitch acceleration, in flight: a diagram that can be part of any other."""

import math
from typing import Any

from twodof.blocks.block import Block, Clock, library_block
from twodof.blocks.declarations import Param, Port, State
from twodof.blocks.diagram import Diagram
from twodof.blocks.elementary.functions import tan
from twodof.blocks.expressions.arrays import vector
from twodof.blocks.expressions.expr import maximum, minimum, to_int32, to_real
from twodof.blocks.library import Demux, Logic, RecursiveLeastSquares
from twodof.models.around_plant import past_input, past_states, remember

_FILTERS = ("M_first", "M_second", "q_first", "q_second")
_SETTLED = 10.0
"""Number of time constants after which the filter's initial transient has died out: exp(-10) = 5e-5."""


@library_block("models.PitchRegressors")
class PitchRegressors(Block):
    """Regressors of q'' + a1 q' + a0 q = mu M'(t - tau), the pitch rate's G_q, without a derivative of a noisy signal.

    All signals pass the same band-pass F(s) = w^2 s^2 / E(s)^2, E = s^2 + 2 d w s + w^2, w = 2 pi cutoff, d = .7. So
    y = phi' (mu, a1, a0) holds with y = F q and phi = (F M(t - tau) / s, -F q / s, -F q / s^2). Trims and biases do not
    pass. M is held over a step, so half a step is added to `tau`. It passes the rotors' `lag` too. `settled` is true
    once the filters' initial transient has died out.
    Source: state-variable filters, Young, Recursive Estimation and Time-Series Analysis, chapter 8. Each filter is made
    by the trapezoidal rule, exact at the cut-off.
    """

    def __init__(self, ring: int = 64, cutoff: float = 4.0, tau: float = 0.02) -> None:
        self.ring = ring
        self.inputs = (Port("M"), Port("q", unit="rad/s"))
        self.outputs = (Port("y"), Port("phi", width=3), Port("settled", "bool"))
        self.params = (
            Param("cutoff", cutoff, unit="Hz", low=0.0, text="middle of the band that is looked at"),
            Param("tau", tau, unit="s", low=0.0, text="delay from M to q"),
            Param("lag", 0.0, unit="s", low=0.0, text="first-order lag of the rotors, beside the delay"),
        )
        self.derived = (
            Port("warped"),
            Port("divisor"),
            Port("omega", unit="rad/s"),
            Port("whole", "int32"),
            Port("fraction"),
            Port("wait", "int32"),
            Port("share"),
            Port("fits", "bool"),
        )
        self.states = (
            *(State(f"{name}_{part}") for name in _FILTERS for part in ("s1", "s2")),
            State("rotor"),
            State("steps", 0, "int32"),
            *past_states(ring, "M"),
        )

    def prepare(self, p: Any, t: Clock) -> dict[str, Any]:
        g = tan(math.pi * minimum(0.499, p.cutoff * t.dt))
        steps = p.tau / t.dt + 0.5
        whole = to_int32(steps)
        omega = 2.0 * math.pi * p.cutoff
        return {
            "warped": g,
            "divisor": 1.0 / (1.0 + 2.0 * 0.7 * g + g * g),
            "omega": omega,
            "whole": whole,
            "fraction": steps - to_real(whole),
            "wait": to_int32(minimum(_SETTLED / maximum(omega * t.dt, 1e-6), 1e9)),
            "share": t.dt / (t.dt + 2.0 * p.lag),
            "fits": steps <= self.ring - 2.0,
        }

    @staticmethod
    def _filter(name: str, u: Any, x: Any, p: Any) -> tuple[Any, Any, Any]:
        """Return high-, band- and low-pass, s^2, w s and w^2 over E."""
        s1, s2 = x[f"{name}_s1"], x[f"{name}_s2"]
        high = (u - (2.0 * 0.7 + p.warped) * s1 - s2) * p.divisor
        band = p.warped * high + s1
        return high, band, p.warped * band + s2

    def _moment(self, u: Any, x: Any, p: Any) -> tuple[Any, Any]:
        """Return M behind delay and lag, and the next state of the lag."""
        ago = past_input(u, x, "M", p.fits, self.ring)
        moment = (1.0 - p.fraction) * ago(p.whole) + p.fraction * ago(p.whole + 1)
        step = p.share * (moment - x.rotor)
        return x.rotor + step, x.rotor + 2.0 * step

    def _parts(self, u: Any, x: Any, p: Any) -> dict[str, tuple[Any, Any, Any]]:
        found = {}
        for name, signal in (("M", self._moment(u, x, p)[0]), ("q", u.q)):
            found[f"{name}_first"] = self._filter(f"{name}_first", signal, x, p)
            found[f"{name}_second"] = self._filter(f"{name}_second", found[f"{name}_first"][2], x, p)
        return found

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, Any]:
        """Return `y`, the regressors `phi`, and `settled`."""
        parts = self._parts(u, x, p)
        (_, moment, _), (high, band, low) = parts["M_second"], parts["q_second"]
        w = p.omega
        return {"y": high, "phi": vector([moment / w, -band / w, -low / (w * w)]), "settled": x.steps >= p.wait}

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, Any]:
        found: dict[str, Any] = {"steps": minimum(x.steps + 1, p.wait), "rotor": self._moment(u, x, p)[1]}
        for name, (high, band, low) in self._parts(u, x, p).items():
            found[f"{name}_s1"] = p.warped * high + band
            found[f"{name}_s2"] = p.warped * band + low
        return {**found, **remember(u, x, self.ring, "M")}


def moment_gain(
    every: int = 10, memory: float = 0.0, ring: int = 64, guess: tuple[float, float, float] = (300.0, 0.5, 12.0)
) -> Diagram:
    """Make a diagram from M and q to `mu` and its standard deviation `sigma`, both in rad/s2.

    Recursive least squares find (mu, a1 = 2 xi w_n, a0 = w_n^2); a1 and a0 are outputs as well. Parameters: `cutoff`
    [Hz] is the middle of the signals' band-pass, `tau` [s] the known delay, `lag` [s] the rotors' lag. Data that are
    `memory` [s] old weigh 1/e (0: nothing is forgotten). The estimate starts from `guess` with a large variance. It
    takes one of `every` samples, so that the filtered noise is nearly white.

    It learns while the input `learn` is true, which should be while an excitation plays. In hover the controller
    answers gusts and the noise of the gyro. M is then caused by q, and least squares find a mu that is far too small
    (180 where it is 300). In closed loop a part of this error is left during the excitation too.
    """
    d = Diagram("moment_gain", "mu from M and q, recursively")
    d.input("M")
    d.input("q", unit="rad/s")
    d.input("learn", "bool")
    d.param("cutoff", 4.0, unit="Hz", low=0.1, high=50.0, text="middle of the band that is looked at")
    d.param("tau", 0.02, unit="s", low=0.0, high=0.2, text="delay from M to q")
    d.param("lag", 0.0, unit="s", low=0.0, high=0.2, text="lag of the rotors, beside the delay")
    d.param("memory", memory, unit="s", low=0.0, text="data this old weigh 1/e; 0: nothing is forgotten")
    d.add("regressors", PitchRegressors(ring), params={name: name for name in ("cutoff", "tau", "lag")}, M="M", q="q")
    least = RecursiveLeastSquares(3, every, memory, 0.1, list(guess), [1000.0, 10.0, 100.0])
    d.add("learning", Logic("and"), a="learn", b="regressors.settled")
    d.add("fit", least, params={"memory": "memory"}, phi="regressors.phi", y="regressors.y", learn="learning")
    d.add("value", Demux(3), u="fit.theta")
    d.add("deviation", Demux(3), u="fit.sigma")
    names = [port.name for port in Demux(3).outputs]
    for place, name in enumerate(("mu", "a1", "a0")):
        d.output(name, f"value.{names[place]}")
        d.output("sigma" if name == "mu" else f"{name}_sigma", f"deviation.{names[place]}")
    return d
