"""ARX, ARMAX, OE and BJ: least squares in closed form, known systems within their intervals, python-control."""

from collections.abc import Callable

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.stats import binomtest

from twodof.errors import IdentificationError
from twodof.identify import Record, fit, merge
from twodof.identify.simulation import model_response
from twodof.models import PolynomialModel, armax, arx, bj, oe

pytestmark = pytest.mark.slow

Array = NDArray[np.float64]
N, DT = 1000, 0.01
A, B, C, D = [1.0, -1.5, 0.7], [0.0, 0.0, 1.0, 0.5], [1.0, -0.8, 0.2], [1.0, -0.9]
G = {"b1": 1.0, "b2": 0.5}
KINDS: dict[str, tuple[PolynomialModel, Callable[[Array], Array], dict[str, float]]] = {
    "arx": (arx(2, 2, 2), lambda e: lfilter([1.0], A, e), {"a1": -1.5, "a2": 0.7, **G}),
    "armax": (armax(2, 2, 2, 2), lambda e: lfilter(C, A, e), {"a1": -1.5, "a2": 0.7, "c1": -0.8, "c2": 0.2, **G}),
    "oe": (oe(2, 2, 2), lambda e: e, {"f1": -1.5, "f2": 0.7, **G}),
    "bj": (
        bj(2, 2, 1, 2, 2),
        lambda e: lfilter(C, D, e),
        {"f1": -1.5, "f2": 0.7, "c1": -0.8, "c2": 0.2, "d1": -0.9, **G},
    ),
}


