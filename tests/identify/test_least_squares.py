"""The minimiser against scipy and on problems whose minimum is known."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

from twodof.identify.least_squares import minimise

Array = NDArray[np.float64]
FREE = np.array([np.inf, np.inf])


def rosenbrock(x: Array) -> Array:
    return np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])


def rosenbrock_jacobian(x: Array, _: Array) -> Array:
    return np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]])


def test_the_curved_valley_is_followed_to_its_end() -> None:
    found = minimise(rosenbrock, rosenbrock_jacobian, np.array([-1.2, 1.0]), -FREE, FREE)
    assert found.converged
    np.testing.assert_allclose(found.x, [1.0, 1.0], rtol=1e-6)


@pytest.mark.parametrize("upper", [[0.5, np.inf], [np.inf, 0.2], [0.3, 0.05]])
def test_bounded_minimum_is_that_of_scipy(upper: list[float]) -> None:
    high = np.array(upper)
    start = np.array([-1.2, 0.0])
    found = minimise(rosenbrock, rosenbrock_jacobian, start, -FREE, high, iterations=300)
    theirs = least_squares(rosenbrock, start, bounds=(-FREE, high), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert (found.x <= high).all()
    assert found.converged
    # The cost is flat at the minimum: 1e-8 of it is 1e-4 of x.
    assert found.cost == pytest.approx(theirs.cost, rel=1e-8)
    np.testing.assert_allclose(found.x, theirs.x, atol=1e-4)
    assert (found.at_bound == (found.x == high)).all()


@pytest.mark.parametrize(("bend", "most"), [(-0.5, 5), (0.9, 30)])
def test_large_residuals_that_bend_take_few_steps(bend: float, most: int) -> None:
    # Near the minimum, x = 0, Gauss-Newton steps are 1.5 and .1 times as long as they should be: 20 and 84 of them.
    def residual(x: Array) -> Array:
        return np.array([x[0] + 1.0, bend * x[0] ** 2 + x[0] - 1.0])

    def jacobian(x: Array, _: Array) -> Array:
        return np.array([[1.0], [2.0 * bend * x[0] + 1.0]])

    found = minimise(residual, jacobian, np.array([0.3]), -FREE[:1], FREE[:1], tolerance=1e-12)
    assert found.converged
    assert found.iterations <= most
    assert abs(found.x[0]) < 1e-4


def test_a_search_that_ends_without_a_jacobian_has_not_converged() -> None:
    def jacobian(x: Array, _: Array) -> Array:
        return rosenbrock_jacobian(x, _) if x[0] == -1.2 else np.full((2, 2), np.nan)

    found = minimise(rosenbrock, jacobian, np.array([-1.2, 1.0]), -FREE, FREE, iterations=1)
    assert not found.converged
    assert np.isfinite(found.x).all()


def test_a_step_cut_by_a_bound_still_descends() -> None:
    # The full step crosses the bound of x0 and, cut there, would go uphill: the others must be solved for again.
    rng = np.random.default_rng(0)
    matrix = np.array([[1.0, 0.999], [0.0, 0.02]]) + 0.0 * rng.standard_normal((2, 2))
    target = np.array([3.0, -1.0])

    def residual(x: Array) -> Array:
        return matrix @ x - target

    low, high = np.array([-1.0, -1.0]), np.array([1.0, 100.0])
    found = minimise(residual, lambda x, r: matrix, np.zeros(2), low, high)
    theirs = least_squares(residual, np.zeros(2), bounds=(low, high), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    np.testing.assert_allclose(found.x, theirs.x, atol=1e-6)


def test_the_search_steps_back_from_infinite_models() -> None:
    def residual(x: Array) -> Array:
        with np.errstate(invalid="ignore"):
            return np.array([np.log(x[0]) - 1.0, 0.1 * (x[0] - 3.0)])

    def jacobian(x: Array, _: Array) -> Array:
        return np.array([[1.0 / x[0]], [0.1]])

    one = np.array([np.inf])
    found = minimise(residual, jacobian, np.array([50.0]), -one, one)
    assert found.converged
    assert found.x[0] == pytest.approx(2.74, abs=0.02)


def test_running_out_of_iterations_is_said() -> None:
    found = minimise(rosenbrock, rosenbrock_jacobian, np.array([-1.2, 1.0]), -FREE, FREE, iterations=3)
    assert found.iterations == 3
    assert not found.converged
