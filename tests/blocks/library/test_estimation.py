"""Recursive least squares against least squares of all data at once."""

import numpy as np
import pytest

from twodof.blocks import Diagram
from twodof.blocks.library import RecursiveLeastSquares
from twodof.blocks.schema import from_json, to_json
from twodof.compile import build

DT = 0.01
TRUTH = np.array([2.0, -1.0, 0.5])


def run(block: RecursiveLeastSquares, phi: np.ndarray, y: np.ndarray, learn: np.ndarray | None = None) -> dict:
    d = Diagram("fit")
    d.input("phi", width=block.width)
    d.input("y")
    d.input("learn", "bool")
    d.add("fit", block, phi="phi", y="y", learn="learn")
    for name in ("theta", "sigma", "error"):
        d.output(name, f"fit.{name}")
    learn = np.ones(y.size, dtype=bool) if learn is None else learn
    return build(from_json(to_json(d)), dt=DT).machine().run(y.size, {"phi": phi, "y": y, "learn": learn})


def data(steps: int, width: int, noise: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(steps)
    phi = rng.standard_normal((steps, width))
    return phi, phi @ TRUTH[:width] + noise * rng.standard_normal(steps)


def test_without_forgetting_it_is_the_batch_solution() -> None:
    phi, y = data(300, 3)
    start, sigma, noise = np.array([1.0, 0.0, 0.0]), np.array([2.0, 1.0, 1.0]), 0.2
    found = run(RecursiveLeastSquares(3, noise=noise, initial=start.tolist(), initial_sigma=sigma.tolist()), phi, y)
    # The start is three more rows: theta_i = start_i, each with its own sigma. Output k has seen the rows before k.
    rows = np.vstack([phi[:-1], np.diag(noise / sigma)])
    right = np.concatenate([y[:-1], start * noise / sigma])
    batch, rest = np.linalg.lstsq(rows, right, rcond=None)[:2]
    np.testing.assert_allclose(found["theta"][-1], batch, rtol=1e-9)
    variance = (float(rest[0]) + noise**2) / (y.size - 1 + 1)
    covariance = variance * np.linalg.inv(rows.T @ rows)
    np.testing.assert_allclose(found["sigma"][-1], np.sqrt(np.diag(covariance)), rtol=1e-9)
    assert found["sigma"][0] == pytest.approx(sigma)


def test_with_a_memory_it_follows_a_change() -> None:
    rng = np.random.default_rng(4)
    phi = rng.standard_normal((1000, 1))
    gain = np.where(np.arange(1000) < 500, 2.0, 3.0)
    y = gain * phi[:, 0]
    found = run(RecursiveLeastSquares(memory=0.5, noise=0.1, initial_sigma=10.0), phi, y)["theta"][:, 0]
    kept = np.exp(-DT / 0.5)
    # One unknown: restricted forgetting is R' = l (R + phi^2), weights l^age, whatever phi is.
    weight = kept ** np.arange(999, 0, -1) * phi[:-1, 0] ** 2
    assert found[-1] == pytest.approx(float(weight @ gain[:-1]) / float(weight.sum()), rel=1e-6)
    assert found[499] == pytest.approx(2.0, abs=1e-3)
    assert run(RecursiveLeastSquares(noise=0.1, initial_sigma=10.0), phi, y)["theta"][-1, 0] == pytest.approx(
        2.5, abs=0.1
    )


def test_without_excitation_nothing_is_forgotten() -> None:
    phi, y = data(500, 2)
    long = np.vstack([phi, np.zeros((5000, 2))])
    block = RecursiveLeastSquares(2, memory=0.3, noise=0.1)
    rest = run(block, long, np.concatenate([y, np.ones(5000)]))
    np.testing.assert_array_equal(rest["theta"][-1], rest["theta"][500])
    np.testing.assert_array_equal(rest["sigma"][-1], rest["sigma"][500])


def test_only_what_it_is_told_to_learn_and_only_numbers_count() -> None:
    phi, y = data(400, 3)
    clean = run(RecursiveLeastSquares(3), phi, y)["theta"][-1]
    spoilt, said = (
        np.vstack([phi, np.full((3, 3), np.nan), phi[:2]]),
        np.concatenate([y, [1.0, 1.0, 1.0], [np.inf, 5e9]]),
    )
    learn = np.ones(405, dtype=bool)
    learn[[399, 404]] = False
    found = run(RecursiveLeastSquares(3), spoilt, said, learn)["theta"]
    before = run(RecursiveLeastSquares(3), phi[:400], y[:400])["theta"][399]
    np.testing.assert_array_equal(found[-1], before)
    assert np.isfinite(clean).all()


def test_of_several_samples_one_is_taken() -> None:
    phi, y = data(400, 2)
    each = run(RecursiveLeastSquares(2, every=5), phi, y)["theta"][-1]
    np.testing.assert_allclose(each, run(RecursiveLeastSquares(2), phi[::5], y[::5])["theta"][-1], rtol=0.01)
    np.testing.assert_allclose(each, run(RecursiveLeastSquares(2), phi[:396:5], y[:396:5])["theta"][-1], atol=0.02)