def record(kind: str, seed: int, sigma: float = 0.1, name: str = "record") -> Record:
    generator = np.random.default_rng(seed)
    u = np.sign(generator.standard_normal(N // 2)).repeat(2)
    y = lfilter(B, A, u) + KINDS[kind][1](sigma * generator.standard_normal(N))
    return Record.from_columns(DT * np.arange(N), {"u": u, "y": y}, ["u"], ["y"], name)


def test_arx_is_least_squares_in_closed_form() -> None:
    one = record("arx", 1)
    u, y = one.inputs["u"], one.outputs["y"].value
    k = np.arange(3, N)
    table = np.column_stack([-y[k - 1], -y[k - 2], u[k - 2], u[k - 3]])
    found = fit(arx(2, 2, 2), one)
    assert found.values == pytest.approx(np.linalg.lstsq(table, y[k])[0], rel=1e-8)
    error = y[k] - table @ found.values
    expected = error @ error / (k.size - 4) * np.linalg.inv(table.T @ table)
    assert found.covariance == pytest.approx(expected, rel=1e-6)
    assert found.noise["y"] == pytest.approx(np.sqrt(error @ error / (k.size - 4)), rel=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_a_known_system_is_found(kind: str) -> None:
    model, _, truth = KINDS[kind]
    found = fit(model, record(kind, 3), validation=record(kind, 4, name="fresh"))
    assert found.converged
    assert set(found.labels) == set(truth)
    for label, value in truth.items():
        assert abs(found[label] - value) < 4.0 * found.sigma(label), label
    assert found.white
    assert found.noise["y"] == pytest.approx(0.1, rel=0.1)  # of 1000 samples a deviation is known to 2.2 %
    for one in (*found.identification, *found.validation):
        assert one.ahead is not None
        assert one.ahead > 97.0


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_intervals_hold_the_truth_as_often_as_they_say(kind: str) -> None:
    model, _, truth = KINDS[kind]
    held, seeds = dict.fromkeys(truth, 0), 100
    for seed in range(seeds):
        found = fit(model, record(kind, 100 + seed))
        for label, value in truth.items():
            low, high = found.interval(label)
            held[label] += low <= value <= high
    # 22 tests of the four kinds: one in 1000 rejects by chance each.
    wrong = {label: count for label, count in held.items() if binomtest(count, seeds, 0.95).pvalue < 1e-3}
    assert not wrong, held


def test_frequency_response_is_that_of_python_control() -> None:
    found = fit(bj(2, 1, 1, 2, 2), record("bj", 5))
    omega = np.geomspace(0.1, 300.0, 50)
    own = model_response(bj(2, 1, 1, 2, 2), found, "u", "y", omega, DT)
    assert isinstance(found.model, PolynomialModel)
    top, bottom = found.model.polynomials(found.values).transfer(0)
    theirs = control.TransferFunction(top, bottom, DT)(np.exp(1j * omega * DT))
    assert own.response == pytest.approx(theirs, rel=1e-9)
    assert found.linear(DT).response(omega)[:, 0, 0] == pytest.approx(theirs, rel=1e-7)
    with pytest.raises(IdentificationError, match="a model of steps of"):
        found.linear(DT / 2)
    assert (own.gain_sigma > 0.0).all()


@settings(deadline=None, max_examples=30)
@given(
    na=st.integers(1, 3),
    nb=st.integers(1, 4),
    nk=st.integers(0, 20),
    size=st.floats(1e-3, 1e3),
    seed=st.integers(0, 99),
)
def test_any_orders_and_sizes_without_noise_are_exact(na: int, nb: int, nk: int, size: float, seed: int) -> None:
    generator = np.random.default_rng(seed)
    a = np.poly(generator.uniform(-0.9, 0.9, na))
    b = size * (0.1 + generator.uniform(size=nb))
    u = generator.standard_normal(400)
    y = lfilter(np.append(np.zeros(nk), b), a, u)
    one = Record.from_columns(DT * np.arange(400), {"u": u, "y": y}, ["u"], ["y"])
    found = fit(arx(na, nb, nk), one)
    # The inverse of the regressors' covariance enlarges rounding, at poles that lie close together most.
    assert found.values[:na] == pytest.approx(a[1:], abs=1e-7)
    assert found.values[na:] == pytest.approx(b, rel=1e-6)
    assert found.identification[0].rmse < 1e-7 * y.std()


def test_several_inputs_have_dynamics_and_delays_of_their_own() -> None:
    generator = np.random.default_rng(6)
    u, w = (np.sign(generator.standard_normal(N // n)).repeat(n) for n in (2, 4))
    y = lfilter(B, A, u) + lfilter([0.0, 2.0], [1.0, -0.5], w) + 0.1 * generator.standard_normal(N)
    one = Record.from_columns(DT * np.arange(N), {"u": u, "w": w, "y": y}, ["u", "w"], ["y"])
    truth = {"b1_u": 1.0, "b2_u": 0.5, "f1_u": -1.5, "f2_u": 0.7, "b1_w": 2.0, "f1_w": -0.5}
    for found in (fit(oe([2, 1], [2, 1], [2, 1], inputs=["u", "w"]), one), fit("oe:2/1,2/1,2/1", one)):
        assert set(found.labels) == set(truth)
        for label, value in truth.items():
            assert abs(found[label] - value) < 4.0 * found.sigma(label), label


def test_merged_experiments_tell_more_than_one() -> None:
    both = fit("oe:2,2,2", merge(record("oe", 7), record("oe", 8)))
    one = fit("oe:2,2,2", record("oe", 7))
    assert [c.record for c in both.identification] == ["record (1)", "record (2)"]
    assert both.cramer_rao("b1") == pytest.approx(one.cramer_rao("b1") / np.sqrt(2.0), rel=0.1)


def test_a_swing_at_the_start_is_no_part_of_the_model() -> None:
    generator = np.random.default_rng(9)
    u = np.sign(generator.standard_normal(N // 2)).repeat(2)
    whole = lfilter(B, A, np.append(100.0, u))[1:] + 0.1 * generator.standard_normal(N)
    one = Record.from_columns(DT * np.arange(N), {"u": u, "y": whole}, ["u"], ["y"])
    found = fit("oe:2,2,2", one)
    assert abs(found["b1"] - 1.0) < 4.0 * found.sigma("b1")
    assert found.identification[0].rmse == pytest.approx(0.1, rel=0.1)


def test_feedback_and_offsets_are_named() -> None:
    generator, y, u = np.random.default_rng(10), np.zeros(N), np.zeros(N)
    noise = lfilter([1.0], D, 0.3 * generator.standard_normal(N))
    x = np.zeros(N)
    for k in range(N):
        x[k] = 0.9 * x[k - 1] + 0.5 * u[k - 1] if k else 0.0
        y[k] = x[k] + noise[k]
        u[k] = 0.3 * (np.sign(np.sin(0.05 * k)) - y[k])
    one = Record.from_columns(DT * np.arange(N), {"u": u, "y": y}, ["u"], ["y"])
    assert any("take bj" in remark for remark in fit("oe:1,1,1", one).remarks)
    found = fit("bj:1,0,1,1,1", one)
    for label, value in {"b1": 0.5, "f1": -0.9, "d1": -0.9}.items():
        assert abs(found[label] - value) < 4.0 * found.sigma(label), label
    far = record("oe", 11)
    lifted = Record.from_columns(far.time, {"u": far.inputs["u"], "y": far.outputs["y"].value + 200.0}, ["u"], ["y"])
    assert any("detrend" in remark for remark in fit("arx:2,2,2", lifted).remarks)
    assert not fit("arx:2,2,2", lifted.detrend()).offsets


@pytest.mark.parametrize(
    ("model", "reason"),
    [
        ("arx:2,2,-1", "the order -1"),
        ("arx:2,x,1", "'x' is not an order"),
        ("arx:2", "no model is called"),
        ("arx:2,0,1", "without an effect"),
        ("arx:2,2/1,1", "do not fit the inputs"),
        ("arx:60,60,1", "samples for 120 unknowns"),
        ("bj:2,2,1,2,2", "say nothing about 'c1'"),
        ("transfer:2", "no model is called"),
        ("process:P4", "no process model"),
        ("process:P1U", "no process model"),
    ],
)
def test_what_is_refused(model: str, reason: str) -> None:
    short = record("oe", 12, sigma=0.0).part(0.0, 1.5)
    with pytest.raises(IdentificationError, match=reason):
        fit(model, short)


def test_options_of_structures_are_refused() -> None:
    with pytest.raises(IdentificationError, match="no use for `values`"):
        fit("arx:2,2,1", record("arx", 1), values={"a1": 0.0})
