"""Margins against python-control's, on 50 random loops: ours by states, its by polynomials."""

from collections.abc import Callable

import control
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal

from bench.computing.random_loops import COUNT, Floats, RandomLoop, random_loop
from twodof.compile.linear.linear_model import LinearModel
from twodof.design import LoopMargins, LoopTransfer, closed_loop_poles, margins
from twodof.errors import CompileError, ParameterError
from twodof.sim.linear import cascade_loop

pytestmark = pytest.mark.slow


def ours(loop: RandomLoop) -> LoopMargins:
    a, b, c, d = signal.tf2ss(loop.numerator, loop.denominator)
    return margins(LoopTransfer(a, b, c, float(d[0, 0]), loop.dt))


def nyquist(loop: RandomLoop) -> float:
    return np.inf if loop.dt is None else np.pi / loop.dt


def inside(omega: NDArray[np.float64], loop: RandomLoop) -> NDArray[np.bool_]:
    """Frequencies that both look at: it takes 0 and the Nyquist frequency by chance of a rounding, we always."""
    return (omega > 1e-6) & (omega < nyquist(loop) * (1.0 - 1e-6))


@pytest.mark.parametrize("seed", range(COUNT))
def test_all_crossings_are_python_controls(seed: int) -> None:
    loop = random_loop(seed)
    system = control.tf(loop.numerator, loop.denominator, 0 if loop.dt is None else loop.dt)
    found = ours(loop)
    factors, phases, _, at_gain, at_phase, _ = control.stability_margins(system, returnall=True, method="poly")
    keep = inside(at_gain, loop) & (factors < 1e4)
    mine = [g for g in found.gains if inside(np.array([g.omega]), loop)[0]]
    # Polynomials of up to 26 powers in w lose some ten of the sixteen digits.
    np.testing.assert_allclose([g.omega for g in mine], at_gain[keep], rtol=1e-5)
    np.testing.assert_allclose([g.factor for g in mine], factors[keep], rtol=1e-5)
    keep = inside(at_phase, loop)
    np.testing.assert_allclose([p.omega for p in found.phases], at_phase[keep], rtol=1e-5)
    np.testing.assert_allclose(np.degrees([p.phase for p in found.phases]), phases[keep], rtol=1e-5, atol=1e-3)


def peak(size: Callable[[Floats], Floats], top: float) -> float:
    """The largest value on a grid, which is made finer about its best point until its steps are 1e-5."""
    omega = np.geomspace(1e-5, top, 3000)
    for _ in range(2):
        values = size(omega)
        k = int(np.argmax(values))
        omega = np.geomspace(omega[max(k - 1, 0)], omega[min(k + 1, len(omega) - 1)], 500)
    return float(size(omega).max())


@pytest.mark.parametrize("seed", range(COUNT))
def test_stability_peaks_and_disk_margin_are_python_controls(seed: int) -> None:
    loop = random_loop(seed)
    system = control.tf(loop.numerator, loop.denominator, 0 if loop.dt is None else loop.dt)
    found = ours(loop)
    closed = control.feedback(system, 1)
    poles = closed.poles()
    worst = float(poles.real.max() if loop.dt is None else np.log(np.abs(poles).max()) / loop.dt)
    assert found.stable is (worst < 0.0)
    if not found.stable:
        return
    top = min(1e5, nyquist(loop))

    def response(omega: Floats) -> NDArray[np.complex128]:
        return np.asarray(system(1j * omega if loop.dt is None else np.exp(1j * omega * loop.dt)))

    for mine, theirs in (
        (found.ms, peak(lambda w: np.abs(1.0 / (1.0 + response(w))), top)),
        (found.mt, peak(lambda w: np.abs(response(w) / (1.0 + response(w))), top)),
        (1.0 / found.disk.alpha, 1.0 / control.disk_margins(system, np.clip([found.disk.omega], 1e-5, top))[0]),
        (1.0 / found.disk.alpha, peak(lambda w: np.abs(1.0 / (1.0 + response(w)) - 0.5), top)),
    ):
        assert mine == pytest.approx(theirs, rel=1e-6)  # the grid stops 1e-5 short of 0 and of infinity


