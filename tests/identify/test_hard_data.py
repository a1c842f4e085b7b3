"""Small sets of data that a fit may get wrong: each is right, or refused or noted with its reason."""

import re
from dataclasses import replace

import pytest

from tests.identify.hard_data import CASES, Case, jittered, motor, unstable
from twodof.errors import IdentificationError
from twodof.identify import Estimate, fit, fit_from_several, fit_percent, predict_ahead

pytestmark = pytest.mark.slow

LASTING = {"before the excitation", "input far from 0", "a delay is left out", "one sample in ten lost"}


def fitted(case: Case) -> tuple[Estimate | None, str]:
    """Return the estimate and its remarks, or the refusal."""
    try:
        found = case.make()
    except IdentificationError as refusal:
        return None, str(refusal)
    return found, " ".join(found.remarks)


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.long] * (n in LASTING)) for n in CASES])
def test_no_set_is_wrong_in_silence(name: str) -> None:
    case = CASES[name]
    found, said = fitted(case)
    if case.words:
        assert re.search(case.words, said), said
        return
    assert found is not None, said
    assert found.converged
    for label, truth in case.truth.items():
        # Four deviations are one case in 16,000; and the doubt is to leave something.
        assert abs(found[label] - truth) <= max(4.0 * found.sigma(label), 1e-9 * abs(truth)), found.table()
        assert found.sigma(label) < 0.3 * abs(truth), found.table()


def test_a_predictor_is_checked_on_fresh_data() -> None:
    fresh = unstable(25.0, 40.0, seed=9)
    found = fit(motor(5.0), unstable(25.0, 40.0), validation=replace(fresh, name="fresh"))
    (seen,), (checked,) = found.identification, found.validation
    assert checked.fit_percent == pytest.approx(seen.fit_percent, abs=5.0)
    assert checked.ahead == pytest.approx(checked.fit_percent, abs=1.0)
    assert "one sample ahead" in found.table()
    ahead = predict_ahead(motor(), replace(fresh, name="record"), found, steps=1)["y"]
    assert fit_percent(fresh.outputs["y"].value, ahead) == pytest.approx(checked.fit_percent, abs=1.0)
    with pytest.raises(IdentificationError, match="one sample ahead"):
        predict_ahead(motor(), fresh, found, steps=2)


def test_several_guesses_search_a_predictor() -> None:
    several = fit_from_several(
        motor(), unstable(25.0, 40.0), {"a": (1.0, 40.0)}, starts=3, seed=1, disturbance="innovation"
    )
    assert abs(several.best["a"] - 25.0) < 4.0 * several.best.sigma("a")


@pytest.mark.long
def test_jittered_tables_are_read_and_right() -> None:
    for seed in range(40):
        found = fit(motor(), jittered(0.002, seed=seed))
        assert abs(found["a"] + 2.0) < 4.0 * found.sigma("a"), seed
