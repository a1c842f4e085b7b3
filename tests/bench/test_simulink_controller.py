"""The public Simulink controller in our blocks: it flies, and without its own C the benchmark says what is missing."""

import numpy as np
import pytest

from bench.computing.simulink_controller import BUSES, CHECKOUT, PERIOD, flight, flight_controller, run
from twodof.blocks.reference import Reference
from twodof.compile import build


@pytest.mark.long
def test_native_equals_the_reference() -> None:
    rows = flight(400, "mixed")
    inputs = {name: rows[name] for name in (BUSES.names or ()) if name != "live_time_ticks"}
    compiled = build(flight_controller(), PERIOD, "float32").machine().run(len(rows), inputs)
    judged = Reference(flight_controller(), PERIOD, "float32").machine().run(len(rows), inputs)
    for name in ("motors", "pose"):
        assert np.array_equal(compiled[name], judged[name])
    assert np.abs(compiled["motors"]).max() == 500.0  # the motors' bound is reached


def test_missing_checkout_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(CHECKOUT, raising=False)
    (figure,) = run()
    assert CHECKOUT in figure.remark
