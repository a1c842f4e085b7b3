"""Linear models with several inputs against scipy's: held, moving on, in discrete time; and what is refused."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import cont2discrete, dlsim, lsim

from twodof.errors import IdentificationError
from twodof.identify import Record, fit, simulate
from twodof.models import Structure, linear_model

N, DT = 600, 0.01
T = DT * np.arange(N)
A, B = np.array([[0.0, 1.0], [-30.0, -1.5]]), np.array([[0.0, 0.0], [4.0, -1.0]])
C, D = np.eye(2), np.array([[0.0, 0.0], [0.3, 0.0]])
TRUE = {"k": 30.0, "c": 1.5, "g": 4.0, "h": -1.0, "f": 0.3}
U = np.repeat(np.random.default_rng(0).standard_normal((N // 5, 2)), 5, axis=0)


def spring(**options: Any) -> Structure:
    return linear_model(
        [[0, 1], ["-k", "-c"]],
        [[0, 0], ["g", "h"]],
        [[1, 0], [0, 1]],
        [[0, 0], ["f", 0]],
        inputs=["u", "w"],
        outputs=["y", "z"],
        guess={"k": 20.0, "c": 1.0, "g": 3.0, "h": -2.0, "f": 0.4},
        **options,
    )


def record(y: NDArray[np.float64], hold: str = "zoh") -> Record:
    table = {"u": U[:, 0], "w": U[:, 1], "y": y[:, 0], "z": y[:, 1]}
    return Record.from_columns(T, table, ["u", "w"], ["y", "z"], hold=hold)


def held(x0: tuple[float, float] = (0.0, 0.0)) -> NDArray[np.float64]:
    system = cont2discrete((A, B, C, D), DT)
    return np.asarray(dlsim(system, U, x0=x0)[1])


def test_held_inputs_are_exact() -> None:
    found = simulate(spring(), record(C[[0] * N]), {**TRUE, "x1_0": 0.1, "x2_0": -2.0})
    expected = held((0.1, -2.0))
    for i, name in enumerate(("y", "z")):
        assert np.allclose(found[name], expected[:, i], atol=1e-11)  # rounding errors of 600 steps


def test_straight_lines_agree_with_scipy() -> None:
    found = simulate(spring(), record(C[[0] * N], "linear"), TRUE)
    _, expected, _ = lsim((A, B, C, D), U, T, interp=True)
    for i, name in enumerate(("y", "z")):
        # The fifth power of the step over a radian, .01 * 5.5, and D reads the sample itself.
        assert np.allclose(found[name], expected[:, i], atol=1e-7)


def test_discrete_time_is_the_matrices_themselves() -> None:
    phi, gamma, *_ = cont2discrete((A, B, C, D), DT)
    model = linear_model(
        phi, gamma, C.tolist(), [["f", 0], [0.3, 0]],
        inputs=["u", "w"], outputs=["y", "z"], guess={"f": 0.0}, discrete=True,
    )  # fmt: skip
    found = simulate(model, record(C[[0] * N]))
    for i, name in enumerate(("y", "z")):
        assert np.allclose(found[name], held()[:, i], atol=1e-11)


def test_a_fit_finds_matrices_feed_through_offsets_and_trims() -> None:
    generator = np.random.default_rng(1)
    noisy = held() + [0.5, 0.0] + generator.standard_normal((N, 2)) * [0.01, 0.05]
    model = spring()
    found = fit(model, record(noisy), estimate=(*model.estimate, "y_bias"))
    for name, value in {**TRUE, "y_bias": 0.5}.items():
        assert abs(found[name] - value) < 4.0 * found.sigma(name)
        assert found.sigma(name) < 0.1 * abs(value)
    trimmed = simulate(model, record(noisy), {**TRUE, "u_trim": 0.2})["z"]
    assert trimmed[0] == pytest.approx(0.3 * (U[0, 0] - 0.2), abs=1e-12)


def test_what_is_refused() -> None:
    with pytest.raises(IdentificationError, match="'k' has no first guess"):
        linear_model([["-k"]], [[1]], [[1]], inputs=["u"], outputs=["y"], guess={})
    with pytest.raises(IdentificationError, match="no element of a matrix is called 'q'"):
        linear_model([["-k"]], [[1]], [[1]], inputs=["u"], outputs=["y"], guess={"k": 1.0, "q": 2.0})
    with pytest.raises(IdentificationError, match="names two unknowns"):
        linear_model([["x1_0"]], [[1]], [[1]], inputs=["u"], outputs=["y"], guess={"x1_0": 1.0})
    for b in ([[1, 2]], [[1], [2]], []):
        with pytest.raises(IdentificationError, match="`b` is not 1 rows of 1"):
            linear_model([[-1]], b, [[1]], inputs=["u"], outputs=["y"], guess={})  # type: ignore[arg-type]
    for one in ("u", [1]):
        with pytest.raises(IdentificationError, match="give a list of names"):
            linear_model([[-1]], [[1]], [[1]], inputs=one, outputs=["y"], guess={})  # type: ignore[arg-type]
    for a in (["k"], [1], ["-"]):
        with pytest.raises(IdentificationError, match="`a` is not 1 rows of 1"):
            linear_model(a, [[1]], [[1]], inputs=["u"], outputs=["y"], guess={"k": 1.0})  # type: ignore[arg-type]
    with pytest.raises(IdentificationError, match="'k' has no first guess"):
        linear_model([["k"]], [[1]], [[1]], inputs=["u"], outputs=["y"], guess={"k": "1"})  # type: ignore[dict-item]
    for entry in (float("nan"), "-", "2k", None, True):
        with pytest.raises(IdentificationError, match="`a` holds"):
            linear_model([[entry]], [[1]], [[1]], inputs=["u"], outputs=["y"], guess={})  # type: ignore[list-item]
    with pytest.raises(IdentificationError, match=r"no first guess.*finite numbers"):
        linear_model([["-k"]], [[1]], [[1]], inputs=["u"], outputs=["y"], guess={"k": float("inf")})
    with pytest.raises(IdentificationError, match="0 states"):
        linear_model([], [], [], inputs=["u"], outputs=["y"], guess={})
    with pytest.raises(IdentificationError, match="0 inputs"):
        linear_model([[-1]], [[]], [[1]], inputs=[], outputs=["y"], guess={})
