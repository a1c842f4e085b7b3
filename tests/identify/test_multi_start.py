"""Fits from several first guesses, of a cost whose minima are known."""

import math
from typing import Any

import numpy as np
import pytest

from twodof.blocks import Block, Param, Port
from twodof.blocks.elementary.functions import sin
from twodof.errors import IdentificationError
from twodof.identify import Record, fit, fit_from_several
from twodof.models import Structure

pytestmark = pytest.mark.slow

T = 0.01 * np.arange(400)


class Wave(Block):
    """y = sin(w u): from a guess far off the frequency, a search ends in one of many minima."""

    inputs = (Port("u"),)
    outputs = (Port("y"),)
    params = (Param("w", 3.0, low=0.1, high=100.0),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return sin(p.w * u.u)


def record(seed: int = 0) -> Record:
    y = np.sin(20.0 * T) + 0.1 * np.random.default_rng(seed).standard_normal(T.size)
    return Record.from_columns(T, {"u": T, "y": y}, ["u"], ["y"])


@pytest.mark.long
def test_the_best_of_many_minima_is_found() -> None:
    wave = Structure.of_block(Wave())
    alone = fit(wave, record())
    assert abs(alone["w"] - 20.0) > 5.0  # the lone guess of 3 rad/s ends elsewhere
    found = fit_from_several(wave, record(), {"w": (1.0, 60.0)}, starts=40, seed=2)
    # 1 sigma is .1 / sqrt(sum t^2 cos^2) = .1 / sqrt(4^3 / 3 / 2 * 100).
    assert found.best["w"] == pytest.approx(20.0, abs=4.0 * 0.1 / math.sqrt(1067.0))
    assert found.minima[0].values == {"w": found.best["w"]}
    costs = [one.cost for one in found.minima]
    assert costs == sorted(costs)
    assert len(costs) > 5
    assert sum(one.starts for one in found.minima) + len(found.failed) == 40
    # The search reaches the minimum from within half a wave over the record, 2 pi / 4 / 2 of the 60 rad/s.
    assert 0.0 < found.share < 0.2
    again = fit_from_several(wave, record(), {"w": (1.0, 60.0)}, starts=40, seed=2)
    assert [one.values for one in again.minima] == [one.values for one in found.minima]


def test_one_start_is_the_fit() -> None:
    wave = Structure.of_block(Wave()).with_guess(w=19.5)
    found = fit_from_several(wave, record(), {"w": (1.0, 60.0)}, starts=1)
    assert found.best["w"] == fit(wave, record())["w"]
    assert found.share == 1.0


def test_what_is_refused() -> None:
    wave = Structure.of_block(Wave())
    for ends in ((5.0, 5.0), (0.0, 5.0), (5.0, 500.0), (math.nan, 5.0), 5.0, (1.0,), ("a", "b")):
        with pytest.raises(IdentificationError, match="cannot be drawn"):
            fit_from_several(wave, record(), {"w": ends})  # type: ignore[dict-item]
    with pytest.raises(IdentificationError, match="the ranges are"):
        fit_from_several(wave, record(), ["w"])  # type: ignore[arg-type]
    with pytest.raises(IdentificationError, match="no unknown is called 'v'"):
        fit_from_several(wave, record(), {"v": (1.0, 2.0)})
    for starts in (0, -1, 10**9, 2.5, "x"):
        with pytest.raises(IdentificationError, match="starts"):
            fit_from_several(wave, record(), {"w": (1.0, 2.0)}, starts=starts)  # type: ignore[arg-type]
    silent = Record.from_columns(T, {"u": 0.0 * T, "y": T}, ["u"], ["y"])
    with pytest.raises(IdentificationError, match="say nothing about 'w'"):
        fit_from_several(wave, silent, {"w": (1.0, 60.0)}, starts=3)
