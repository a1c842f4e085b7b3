"""The preview of gains against other ways to its loops and figures, and the law of a drone from its parameters."""

import functools
import json
import math
from dataclasses import replace

import numpy as np
import pytest

from twodof.blocks.schema.json_form import to_json
from twodof.design.cascade import CascadeLoops
from twodof.design.pid import PidGains
from twodof.design.pitch_family import PitchFamily
from twodof.design.pitch_loop import PitchLoop
from twodof.design.promise import promise
from twodof.design.sampled_controller import SampledController
from twodof.design.tuning_preview import GAINS, SETTLED, SHOWN, PitchLaw, TuningPreview, tuning_preview
from twodof.errors import ParameterError
from twodof.flight.gains import DEFAULT, STUDENT, Gains
from twodof.flight.starters.attitude import pid_attitude, stock_attitude
from twodof.models import step_figures
from twodof.models.plant import PitchRate
from twodof.parameters import PARAMETERS
from twodof.signals import PERIOD, Q_AGE

pytestmark = pytest.mark.slow

VALUES = {"w_n": 3.437, "xi": 0.0836, "mu": 358.5, "dead_time": 0.0113, "lag": 0.0087}
FAMILY = PitchFamily.of(VALUES, {"mu": 12.0, "dead_time": 0.001}, gust=1.5, gust_time=0.15, q_noise=0.02)


@functools.cache
def previewed(gains: Gains) -> TuningPreview:
    return tuning_preview(FAMILY, gains, members=100)


@pytest.mark.long
@pytest.mark.parametrize("gains", [STUDENT, DEFAULT])
def test_loops_are_those_of_the_closed_forms(gains: Gains) -> None:
    """Crossover and phase margin against the frequency responses of `CascadeLoops`, one loop within the other."""
    found, rate = previewed(gains).loops, PidGains(*gains.rate)
    other = CascadeLoops(PitchRate(3.437, 0.0836, 358.5, 0.0113 + Q_AGE), lag=0.0087)
    # The estimator sums q by rectangles, which is half a step ahead.
    ahead = 1.0 + 0.5j * PERIOD * found["attitude"].crossover
    for name, value in (
        ("rate", other.rate(rate, found["rate"].crossover)),
        ("attitude", gains.attitude * ahead * other.theta_by_q0(rate, found["attitude"].crossover)),
    ):
        assert abs(value) == pytest.approx(1.0, rel=1e-6)
        assert found[name].phase_margin == pytest.approx(math.pi + np.angle(value), abs=1e-6)
    # broken at M: the gain that the margin names brings a pole of the whole loop to the circle
    increase = found["motors"].increase
    assert increase is not None
    once = SampledController.of(stock_attitude(gains))
    louder = SampledController(once.a, once.b, increase.factor * once.c, increase.factor * once.d)
    assert PitchLoop(FAMILY.nominal(), louder).radii()[0] == pytest.approx(1.0, abs=1e-6)


def test_bands_are_those_of_the_promise() -> None:
    shown = previewed(STUDENT)
    made = promise(SampledController.of(stock_attitude(STUDENT)), FAMILY, members=100)
    for name in SHOWN:
        assert shown.low[name] == pytest.approx(made.low[name], abs=1e-9)
        assert shown.high[name] == pytest.approx(made.high[name], abs=1e-9)
    assert shown.figures["rise_time"] == pytest.approx(made.figures["rise_time"], abs=1e-9)
    assert shown.verdict.robust


@pytest.mark.parametrize("steps", [1, 16, 257, 600])
def test_flights_follow_the_recursion_step_by_step(steps: int) -> None:
    """`simulate` makes blocks of steps side by side; the recursion x' = A x + B u makes one after the other."""
    loop = PitchLoop(FAMILY.draw(3, 1), SampledController.of(stock_attitude(STUDENT)))
    a, b, c, d = loop.matrices
    goal = np.sin(0.05 * np.arange(steps))
    x, expected = np.zeros((3, a.shape[1], 1)), []
    for value in goal:
        given = np.array([[value], [0.0], [0.0]])
        expected.append((c @ x + d @ given)[..., 0])
        x = a @ x + b @ given
    np.testing.assert_allclose(np.stack(loop.simulate(goal), axis=2), expected, rtol=0.0, atol=1e-10)  # q to 20 rad/s


