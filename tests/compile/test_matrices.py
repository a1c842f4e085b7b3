"""Matrices as ports, states and parameters: numpy and scipy judge the numbers, the reference every target's bits."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from twodof.blocks import Block, Diagram, Param, Port, State, concatenate, cross, eye, matrix, norm, sum, vector
from twodof.blocks.reference import Reference
from twodof.compile import build
from twodof.compile.linear.linearize import linearize
from twodof.errors import DiagramError, ParameterError

pytestmark = pytest.mark.slow

Array = NDArray[np.float64]
PRECISIONS = ("float64", "float32")
STEPS = 12


RANDOM = np.random.default_rng(5)


class Attitude(Block):
    """A unit quaternion (scalar last) that a body turns with the rate w [rad/s]."""

    inputs = (Port("w", width=3, unit="rad/s"),)
    outputs = (Port("q", width=4), Port("R", shape=(3, 3)))
    states = (State("q", [0.0, 0.0, 0.0, 1.0], width=4, continuous=True),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        v, s = x.q[0:3], x.q[-1]
        skew = matrix([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
        return {"q": x.q, "R": eye(3) + 2 * (s * skew + skew @ skew)}

    def derivative(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        v, s = x.q[0:3], x.q[-1]
        return 0.5 * concatenate([s * u.w + cross(v, u.w), vector([-(v @ u.w)])])

    def project(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return x.q / norm(x.q)


def test_a_quaternion_turns_as_scipys_rotation_does() -> None:
    d = Diagram("body")
    d.input("w", width=3, unit="rad/s")
    d.add("attitude", Attitude(), w="w")
    d.output("q", "attitude.q")
    d.output("R", "attitude.R")
    w, dt, steps = [0.3, -0.8, 1.1], 0.01, 200
    machine = build(d, dt, optimise="-O1").machine()
    out = machine.run(steps + 1, {"w": w})
    turned = Rotation.from_rotvec(np.array(w) * dt * steps)
    # RK4: an error of (|w| dt)^5 / 3840 a step at most.
    most = steps * (np.linalg.norm(w) * dt) ** 5 / 3840 + 1e-13
    assert np.max(np.abs(out["q"][-1] - turned.as_quat(canonical=True))) < most
    assert np.max(np.abs(out["R"][-1] - turned.as_matrix())) < 4 * most
    expected = Reference(d, dt).machine().run(21, {"w": w})
    assert np.array_equal(out["R"][:21], expected["R"])


def language_page_filter() -> Diagram:
    """Return the diagram of the language page's example of matrices."""
    page = (Path(__file__).parents[2] / "docs" / "explanation" / "language.md").read_text()
    (example,) = (b for b in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "KalmanFilter" in b)
    made: dict[str, Any] = {}
    exec(example, made)
    d: Diagram = made["d"]
    return d


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_the_kalman_filter_of_the_language_page_is_numpys(precision: str) -> None:
    z = 0.5 + 0.2 * RANDOM.normal(size=100)
    machine = build(language_page_filter(), 0.01, precision, optimise="-O1").machine()
    out = machine.run(100, {"z": z})
    a, h, x, P = np.array([[1, 0.01], [0, 1]]), np.array([1.0, 0.0]), np.zeros(2), np.eye(2)
    for measured in z:
        x, P = a @ x, a @ P @ a.T + np.diag([1e-6, 1e-4])
        gain = P @ h / (h @ P @ h + 0.04)
        x, P = x + gain * (measured - h @ x), P - np.outer(gain, h @ P)
    # A step adds a few roundings of numbers near 1, which the filter does not amplify.
    most = 100 * np.finfo(precision).eps
    assert np.allclose(out["x"][-1], x, rtol=0, atol=most)
    assert np.allclose(out["P"][-1], P, rtol=0, atol=most)
    assert np.array_equal(machine.state("filter.P"), out["P"][-1])


def test_a_matrix_of_a_linear_model_names_its_elements() -> None:
    model = linearize(total(shape=(2, 3)), 0.1)
    assert model.inputs == ("m[0,0]", "m[1,0]", "m[0,1]", "m[1,1]", "m[0,2]", "m[1,2]")
    assert model.outputs[1:] == model.inputs
    assert np.array_equal(model.d, np.vstack([np.ones(6), np.eye(6)]))


