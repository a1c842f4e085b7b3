"""Records made ready for a fit, and models beside each other on fresh data."""

import numpy as np
import pytest
from scipy.signal import lfilter

from twodof.errors import IdentificationError
from twodof.identify import Record, compare, fit, merge, rmse, vaf
from twodof.identify.record import Samples

pytestmark = pytest.mark.slow

DT, N = 0.01, 1000


def record(seed: int, name: str = "train") -> Record:
    generator = np.random.default_rng(seed)
    u = np.sign(generator.standard_normal(N // 4)).repeat(4)
    noise = lfilter([1.0], [1.0, -0.9], 0.1 * generator.standard_normal(N))
    y = lfilter([0.0, 1.0, 0.5], [1.0, -1.5, 0.7], u) + noise
    return Record.from_columns(DT * np.arange(N), {"u": u, "y": y}, ["u"], ["y"], name)


def test_figures_of_each_model_are_those_of_its_simulation() -> None:
    train, fresh = record(1), record(2, "fresh")
    models = {name: fit(name, train, validation=fresh) for name in ("bj:2,0,1,2,1", "arx:2,2,1", "process:P2DU")}
    found = compare(models, fresh)
    assert {row.model for row in found.rows} == set(models)
    assert [row.fit_percent for row in found.rows] == sorted((r.fit_percent for r in found.rows), reverse=True)
    by_name = {row.model: row for row in found.rows}
    one = models["bj:2,0,1,2,1"].validation[0]
    row = by_name["bj:2,0,1,2,1"]
    assert (row.fit_percent, row.ahead) == pytest.approx((one.fit_percent, one.ahead))
    assert row.rmse == pytest.approx(rmse(one.measured, one.simulated))
    assert row.vaf == pytest.approx(vaf(one.measured, one.simulated))
    # The noise .1 of 4.3: what a predictor with the right noise model leaves.
    assert row.ahead == pytest.approx(100.0 * (1.0 - 0.1 / fresh.outputs["y"].value.std()), abs=0.3)
    assert row.ahead > by_name["arx:2,2,1"].ahead
    assert "FIT one sample ahead" in found.table()
    assert len(found.to_json()) == 3
    assert len(compare(list(models.values()), [train, fresh]).rows) == 6


def test_a_structure_is_compared_from_its_best_initial_state() -> None:
    train, fresh = record(3), record(4, "fresh").part(0.5, 4.0, "fresh")
    found = fit("subspace:2", train)
    assert compare([found], fresh).rows[0].fit_percent > 90.0


def test_what_cannot_be_compared_is_refused() -> None:
    found = fit("arx:2,2,1", record(1))
    for models in ([], [found, found]):
        with pytest.raises(IdentificationError, match="no models, or two"):
            compare(models, record(2))
    with pytest.raises(IdentificationError, match="not a fitted model"):
        compare({"a": 3}, record(2))  # type: ignore[dict-item]


def test_detrend_takes_levels_and_lines_away() -> None:
    plain = record(5)
    time = plain.time
    table = {"u": plain.inputs["u"] + 3.0, "y": plain.outputs["y"].value + 50.0 - 2.0 * time}
    lifted = Record.from_columns(time, table, ["u"], ["y"])
    level = lifted.detrend()
    assert level.inputs["u"].mean() == pytest.approx(0.0, abs=1e-12)
    assert level.outputs["y"].value == pytest.approx(table["y"] - table["y"].mean(), abs=1e-9)
    flat = lifted.detrend(linear=True).outputs["y"].value
    assert np.polyfit(time, flat, 1) == pytest.approx([0.0, 0.0], abs=1e-9)


def test_resampled_records_keep_what_the_new_rate_can_show() -> None:
    time = DT * np.arange(4000)
    slow, fast = np.sin(2.0 * np.pi * 1.0 * time), np.sin(2.0 * np.pi * 40.0 * time)
    table = {"u": slow, "v": slow, "y": slow + fast}
    found = Record.from_columns(time, table, ["u", "v"], ["y"], hold={"v": "band-limited"}).resample(0.04)
    assert (found.dt, found.steps) == (0.04, 1000)
    assert found.hold_of("u") == "band-limited"
    inner = slice(50, -50)  # the filter needs samples on both sides
    now = np.sin(2.0 * np.pi * found.time)[inner]
    # The filter of scipy ripples by a thousandth; 40 Hz would be folded to 10 Hz.
    assert found.inputs["v"][inner] == pytest.approx(now, abs=2e-3)
    held = np.sin(2.0 * np.pi * (found.time - 0.5 * DT))[inner]  # what is held is half a step behind its samples
    assert found.inputs["u"][inner] == pytest.approx(held, abs=2e-3)
    assert found.outputs["y"].value[inner] == pytest.approx(now, abs=2e-3)


@pytest.mark.parametrize("period", [2.0 * DT, 2.5 * DT, 3.0 * DT])
def test_a_resampled_record_has_the_plants_delay(period: float) -> None:
    # y follows the held u by 5.3 steps, behind a lag that the slower rate shows whole.
    random, fine = np.random.default_rng(3), 20
    u = np.repeat(random.normal(size=400), 10)
    y = np.zeros(u.size)
    late = np.repeat(u, fine)[np.maximum(0, np.arange(u.size * fine) - round(5.3 * fine))]
    x, step = 0.0, DT / fine
    for k in range(u.size):
        y[k] = x
        for one in late[k * fine : (k + 1) * fine]:
            x += step / (20.0 * DT) * (one - x)
    record = Record.from_columns(DT * np.arange(u.size), {"u": u, "y": y}, ["u"], ["y"])
    # The filter's ripple of a thousandth is left; half a step would be .005 s.
    assert fit("process:P1D", record.resample(period))["Td"] == pytest.approx(5.3 * DT, abs=0.0005)


def test_resampling_at_the_same_rate_puts_outputs_on_the_grid() -> None:
    plain = record(6)
    late = Samples(np.arange(N - 1) + 0.5, np.arange(N - 1) + 0.5)
    found = Record("late", DT, 0.0, plain.inputs, {"y": late}).resample(DT)
    assert found.outputs["y"].on_grid
    assert found.outputs["y"].value[1:-1] == pytest.approx(np.arange(1.0, N - 1), abs=1e-9)
    assert found.hold_of("u") == "zoh"
    for period in (0.005, -1.0, float("nan"), 100.0):
        with pytest.raises(IdentificationError, match="a period of"):
            plain.resample(period)


def test_only_records_alike_are_merged() -> None:
    one = record(7)
    assert [r.name for r in merge(one, record(8))] == ["train (1)", "train (2)"]
    assert [r.name for r in merge(one, record(8, "other"))] == ["train", "other"]
    with pytest.raises(IdentificationError, match="resample one"):
        merge(one, one.resample(0.02))
    with pytest.raises(IdentificationError, match="the channels"):
        merge(one, Record("x", DT, 0.0, {"v": one.inputs["u"]}, one.outputs))


def test_gaps_are_not_filled() -> None:
    one = record(9)
    kept = np.delete(np.arange(N), np.arange(300, 340))
    table = {"u": one.inputs["u"][kept], "y": one.outputs["y"].value[kept]}
    holed = Record.from_columns(one.time[kept], table, ["u"], ["y"])
    with pytest.raises(IdentificationError, match="has a gap"):
        holed.resample(DT)
    with pytest.raises(IdentificationError, match="not sampled at each step"):
        fit("oe:2,2,1", holed)
    found = fit("oe:2,2,1", holed.pieces())
    assert abs(found["f1"] + 1.5) < 4.0 * found.sigma("f1")
    # An output alone that lacks samples, and an input alone.
    lost = Record("lost", DT, 0.0, one.inputs, {"y": Samples(kept.astype(float), table["y"])})
    with pytest.raises(IdentificationError, match="'y' lacks 40 samples"):
        lost.resample(DT)
    clocks = {"u": (one.time[kept], table["u"]), "y": (one.time, one.outputs["y"].value)}
    assert any("gap" in remark for remark in fit("oe:2,2,1", Record.from_channels(clocks, ["u"], ["y"])).remarks)
