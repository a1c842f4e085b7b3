"""The law that a drone flies, from its parameters, and from its own controller's."""

import numpy as np
import pytest

from twodof.blocks.schema.json_form import to_json
from twodof.design.pitch_family import PitchFamily
from twodof.design.tuning_preview import GAINS, PitchLaw
from twodof.errors import ParameterError
from twodof.flight.gains import DEFAULT
from twodof.flight.starters.attitude import pid_attitude
from twodof.parameters import PARAMETERS

pytestmark = pytest.mark.slow

VALUES = {row.name: row.default for row in PARAMETERS}
FAMILY = PitchFamily.of({"w_n": 3.4, "xi": 0.08, "mu": 358.5, "dead_time": 0.0185, "lag": 0.001}, {"mu": 18.0})


def test_the_stock_law_is_that_of_its_gains() -> None:
    law = PitchLaw.flown(VALUES)
    assert law.gains == DEFAULT
    assert law.parameters == frozenset(GAINS)
    assert law.verdict(FAMILY).robust
    assert law.digest == PitchLaw.flown({**VALUES, "POS_KP": 1.0}).digest, "the pitch does not read it"
    assert law.digest != PitchLaw.flown({**VALUES, "RATE_KP": 0.08}).digest


def test_gains_that_destabilise_the_family_are_reported() -> None:
    law = PitchLaw.flown({**VALUES, "RATE_KP": 0.12, "RATE_KD": 0.003, "ATT_KP": 15.0})
    assert not law.verdict(FAMILY).robust
    assert not law.preview(FAMILY, 0.17).verdict.robust, "page and server see the same"


def test_a_users_controller_has_its_own_parameters() -> None:
    """The pid-attitude starter with the stock gains is the stock law: both previews show one response."""
    diagram = pid_attitude(DEFAULT)
    names = {f"C_{i}": f"attitude_control.{path}" for i, path in enumerate(diagram.params)}
    law = PitchLaw.flown({}, to_json(diagram), names)
    stock = PitchLaw.flown(VALUES)
    mine, theirs = law.preview(FAMILY, 0.17), stock.preview(FAMILY, 0.17)
    # 7 digits: the two laws order their sums in another way.
    np.testing.assert_allclose(mine.middle["theta"], theirs.middle["theta"], rtol=1e-7, atol=1e-9)
    assert set(mine.loops) == {"motors"}
    assert law.parameters == frozenset(names)
    (gain,) = [name for name, path in names.items() if path.endswith(("kp", "Kp", "k_p", "rate_kp"))][:1]
    other = PitchLaw.flown({gain: 0.03}, to_json(diagram), names)
    assert other.digest != law.digest


def test_gains_out_of_bounds_are_refused() -> None:
    with pytest.raises(ParameterError, match="bounds"):
        PitchLaw.flown({**VALUES, "RATE_KP": 7.0})
