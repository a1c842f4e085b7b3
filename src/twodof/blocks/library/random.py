"""Noise: a pure function of (seed, stream, tick), so that any run can be repeated to the bit."""

from collections.abc import Callable
from typing import Any

from twodof.blocks.block import Block, Clock, library_block
from twodof.blocks.declarations import Param, Port
from twodof.blocks.elementwise import count
from twodof.blocks.expressions.arrays import vector
from twodof.blocks.noise import normal, normal4, uniform, uniform4

__all__ = ["Noise", "UniformNoise"]


class _Random(Block):
    """One number a tick, or up to 4 of one evaluation, made from random ones by `of`."""

    one: Callable[..., Any]
    four: Callable[..., Any]
    of: Callable[..., Any]

    def declare(self, params: list[Param], seed: int, stream: int, width: int | None, unit: str) -> None:
        """Declare the output, and the parameters of the generator beside `params`."""
        name, most = type(self).__name__, 2**32 - 1
        self.width = width if width is None else count(width, 1, 4, name, "width")
        self.outputs = [Port("y", width=width, unit=unit)]
        self.params = [
            *params,
            Param("seed", count(seed, 0, most, name, "seed"), "uint32"),
            Param("stream", count(stream, 0, most, name, "stream"), "uint32", text="one of its own for each source"),
        ]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        if self.width is None:
            return self.of(p, self.one(p.seed, p.stream, t.tick))
        return vector([self.of(p, z) for z in self.four(p.seed, p.stream, t.tick)[: self.width]])


@library_block("noise")
class Noise(_Random):
    """y = mean + deviation z, z standard normal and independent from tick to tick (Philox 4x32-10, Box-Muller).

    `width` up to 4 gives independent elements from one evaluation. Two blocks need different `stream`s, two runs
    different `seed`s.
    """

    one, four = staticmethod(normal), staticmethod(normal4)

    def __init__(
        self,
        deviation: float = 1.0,
        mean: float = 0.0,
        seed: int = 0,
        stream: int = 0,
        width: int | None = None,
        unit: str = "",
    ) -> None:
        params = [Param("deviation", deviation, unit=unit, low=0.0), Param("mean", mean, unit=unit)]
        self.declare(params, seed, stream, width, unit)

    def of(self, p: Any, z: Any) -> Any:
        return p.mean + p.deviation * z


@library_block("uniform_noise")
class UniformNoise(_Random):
    """y = low + (high - low) w, w uniform on [0, 1) in steps of 2^-24 and independent from tick to tick (Philox).

    `width` up to 4 gives independent elements from one evaluation.
    """

    one, four = staticmethod(uniform), staticmethod(uniform4)

    def __init__(
        self,
        low: float = 0.0,
        high: float = 1.0,
        seed: int = 0,
        stream: int = 0,
        width: int | None = None,
        unit: str = "",
    ) -> None:
        self.declare([Param("low", low, unit=unit), Param("high", high, unit=unit)], seed, stream, width, unit)

    def of(self, p: Any, w: Any) -> Any:
        return p.low + (p.high - p.low) * w
