"""Noise: a pure function of (seed, stream, tick), so that any run can be repeated to the bit."""

from __future__ import annotations

from typing import Any

from twodof.blocks.block import Block, Clock, library_block
from twodof.blocks.declarations import Param, Port
from twodof.blocks.elementwise import count
from twodof.blocks.expressions.arrays import vector
from twodof.blocks.noise import normal, normal4, uniform, uniform4

__all__ = ["Noise", "UniformNoise"]


def _random_params(seed: int, stream: int, block: str) -> list[Param]:
    return [
        Param("seed", count(seed, 0, 2**32 - 1, block, "seed"), "uint32"),
        Param("stream", count(stream, 0, 2**32 - 1, block, "stream"), "uint32", text="one of its own for each source"),
    ]


@library_block("noise")
class Noise(Block):
    """y = mean + deviation z, z standard normal and independent from tick to tick (Philox 4x32-10, Box-Muller).

    `width` up to 4 gives independent elements from one evaluation. Two blocks need different `stream`s, two runs
    different `seed`s.
    """

    def __init__(
        self,
        deviation: float = 1.0,
        mean: float = 0.0,
        seed: int = 0,
        stream: int = 0,
        width: int | None = None,
        unit: str = "",
    ) -> None:
        self.width = width if width is None else count(width, 1, 4, "Noise", "width")
        self.outputs = [Port("y", width=width, unit=unit)]
        self.params = [
            Param("deviation", deviation, unit=unit, low=0.0),
            Param("mean", mean, unit=unit),
            *_random_params(seed, stream, "Noise"),
        ]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        if self.width is None:
            return p.mean + p.deviation * normal(p.seed, p.stream, t.tick)
        several = normal4(p.seed, p.stream, t.tick)[: self.width]
        return vector([p.mean + p.deviation * z for z in several])


@library_block("uniform_noise")
class UniformNoise(Block):
    """y = low + (high - low) w, w uniform on [0, 1) in steps of 2^-24 and independent from tick to tick (Philox).

    `width` up to 4 gives independent elements from one evaluation.
    """

    def __init__(
        self,
        low: float = 0.0,
        high: float = 1.0,
        seed: int = 0,
        stream: int = 0,
        width: int | None = None,
        unit: str = "",
    ) -> None:
        self.width = width if width is None else count(width, 1, 4, "UniformNoise", "width")
        self.outputs = [Port("y", width=width, unit=unit)]
        self.params = [
            Param("low", low, unit=unit),
            Param("high", high, unit=unit),
            *_random_params(seed, stream, "UniformNoise"),
        ]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        if self.width is None:
            return p.low + (p.high - p.low) * uniform(p.seed, p.stream, t.tick)
        several = uniform4(p.seed, p.stream, t.tick)[: self.width]
        return vector([p.low + (p.high - p.low) * w for w in several])