class Total(Block):
    """The sum of a matrix, and the matrix."""

    inputs = (Port("m", shape=(2, 3)),)
    outputs = (Port("y"), Port("m", shape=(2, 3)))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"y": sum(u.m), "m": u.m}


def total(**source: Any) -> Diagram:
    d = Diagram("total")
    d.input("m", **source)
    d.add("total", Total(), m="m")
    d.output("y", "total.y")
    d.output("m", "total.m")
    return d


@pytest.mark.parametrize("kind", ["reference", "native"])
def test_values_are_rows_wherever_they_go_in_or_out(kind: str) -> None:
    d = total(shape=(2, 3))
    machine = (Reference(d, 0.1) if kind == "reference" else build(d, 0.1, optimise="-O1")).machine()
    rows = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.5]]
    assert machine.step({"m": rows}) == {"y": 21.5, "m": rows}
    assert machine.step({"m": np.array(rows)})["m"] == rows
    several = RANDOM.normal(size=(4, 2, 3))
    assert np.array_equal(machine.run(4, {"m": several})["m"], several)
    assert machine.run(2, {"m": rows})["m"].tolist() == [rows, rows]
    for bad in ([1.0] * 6, [[1.0, 2.0]] * 3, [[1.0, 2.0, 3.0], [4.0]]):
        with pytest.raises(DiagramError, match="2x3"):
            machine.step({"m": bad})
    with pytest.raises(DiagramError, match=r"shape \(2, 3\)"):
        machine.run(2, {"m": np.zeros((2, 3, 2))})


def test_a_parameter_has_the_declared_shape() -> None:
    machine = Reference(language_page_filter(), 0.01).machine()
    machine.set("filter.A", [[1.0, 2.0], [3.0, 4.0]])
    assert machine.get("filter.A") == [[1.0, 2.0], [3.0, 4.0]]
    with pytest.raises(ParameterError, match=r"the value is 1x2, and the array 2x2.*list of rows"):
        machine.set("filter.A", [[1.0, 2.0]])
    with pytest.raises(DiagramError, match="the value is 4, and the array 2x2"):
        Param("k", [1.0, 2.0, 3.0, 4.0], shape=(2, 2))
    with pytest.raises(DiagramError, match="width 5 does not fit the shape 2x2"):
        Port("k", width=5, shape=(2, 2))
    with pytest.raises(DiagramError, match="not one of a matrix"):
        Port("k", shape=(2, 0))


@pytest.mark.parametrize(("source", "given"), [({"width": 6}, r"real\[6\]"), ({"shape": (3, 2)}, r"real\[3x2\]")])
def test_ports_of_different_shapes_do_not_connect(source: Any, given: str) -> None:
    for target in (Reference, build):
        with pytest.raises(DiagramError, match=rf"it takes real\[2x3\] and m (gives|is) {given}") as caught:
            target(total(**source), 0.1)
        assert caught.value.where == "total.m"


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (lambda m: m.T, "an array of 3x2, and is a real.2x3"),
        (lambda m: m[0], "an array of 3, and is a real.2x3"),
        (lambda m: 1.0, "and is a real.2x3"),
        (lambda m: [[1.0, 2.0], [m[0, 0], 4.0]], "an array of 2x2, and is a real.2x3"),
    ],
)
def test_a_method_gives_the_declared_shape(value: Any, message: str) -> None:
    class Wrong(Total):
        outputs = (Port("m", shape=(2, 3)),)

        def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
            return value(u.m)

    with pytest.raises(DiagramError, match=message):
        _ = Wrong().trace


class Square(Block):
    """m m^T, transposed."""

    inputs = (Port("m", shape=(4, 3)),)
    outputs = (Port("y", shape=(4, 4)),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return (u.m @ u.m.T).T


def test_the_linear_model_of_a_product_is_its_derivative() -> None:
    d = Diagram("square")
    d.input("m", shape=(4, 3))
    d.add("square", Square(), m="m")
    d.output("y", "square.y")
    m = RANDOM.normal(size=(4, 3))
    model = linearize(d, 0.1, at={"m": m.tolist()})
    # d(m m^T) = dm m^T + m dm^T, column after column.
    units = np.eye(12).reshape(12, 3, 4).swapaxes(1, 2)
    slopes = [(one @ m.T + m @ one.T).ravel(order="F") for one in units]
    assert np.allclose(model.d, np.array(slopes).T, rtol=0, atol=1e-14)
