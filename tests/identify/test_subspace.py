"""Linear models by subspaces: exact without noise, near the bound with it, and a start for the fit."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import cont2discrete, dlsim

from twodof.errors import IdentificationError
from twodof.identify import Record, fit, subspace

pytestmark = pytest.mark.slow

N, DT = 800, 0.01
A = np.array([[0.0, 1.0, 0.0], [-30.0, -1.5, 0.0], [1.0, 0.0, -2.0]])
B, C = np.array([[0.0, 0.0], [4.0, -1.0], [0.0, 3.0]]), np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 1.0]])
D = np.array([[0.0, 0.0], [0.3, 0.0]])
POLES = np.sort_complex(np.linalg.eigvals(A))
U = np.repeat(np.random.default_rng(0).standard_normal((N // 5, 2)), 5, axis=0)


def outputs() -> NDArray[np.float64]:
    _, y, _ = dlsim(cont2discrete((A, B, C, D), DT), U, x0=(0.1, -0.3, 0.4))
    return np.asarray(y + np.array([0.5, -0.2]))


def record(y: NDArray[np.float64]) -> Record:
    table = {"u": U[:, 0], "w": U[:, 1], "y": y[:, 0], "z": y[:, 1]}
    return Record.from_columns(DT * np.arange(N), table, ["u", "w"], ["y", "z"])


def test_without_noise_the_model_is_exact() -> None:
    model = subspace(record(outputs()), feed_through=True)
    assert model.order == 3
    assert np.allclose(np.sort_complex(model.poles()), POLES, atol=1e-8)
    assert np.allclose(model.d, D, atol=1e-9)
    assert np.allclose(model.bias, [0.5, -0.2], atol=1e-8)
    assert np.allclose(model.simulate(U), outputs(), atol=1e-9)


def test_it_starts_a_fit_with_right_intervals() -> None:
    clean = outputs()
    noise = 0.05 * clean.std(axis=0)
    noisy = record(clean + noise * np.random.default_rng(1).standard_normal(clean.shape))
    model = subspace(noisy, feed_through=True)
    assert model.order == 3
    error = model.simulate(U) - clean
    assert (np.sqrt(np.mean(error**2, axis=0)) < 0.5 * noise).all()  # 26 unknowns of 1600 samples tell .13
    found = fit(model.structure(feed_through=True), noisy)
    # The poles as the structure's own parameters: 30 and 1.5 of the pair, 2 of the lag; D; the offsets.
    pair = next(label for label in found.labels if label.startswith("stiffness"))
    real = next(label for label in found.labels if label.startswith("rate"))
    damping = pair.replace("stiffness", "damping")
    truth = {pair: 30.0, damping: 1.5, real: 2.0, "d_z_u": 0.3, "d_y_u": 0.0, "y_bias": 0.5, "z_bias": -0.2}
    for label, value in truth.items():
        assert abs(found[label] - value) < 4.0 * found.cramer_rao(label), label
    for compared, sigma in zip(found.identification, noise, strict=True):
        assert compared.rmse == pytest.approx(sigma, rel=0.1)


def test_growing_modes_become_decaying_ones() -> None:
    u = np.random.default_rng(3).standard_normal(300)
    noise = np.random.default_rng(4).standard_normal((300, 2))
    table = {"u": u, "y": noise[:, 0], "z": np.cumsum(noise[:, 1])}
    wild = Record.from_columns(DT * np.arange(300), table, ["u"], ["y", "z"])
    for order in (1, 3, 6):
        model = subspace(wild, order=order)
        assert np.abs(np.linalg.eigvals(model.a)).max() <= 1.0 + 1e-12
        assert np.isfinite(model.simulate(u[:, None])).all()


def test_what_is_refused() -> None:
    good = record(outputs())
    for order in (0, 99, 2.5, "x"):
        with pytest.raises(IdentificationError, match="the order"):
            subspace(good, order=order)  # type: ignore[arg-type]
    still = Record.from_columns(DT * np.arange(N), {"u": 0.0 * U[:, 0], "y": U[:, 1]}, ["u"], ["y"])
    with pytest.raises(IdentificationError, match="'u' is constant"):
        subspace(still)
    step = Record.from_columns(DT * np.arange(N), {"u": 1.0 * (np.arange(N) > 400), "y": U[:, 1]}, ["u"], ["y"])
    assert subspace(step, order=1).order == 1
    sine = Record.from_columns(DT * np.arange(N), {"u": np.sin(np.arange(N)), "y": U[:, 1]}, ["u"], ["y"])
    with pytest.raises(IdentificationError, match="do not excite"):
        subspace(sine)
    late = Record.from_channels({"u": (good.time, U[:, 0]), "y": (good.time[5:], U[5:, 1])}, ["u"], ["y"])
    with pytest.raises(IdentificationError, match="not sampled at each step"):
        subspace(late)
    short = Record.from_columns(DT * np.arange(6), {"u": U[:6, 0] + np.arange(6), "y": U[:6, 1]}, ["u"], ["y"])
    with pytest.raises(IdentificationError, match="6 samples"):
        subspace(short)