def test_settling_time_is_that_of_one_response() -> None:
    sure = PitchFamily.of(VALUES, gust=0.4, q_noise=0.02)
    low, middle, high = tuning_preview(sure, STUDENT, members=40).figures["settling_time"]
    assert low == middle == high
    theta, _, _ = PitchLoop(sure.nominal(), SampledController.of(stock_attitude(STUDENT))).simulate(np.full(400, 0.1))
    one = step_figures(np.arange(400) * PERIOD, theta[:, 0], 0.0, 0.1, SETTLED)
    # the preview counts whole samples, the other interpolates within one
    assert one.settling_time <= middle <= one.settling_time + PERIOD


@pytest.mark.long
def test_too_large_gains_are_reported() -> None:
    wild = previewed(replace(DEFAULT, rate=(0.12, 0.4, 0.003), attitude=12.0))
    assert not wild.verdict.robust
    assert set(wild.verdict.worst) == set(VALUES)
    late = PitchFamily.of({**VALUES, "dead_time": 0.05}, {"mu": 12.0})
    lost = tuning_preview(late, DEFAULT, members=40)
    assert not lost.loops["motors"].stable
    assert lost.verdict.unstable == 1.0
    assert all(np.abs(lost.high[name]).max() <= SHOWN[name] for name in SHOWN)
    text = json.dumps(lost.to_json(), allow_nan=False)
    assert json.loads(text)["figures"]["settling_time"]["middle"] is None


@pytest.mark.long
def test_it_can_be_ended_at_any_share() -> None:
    class Enough(Exception):
        pass

    shares: list[float] = []
    tuning_preview(FAMILY, STUDENT, members=40, progress=shares.append)
    assert shares == sorted(shares)
    assert max(np.diff([0.0, *shares, 1.0])) < 0.15

    def said(share: float) -> None:
        if share > 0.6:
            raise Enough

    with pytest.raises(Enough):
        tuning_preview(FAMILY, STUDENT, members=40, progress=said)


@pytest.mark.parametrize("bad", [{"members": 3}, {"goal": math.nan}, {"members": True}])
def test_refuses_with_a_remedy(bad: dict[str, float]) -> None:
    with pytest.raises(ParameterError) as caught:
        tuning_preview(FAMILY, STUDENT, **bad)  # type: ignore[arg-type]
    assert caught.value.remedy


DEFAULTS = {row.name: row.default for row in PARAMETERS}
DRONE = PitchFamily.of({"w_n": 3.4, "xi": 0.08, "mu": 358.5, "dead_time": 0.0185, "lag": 0.001}, {"mu": 18.0})


def test_the_stock_law_is_that_of_its_gains() -> None:
    law = PitchLaw.flown(DEFAULTS)
    assert law.gains == DEFAULT
    assert law.parameters == frozenset(GAINS)
    assert law.verdict(DRONE).robust
    assert law.digest == PitchLaw.flown({**DEFAULTS, "POS_KP": 1.0}).digest, "the pitch does not read it"
    assert law.digest != PitchLaw.flown({**DEFAULTS, "RATE_KP": 0.08}).digest


@pytest.mark.long
def test_gains_that_destabilise_the_family_are_reported() -> None:
    law = PitchLaw.flown({**DEFAULTS, "RATE_KP": 0.12, "RATE_KD": 0.003, "ATT_KP": 15.0})
    assert not law.verdict(DRONE).robust
    assert not law.preview(DRONE, 0.17).verdict.robust, "page and server see the same"


@pytest.mark.long
def test_a_users_controller_has_its_own_parameters() -> None:
    """The pid-attitude starter with the stock gains is the stock law: both previews show one response."""
    diagram = pid_attitude(DEFAULT)
    names = {f"C_{i}": f"attitude_control.{path}" for i, path in enumerate(diagram.params)}
    law = PitchLaw.flown({}, to_json(diagram), names)
    stock = PitchLaw.flown(DEFAULTS)
    mine, theirs = law.preview(DRONE, 0.17), stock.preview(DRONE, 0.17)
    # 7 digits: the two laws order their sums in another way.
    np.testing.assert_allclose(mine.middle["theta"], theirs.middle["theta"], rtol=1e-7, atol=1e-9)
    assert set(mine.loops) == {"motors"}
    assert law.parameters == frozenset(names)
    (gain,) = [name for name, path in names.items() if path.endswith(("kp", "Kp", "k_p", "rate_kp"))][:1]
    other = PitchLaw.flown({gain: 0.03}, to_json(diagram), names)
    assert other.digest != law.digest


def test_gains_out_of_bounds_are_refused() -> None:
    with pytest.raises(ParameterError, match="bounds"):
        PitchLaw.flown({**DEFAULTS, "RATE_KP": 7.0})