@pytest.mark.parametrize("seed", range(COUNT))
def test_at_the_gain_margin_stability_ends(seed: int) -> None:
    a, b, c, d = signal.tf2ss((loop := random_loop(seed)).numerator, loop.denominator)
    one = LoopTransfer(a, b, c, float(d[0, 0]), loop.dt)
    found = margins(one)
    for crossing in (found.increase, found.decrease):
        if found.stable and crossing is not None and one.d >= 0.0:
            rims = [closed_loop_poles(one.scaled(crossing.factor ** (1.0 + s))) for s in (-1e-4, 1e-4)]
            inside, beyond = (p.real.max() if loop.dt is None else np.abs(p).max() - 1.0 for p in rims)
            assert inside < 0.0 < beyond


@pytest.mark.long
@pytest.mark.parametrize("loop", ["motors", "rate", "attitude"])
def test_python_controls_margin_of_a_cascade_loop_is_ours(loop: str) -> None:
    """A state space of 51 states gives .346 and -49 deg for the rate loop: its polynomials lose all digits."""
    ours = margins(cascade_loop(loop))
    factor, degrees, _, _ = control.margin(cascade_loop(loop).to_control())
    assert (factor, degrees) == pytest.approx((ours.gain_margin, ours.phase_margin_deg), rel=1e-6)


@pytest.mark.long
def test_python_control_draws_a_loop_and_its_closed_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MPLBACKEND", "Agg")
    from matplotlib import pyplot as plt

    loop = cascade_loop("rate").to_control()
    closed = control.frd(control.feedback(loop), name="closed")  # feedback drops the name
    for system, title in ((loop, "Bode plot for rate"), (closed, "Bode plot for closed")):
        drawn = control.bode_plot(system)
        assert drawn.figure.get_suptitle() == title
        np.testing.assert_allclose(drawn.lines[0, 0][0].get_ydata(), np.abs(system.frdata[0, 0]))
        plt.close("all")


def test_names_go_to_python_control() -> None:
    """Dots become `_`; `scaled` keeps the names, and `times` takes those of its ends."""
    one, c, d = np.eye(1), np.ones((2, 1)), np.zeros((2, 1))
    plant = LinearModel(one, one, c, d, 0.01, ("x",), ("M",), ("theta", "imu.q"), name="a.b")
    loop = LoopTransfer.of(plant, "M", "imu.q")
    for system in (loop.to_control(), loop.state_space(), LoopTransfer.of(loop, "M", "imu.q").scaled(2.0).to_control()):
        assert (system.name, system.input_labels, system.output_labels) == ("a_b", ["M"], ["imu_q"])
    product = LoopTransfer.of_gain(2.0, 0.01).times(loop).to_control()
    assert (product.name, product.input_labels, product.output_labels) == ("loop", ["M"], ["y"])


@pytest.mark.long
def test_a_system_of_python_control_comes_back() -> None:
    """In both directions, with names and sample time; a continuous loop with a delay goes by its response."""
    system = control.ss([[0.9, 0.1], [0.0, 0.8]], [[0.0], [1.0]], [[1.0, 0.0]], 0.5, 0.01, inputs=["M"], outputs=["q"])
    model = LinearModel.from_control(system)
    assert (model.inputs, model.outputs, model.dt) == (("M",), ("q",), 0.01)
    back = model.to_control()
    assert all(np.array_equal(getattr(back, name), getattr(system, name)) for name in "ABCD")
    assert LoopTransfer.from_control(system).state_space().nstates == 2
    loop = LoopTransfer.from_control(control.tf([10], [1, 1]))
    late = LoopTransfer(loop.a, loop.b, loop.c, 0.0, delay=0.1)
    assert control.margin(late.to_control())[:2] == pytest.approx(
        (margins(late).gain_margin, margins(late).phase_margin_deg)
    )
    with pytest.raises(ParameterError, match=r"TransferFunction.*LoopTransfer.from_control\(system\)"):
        margins(control.tf([10], [1, 1]))
    with pytest.raises(CompileError, match="give a StateSpace"):
        LinearModel.from_control("G(s)")
    with pytest.raises(CompileError, match="proper transfer function"):
        LinearModel.from_control(control.tf([1, 0, 0], [1, 1]))
    with pytest.raises(ParameterError, match=r"2 inputs and 2 outputs.*system\[0, 0\]"):
        LoopTransfer.from_control(control.ss(-np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2))))
