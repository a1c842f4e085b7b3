"""The virtual rig and the flight code as two programs give the bits of the closed loop that is compiled as one."""

from itertools import product

import numpy as np
import pytest

from twodof.errors import ParameterError
from twodof.fcu.control.flight_code import OUTPUTS, FlightCode
from twodof.fcu.control.hardware import ControlInput
from twodof.rig.parameters import load_rig
from twodof.signals import MODES
from twodof.sim.closed_loop import ARMING, ClosedLoop, InitialState
from twodof.sim.virtual_drone import VirtualRig

pytestmark = pytest.mark.slow

STEPS = 900
MEASURED = ("acc_x", "acc_z", "gyro_y", "dist", "dist_new", "dist_age", "voltage", "charge")


def schedule(rings: bool) -> dict[str, np.ndarray]:
    """Set-points that go through the modes, with steps in each; armed after `ARMING` steps."""
    time = np.arange(STEPS)
    modes = np.zeros(STEPS, dtype=np.int32)
    order = ("attitude", "rate", "open-loop", "attitude") if rings else MODES[1:]
    length = (STEPS - 60) // len(order)
    for number, name in enumerate(order):
        modes[60 + number * length : 60 + (number + 1) * length] = MODES.index(name)
    given = {
        "mode": modes,
        "thrust": np.where(modes > 0, 0.4, 0.0),
        "M_open": np.where(modes == 1, 0.02 * np.sign(np.sin(time * 0.1)), 0.0),
        "q0": 0.4 * np.sin(time * 0.05),
        "theta0": np.where(time % 200 < 100, 0.1, -0.05),
        "v0": np.where(time % 160 < 80, 0.2, -0.2),
        "x0": np.where(time % 240 < 120, 0.1, -0.1),
        "use_trim": time % 300 > 150,
    }
    quiet = modes == 0
    return {name: np.where(quiet, 0, value).astype(value.dtype) for name, value in given.items()}


# Each pair of values once; all of them in the soak.
PAIRS = (
    ("lab", False, 1.0, "float64"),
    ("lab", True, 0.0, "float32"),
    ("paper", False, 0.0, "float32"),
    ("paper", True, 1.0, "float64"),
    ("lab", True, 1.0, "float32"),
)
CASES = [
    pytest.param(*case, marks=[] if case in PAIRS else [pytest.mark.soak])
    for case in product(("lab", "paper"), (False, True), (0.0, 1.0), ("float64", "float32"))
]


@pytest.mark.parametrize(("name", "rings", "noise", "precision"), CASES)
def test_the_bits_are_those_of_the_closed_loop(name: str, rings: bool, noise: float, precision: str) -> None:
    given, seed, x = schedule(rings), 7, -0.05
    parameters = load_rig(name)
    loop = ClosedLoop(rig=parameters, precision=precision, failsafe=True)
    loop.configure({"seed": seed, "noise": noise, "rings": rings, "ring_place": x})
    # Without noise a sensor at rest repeats itself to the bit.
    loop.machine.set("flight.failsafe.sensors.watch_bits", noise > 0.0)
    loop.start(InitialState(x=x))
    expected = loop.fly(STEPS, given)

    host, code = VirtualRig(parameters, precision=precision), FlightCode(precision=precision)
    host.settle(code)
    code.set_parameters({"failsafe.sensors.watch_bits": noise > 0.0})
    code.reset(host.reset(seed, x, noise, rings))
    columns = {key: value.tolist() for key, value in given.items()}
    for k in range(STEPS):
        asked = ControlInput(
            arm=k >= ARMING, setpoint_new=True, link_new=True, **{key: value[k] for key, value in columns.items()}
        )
        sample = host.read()
        truth = host.truth
        step = code.step(k, sample, asked, host.rings, False)
        host.drive(step.fore, step.aft)
        for output in OUTPUTS:
            assert_bits(getattr(step, output), expected[output][k], f"{output} at step {k}")
        for measured in MEASURED:
            assert_bits(getattr(sample, measured), expected[measured][k], f"{measured} at step {k}")
        for state, value in zip(("theta", "q", "x", "v"), truth, strict=True):
            assert_bits(value, expected[f"true_{state}"][k], f"true {state} at step {k}")
    flown = set(expected["state"].tolist())
    assert 2 in flown, "it flew"
    assert np.ptp(expected["true_theta"]) > 0.05


def assert_bits(got: float, wanted: np.generic, what: str) -> None:
    """The same bits in the type that was computed in."""
    assert type(wanted)(got).tobytes() == wanted.tobytes(), f"{what}: {got!r} and not {wanted!r}"


def test_a_reset_that_cannot_be_changes_nothing() -> None:
    host = VirtualRig(load_rig("lab"))
    host.reset(seed=5, x=0.1)
    before, truth = host.read(), host.truth
    for wrong in ({"seed": -1}, {"seed": 2**32}, {"x": 0.5}, {"x": float("nan")}, {"noise": -1.0}, {"noise": np.inf}):
        with pytest.raises(ParameterError):
            host.reset(**({"seed": 9, "x": 0.0} | wrong))
        assert (host.seed, host.read(), host.truth) == (5, before, truth)


def test_a_stopped_rig_gets_no_thrust_until_it_is_released() -> None:
    host = VirtualRig(load_rig("lab"), {"noise": 0.0})
    host.reset(x=0.0)
    host.stop()
    for _ in range(50):
        host.drive(0.6, 0.2)
    assert host.truth[0] == pytest.approx(0.0, abs=1e-12), "the pitch stays where it hangs"
    host.release()
    for _ in range(50):
        host.drive(0.6, 0.2)
    assert host.truth[0] > 0.1, "more thrust in front raises the nose"
