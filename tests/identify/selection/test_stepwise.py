"""Stepwise regression on equations whose terms are known."""

import numpy as np
import pytest
from scipy import signal

from twodof.errors import IdentificationError
from twodof.identify.selection.stepwise import stepwise

N = 1500


def candidates(seed: int) -> dict[str, np.ndarray]:
    """Pitch, rate, moment, and what might act beside them; smooth, as flights are."""
    rng = np.random.default_rng(seed)
    theta, q, moment = signal.lfilter([0.1], [1.0, -0.9], rng.standard_normal((3, N)))
    return {
        "M": moment,
        "q": q,
        "theta": theta,
        "theta^3": theta**3,
        "q|q|": q * np.abs(q),
        "M^2": moment**2,
        "theta q": theta * q,
    }


def test_it_finds_the_terms_that_are_there() -> None:
    x = candidates(1)
    y = (
        300.0 * x["M"]
        - 12.0 * x["theta"]
        - 40.0 * x["theta^3"]
        + 1.0
        + 2.0 * np.random.default_rng(2).standard_normal(N)
    )
    found = stepwise(y, x, noise=2.0)
    assert set(found.terms) == {"1", "M", "theta", "theta^3"}
    for name, truth in {"1": 1.0, "M": 300.0, "theta": -12.0, "theta^3": -40.0}.items():
        assert abs(found[name] - truth) < 3.5 * found.sigma[found.terms.index(name)], name
    assert found["q"] == 0.0
    assert found.steps[1].entered == "M"  # it explains most
    assert [one.r_squared for one in found.steps] == sorted(one.r_squared for one in found.steps)
    assert "R^2" in found.table()


def test_the_figures_are_those_of_least_squares() -> None:
    x = candidates(3)
    y = 5.0 * x["M"] + np.random.default_rng(4).standard_normal(N)
    found = stepwise(y, x, coloured=False)
    assert found.terms == ("1", "M")
    matrix = np.column_stack([np.ones(N), x["M"]])
    solved, rest, _, _ = np.linalg.lstsq(matrix, y, rcond=None)
    covariance = float(rest[0]) / (N - 2) * np.linalg.inv(matrix.T @ matrix)
    np.testing.assert_allclose(found.coefficients, solved, rtol=1e-9)
    np.testing.assert_allclose(found.sigma, np.sqrt(np.diag(covariance)), rtol=1e-9)
    # Partial F by its definition: what the sum of squares falls by, over the variance.
    alone = float(((y - y.mean()) ** 2).sum())
    assert found.steps[-1].partial_f["M"] == pytest.approx(
        (alone - float(rest[0])) / (float(rest[0]) / (N - 2)), rel=1e-9
    )
    assert found.steps[-1].pse == pytest.approx(float(rest[0]) / N + float(np.var(y)) * 2 / N, rel=1e-9)


@pytest.mark.parametrize("coloured", [True, False])
def test_coloured_noise_draws_in_terms_unless_it_is_counted(coloured: bool) -> None:
    drawn = 0
    for seed in range(30):
        x = candidates(100 + seed)
        noise = signal.lfilter([1.0], [1.0, -0.95], np.random.default_rng(seed).standard_normal(N))
        # The noise variance is given low, so that the partial F alone decides.
        found = stepwise(20.0 * x["M"] + noise, x, always=["M"], noise=0.0, coloured=coloured)
        drawn += len(found.terms) - 2
    # 180 wrong terms could come in, of which chance at 5 % takes 9; the best of six is looked at each time.
    assert drawn < 30 if coloured else drawn > 60


def test_a_term_that_others_replace_leaves_again() -> None:
    rng = np.random.default_rng(6)
    a, b = rng.standard_normal((2, N))
    x = {"a": a, "b": b, "both": a + b + 0.5 * rng.standard_normal(N)}
    found = stepwise(a + b + 0.1 * rng.standard_normal(N), x, noise=0.1)
    assert found.steps[1].entered == "both"
    assert any(one.removed == "both" for one in found.steps)
    assert set(found.terms) == {"1", "a", "b"}


def test_an_exact_equation_ends_when_nothing_is_left() -> None:
    x = candidates(6)
    found = stepwise(2.0 * x["q"] - x["M"], x)
    assert set(found.terms) == {"1", "q", "M"}
    assert found["q"] == pytest.approx(2.0, rel=1e-9)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"response": np.full(N, 2.0)}, "response is constant"),
        ({"response": np.full(N, np.nan)}, "NaN"),
        ({"response": []}, "shape"),
        ({"response": "text"}, "not an array of numbers"),
        ({"response": 1e200 * np.arange(N)}, "its squares must be numbers"),
        ({"noise": np.nan}, "noise is nan"),
        ({"candidates": [1.0]}, "not terms by name"),
        ({"candidates": {}}, "0 candidates"),
        ({"candidates": {"a": np.ones(3)}}, "3 rows"),
        ({"candidates": {"a": np.ones(N)}}, "constant"),
        ({"always": ["z"]}, "no term 'z'"),
        ({"enter": 1.0, "remove": 2.0}, "remove <= enter"),
        ({"candidates": {"a": np.arange(N), "b": 2.0 * np.arange(N)}, "always": ["a", "b"]}, "repeat each other"),
    ],
)
def test_bad_input_is_refused_with_a_reason(change: dict[str, object], reason: str) -> None:
    given = {"response": candidates(0)["q"], "candidates": {"M": candidates(0)["M"]}} | change
    with pytest.raises(IdentificationError, match=reason):
        stepwise(**given)  # type: ignore[arg-type]
