"""A cart that dry friction holds at the start: no speed can be told there, and the fit goes on without it."""

import numpy as np

from tests.identify.signals import DT
from twodof.identify import Record, fit
from twodof.identify.information import simulate_planned
from twodof.models import rail

TRUTH = {"k_v": 4.748, "p_v": 1.168, "coulomb": 0.4, "theta_0": 0.004, "x_0": 0.02, "v_0": 0.0}
SIGMA = 0.001
UNKNOWNS = ("k_v", "p_v", "coulomb", "theta_0", "x_0", "v_0")


def travel(v_0: float) -> Record:
    """A pitch doublet of 0.2 rad after half a second of rest. The range is first seen after a slide would be over."""
    t = DT * np.arange(750)
    q = np.zeros(t.size)
    for start, rate in ((0.5, 1.0), (1.1, -1.0), (1.3, -1.0), (1.9, 1.0)):
        q[(t >= start) & (t < start + 0.2)] = rate
    x = simulate_planned(rail(), {"q": q}, DT, {**TRUTH, "v_0": v_0})["x"]
    x = x + SIGMA * np.random.default_rng(2).standard_normal(t.size)
    return Record.from_channels({"q": (t, q), "x": (t[14::14], x[14::14])}, ["q"], ["x"])


def test_a_stuck_cart_is_identified_without_a_speed() -> None:
    found = fit(rail(), travel(0.0), estimate=UNKNOWNS, values={"coulomb": 0.2})
    assert found.at_rest == ("v_0",)
    assert "v_0" not in found.labels
    assert any("v_0 is held at 0: dry friction holds" in remark for remark in found.remarks)
    for name in ("k_v", "p_v", "coulomb"):
        # 4 deviations: once in 16,000.
        assert abs(found[name] - TRUTH[name]) < 4.0 * found.sigma(name), name


def test_a_cart_that_moves_has_a_speed() -> None:
    found = fit(rail(), travel(0.2), estimate=UNKNOWNS, values={"coulomb": 0.2, "v_0": 0.1})
    assert found.at_rest == ()
    assert abs(found["v_0"] - 0.2) < 4.0 * found.sigma("v_0")
