"""Small sets of data that a fit may get wrong: each is right, or refused or noted with its reason."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binomtest

from tests.identify.hard_data import CASES, DT, Case, held, jittered, motor, switching, unstable
from twodof.errors import IdentificationError
from twodof.identify import Estimate, Record, fit, fit_from_several, fit_percent, predict_ahead
from twodof.models.structure import linear_model

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


PITCH = {"k": 6.0, "d": 1.0, "mu": 30.0}


def pitch_under(push: float, seed: int, steps: int = 1500, mixture: float = 0.0) -> Estimate:
    """Return the default fit of a damped pitch, with theta and q measured, under random pushes at its input.

    The output q has `mixture` times theta added, in the data and in the model.
    """
    a = [[0.0, 1.0], [-PITCH["k"], -PITCH["d"]]]
    phi, gamma = held(np.array(a), np.array([[0.0], [PITCH["mu"]]]), DT)
    rng, moment = np.random.default_rng(seed), switching(steps, 15, 0.1, seed=1000 + seed)
    state, states = np.zeros(2), np.zeros((steps, 2))
    for k in range(steps):
        states[k] = state
        state = phi @ state + gamma[:, 0] * (moment[k] + push * rng.standard_normal())
    theta, q = (states + rng.standard_normal((steps, 2)) * [2e-3, 1e-2]).T
    columns = {"M": moment, "theta": theta, "q": q + mixture * theta}
    guess, seen = {"k": 4.0, "d": 0.5, "mu": 20.0}, [[1, 0], [mixture, 1]]
    rates = [[0, 1], ["-k", "-d"]]
    model = linear_model(rates, [[0], ["mu"]], seen, inputs=["M"], outputs=["theta", "q"], guess=guess)
    return fit(model, Record.from_columns(DT * np.arange(steps), columns, ["M"], ["theta", "q"]))


@pytest.mark.parametrize("push", [0.0, 0.005, 0.1])
def test_a_predictor_is_taken_where_pushes_move_the_plant(push: float) -> None:
    found = [pitch_under(push, seed) for seed in range(36)]
    kinds = [one.disturbance.kind for one in found]
    assert kinds.count("innovation") == (36 if push else 0)
    if not push:  # the test for whiteness errs once in 100 outputs
        assert kinds.count("white") >= 34
    for name, truth in PITCH.items():
        covered = sum(low <= truth <= high for low, high in (one.interval(name) for one in found))
        assert binomtest(covered, len(found), 0.95).pvalue > 1e-3, (name, covered)


def test_a_mixture_of_the_outputs_tells_a_predictor_the_same() -> None:
    """A push moves theta and q at once, and their errors go together as those of any mixture of the two do."""
    for seed in (1, 2, 3):
        apart, mixed = pitch_under(0.1, seed), pitch_under(0.1, seed, mixture=5.0)
        assert apart.disturbance.kind == mixed.disturbance.kind == "innovation"
        for name in PITCH:
            assert abs(apart[name] - mixed[name]) < 0.1 * apart.sigma(name), name
            assert mixed.cramer_rao(name) == pytest.approx(apart.cramer_rao(name), rel=0.02), name


def test_an_unstable_predictor_gives_way_to_a_stable_one() -> None:
    """The first search of this record ends in one whose errors grow; an autoregression is ten claims off."""
    one = pitch_under(0.2, 32)
    assert one.disturbance.kind == "innovation"
    for name, truth in PITCH.items():
        assert abs(one[name] - truth) < 3.3 * one.sigma(name)


def test_coloured_noise_of_a_sensor_is_no_process_noise() -> None:
    for name in ("coloured noise", "output walks", "actuator saturates", "mains hum"):
        assert CASES[name].make().disturbance.kind != "innovation", name


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
