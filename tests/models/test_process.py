"""Process models: the step in closed form, and their unknowns found without a first guess."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twodof import models
from twodof.errors import IdentificationError
from twodof.identify import Record, fit, simulate
from twodof.models import DelayedStateSpace, linear_model, process

pytestmark = pytest.mark.slow

DT, N = 0.05, 400
T = DT * np.arange(N)


def stepped(y: np.ndarray | None = None, at: int = 20) -> Record:
    u = np.where(np.arange(N) >= at, 1.0, 0.0)
    return Record.from_columns(T, {"u": u, "y": T if y is None else y}, ["u"], ["y"])


@settings(deadline=None, max_examples=30)
@given(gain=st.floats(-5.0, 5.0), lag=st.floats(0.02, 20.0), dead=st.floats(0.0, 3.0), zero=st.floats(-2.0, 2.0))
def test_step_of_a_lag_is_that_in_closed_form(gain: float, lag: float, dead: float, zero: float) -> None:
    found = simulate(process("P1DZ"), stepped(), {"K": gain, "T1": lag, "Td": dead, "Tz": zero})["y"]
    after = T - 20 * DT - dead
    expected = gain * (1.0 + (zero / lag - 1.0) * np.exp(-np.maximum(after, 0.0) / lag))
    # At the edge itself a zero makes a jump: rounding decides which side a sample is on.
    clear = np.abs(after) > 1e-6
    assert found[clear] == pytest.approx(np.where(after > 0.0, expected, 0.0)[clear], abs=1e-9)


@settings(deadline=None, max_examples=30)
@given(gain=st.floats(0.1, 5.0), period=st.floats(0.1, 2.0), zeta=st.floats(0.05, 0.95), dead=st.floats(0.0, 3.0))
def test_step_of_a_pair_is_that_in_closed_form(gain: float, period: float, zeta: float, dead: float) -> None:
    found = simulate(process("P2DU"), stepped(), {"K": gain, "Tw": period, "zeta": zeta, "Td": dead})["y"]
    after = np.maximum(T - 20 * DT - dead, 0.0) / period
    root = math.sqrt(1.0 - zeta**2)
    swing = np.exp(-zeta * after) * (np.cos(root * after) + zeta / root * np.sin(root * after))
    assert found == pytest.approx(gain * (1.0 - swing), abs=1e-8)


def test_an_integrator_ramps() -> None:
    found = simulate(process("P1DI"), stepped(), {"K": 0.5, "T1": 0.4, "Td": 0.12})["y"]
    after = np.maximum(T - 20 * DT - 0.12, 0.0)
    assert found == pytest.approx(0.5 * (after - 0.4 * (1.0 - np.exp(-after / 0.4))), abs=1e-9)


@pytest.mark.parametrize(
    ("form", "truth"),
    [
        ("P1D", {"K": 2.0, "T1": 1.5, "Td": 0.87}),
        ("P2D", {"K": -2.0, "T1": 1.5, "T2": 0.4, "Td": 0.87}),
        ("P2DU", {"K": 3.0, "Tw": 0.5, "zeta": 0.3, "Td": 0.87}),
        ("P1DZ", {"K": 3.0, "T1": 0.8, "Tz": -0.3, "Td": 0.2}),
        ("P1DI", {"K": 0.5, "T1": 0.7, "Td": 0.87}),
    ],
)
def test_unknowns_are_found_without_a_first_guess(form: str, truth: dict[str, float]) -> None:
    generator = np.random.default_rng(2)
    u = np.sign(generator.standard_normal(50)).repeat(20)
    time = DT * np.arange(u.size)
    empty = Record.from_columns(time, {"u": u, "y": u}, ["u"], ["y"])
    clean = simulate(process(form), empty, truth)["y"]
    noise = 0.02 * clean.std()
    y = clean + noise * generator.standard_normal(u.size)
    found = fit(f"process:{form}", Record.from_columns(time, {"u": u, "y": y}, ["u"], ["y"]))
    pairs = {"T1": ("T1", "T2"), "T2": ("T2", "T1")} if "T2" in truth and found["T1"] < found["T2"] else {}
    for name, value in truth.items():
        own = pairs.get(name, (name, ""))[1] or name
        assert abs(found[own] - value) < 4.0 * found.sigma(own), (name, found.table())
    assert found.identification[0].rmse == pytest.approx(noise, rel=0.1)


def test_dead_times_of_a_linear_model_are_exact() -> None:
    generator = np.random.default_rng(3)
    u, w = (np.sign(generator.standard_normal(N // n)).repeat(n) for n in (20, 10))
    a, c = [[0.0, 1.0], [-4.0, -1.2]], [1.0, 0.0]
    y = sum(
        DelayedStateSpace.of(a, b, c, 0.0, late).zero_order_hold(DT).simulate(one, before=one[0])[:, 0]
        for one, b, late in ((u, [0.0, 2.0], 0.83), (w, [1.0, 0.0], 0.27))
    )
    model = linear_model(
        [[0, 1], ["-k", "-d"]],
        [[0, "g"], ["b", 0]],
        [[1, 0]],
        inputs=["u", "w"],
        outputs=["y"],
        guess={"k": 3.0, "d": 1.0, "b": 1.0, "g": 0.5, "late": 0.7},
        delays={"u": "late", "w": 0.27},
    )
    table = {"u": u, "w": w, "y": y + 0.02 * generator.standard_normal(N)}
    one = Record.from_columns(T, table, ["u", "w"], ["y"])
    truth = {"k": 4.0, "d": 1.2, "b": 2.0, "g": 1.0, "late": 0.83}
    assert simulate(model, one, truth)["y"] == pytest.approx(y, abs=1e-12)
    found = fit(model, one)
    assert found.unit("late") == "s"
    for name, value in truth.items():
        assert abs(found[name] - value) < 4.0 * found.sigma(name), name


@pytest.mark.parametrize("delays", [{"v": 0.1}, {"u": -0.1}, {"u": "-late"}, {"u": None}])
def test_dead_times_that_cannot_be_are_refused(delays: dict[str, object]) -> None:
    with pytest.raises(IdentificationError, match="the dead time"):
        linear_model([[-1]], [[1]], [[1]], inputs=["u"], outputs=["y"], guess={}, delays=delays)  # type: ignore[arg-type]


def test_a_model_is_made_by_its_name() -> None:
    made = models.model_named("arx:2,1/3,1", ("u", "w"), ("y",))
    assert made == models.arx(2, [1, 3], 1, inputs=("u", "w"))
    assert models.model_named("process:P2D", ("u",), ("y",)).outputs == ("y",)
