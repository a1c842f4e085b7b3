"""The mixer keeps thrust and moment while no pair saturates, and clips as the drone does."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twodof.blocks import Diagram
from twodof.blocks.reference.interpreter import Reference, ReferenceMachine
from twodof.flight.mixer import Mixer


def _machine() -> ReferenceMachine:
    d = Diagram("mixing")
    d.input("T")
    d.input("M")
    d.add("mixer", Mixer(), T="T", M="M")
    for name in ("fore", "aft", "saturated"):
        d.output(name, f"mixer.{name}")
    return Reference(d, 0.004).machine()


MACHINE = _machine()


@given(thrust=st.floats(0.0, 1.0), share=st.floats(-1.0, 1.0))
def test_unsaturated_the_sum_is_the_thrust_and_the_difference_the_moment(thrust: float, share: float) -> None:
    moment = share * min(thrust, 1.0 - thrust)
    out = MACHINE.step({"T": thrust, "M": moment})
    # Two roundings of numbers up to 1.
    assert (out["fore"] + out["aft"]) / 2.0 == pytest.approx(thrust, abs=4e-16)
    assert (out["fore"] - out["aft"]) / 2.0 == pytest.approx(moment, abs=4e-16)


@given(thrust=st.floats(allow_nan=False), moment=st.floats(allow_nan=False, allow_infinity=False))
def test_no_command_leaves_its_range(thrust: float, moment: float) -> None:
    out = MACHINE.step({"T": thrust, "M": moment})
    assert 0.0 <= out["fore"] <= 1.0
    assert 0.0 <= out["aft"] <= 1.0


@pytest.mark.parametrize(
    ("thrust", "moment", "fore", "aft"), [(0.0, 0.1, 0.1, 0.0), (0.4, 0.5, 0.9, 0.0), (0.9, -0.3, 0.6, 1.0)]
)
def test_a_clipped_pair_is_said_and_the_other_keeps_its_command(
    thrust: float, moment: float, fore: float, aft: float
) -> None:
    out = MACHINE.step({"T": thrust, "M": moment})
    assert out["saturated"]
    assert (out["fore"], out["aft"]) == pytest.approx((fore, aft), abs=1e-15)
