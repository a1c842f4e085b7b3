"""Families, loops of many members, robustness and promises: against one member at a time, and in flight."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from twodof.design.pitch_family import PitchFamily
from twodof.design.pitch_loop import TILT_WALK, PitchLoop
from twodof.design.promise import Promise, interval, promise
from twodof.design.sampled_controller import SampledController
from twodof.errors import ParameterError
from twodof.flight.gains import STUDENT
from twodof.flight.starters.attitude import pid_attitude
from twodof.models import step_figures
from twodof.models.lti import DelayedStateSpace
from twodof.signals import PERIOD, Q_AGE

pytestmark = pytest.mark.slow

VALUES = {"w_n": 3.437, "xi": 0.0836, "mu": 358.5, "dead_time": 0.0113, "lag": 0.0087}
SIGMAS = {"w_n": 0.1, "mu": 12.0, "dead_time": 0.001}
FAMILY = PitchFamily.of(VALUES, SIGMAS, gust=1.5, gust_time=0.15, q_noise=0.02)
STOCK = SampledController.of(pid_attitude(STUDENT))


def test_loop_is_that_of_the_exact_plant() -> None:
    """Each member against the plant's own zero-order hold and the control law, step by step."""
    members = FAMILY.draw(3, seed=4)
    goal = 0.1
    theta, q, moment = PitchLoop(members, STOCK).simulate(np.full(150, goal))
    kp, ki, kd = STUDENT.rate
    for k in range(3):
        m = members.one(k)
        a = [[0.0, 1.0, 0.0], [-(m["w_n"] ** 2), -2.0 * m["xi"] * m["w_n"], m["mu"]], [0.0, 0.0, -1.0 / m["lag"]]]
        plant = DelayedStateSpace.of(a, [0.0, 0.0, 1.0 / m["lag"]], np.eye(3), np.zeros((3, 1)), m["dead_time"] + Q_AGE)
        sampled = plant.zero_order_hold(PERIOD)
        state, given, seen = np.zeros(3), [0.0] * 40, 0.0
        integral = slope = before = 0.0
        for step in range(150):
            error = STUDENT.attitude * (goal - seen) - state[1]
            integral += ki * PERIOD * error
            slope = (0.01 * slope + error - before) / (0.01 + PERIOD)
            before = error
            given.append(kp * error + integral + kd * slope)
            # The estimator sums q by rectangles, which is half a step ahead.
            seen = float(state[0] + 0.5 * PERIOD * state[1])
            assert (theta[step, k], q[step, k], moment[step, k]) == pytest.approx((seen, state[1], given[-1]), abs=1e-9)
            n = sampled.whole
            state = sampled.phi @ state + sampled.old[:, 0] * given[-n - 2] + sampled.new[:, 0] * given[-n - 1]


def test_broken_loop_and_closed_poles_agree() -> None:
    """1 + L is 0 at a pole: scaled until the response just swings, the pole is on the circle at that frequency."""
    loop = PitchLoop(FAMILY.nominal(), STOCK)
    omega = np.geomspace(20.0, 120.0, 4000)
    response = loop.moment_response(omega)[0]
    k = int(np.flatnonzero((response.imag[:-1] * response.imag[1:] < 0.0) & (response.real[:-1] < 0.0))[0])
    factor = -1.0 / response[k].real
    louder = SampledController(STOCK.a, STOCK.b, factor * STOCK.c, factor * STOCK.d)
    # 2e-3: the grid's step in frequency
    assert PitchLoop(FAMILY.nominal(), louder).radii()[0] == pytest.approx(1.0, abs=2e-3)


def test_figures_are_those_of_one_response() -> None:
    made = promise(STOCK, FAMILY.disturbed(gust=0.0, q_noise=0.0), members=80)
    theta = made.middle["theta"]
    one = step_figures(made.time, theta, 0.0, made.goal)
    low, _, high = made.figures["rise_time"]
    assert low < one.rise_time < high
    verdict = made.verdict(
        np.concatenate([[-0.3, -0.2, -0.1], made.time]),
        {"theta": np.concatenate([np.zeros(3), theta]), "M": np.concatenate([np.zeros(3), made.middle["M"]])},
    )
    assert verdict.steps[0].figures["rise_time"] == pytest.approx(one.rise_time, abs=1e-9)
    assert verdict.stands
    assert "theta         1 of 1 steps in the band" in verdict.table()
    low, _, high = made.figures["overshoot"]
    assert f"within {100.0 * low:.3g} to {100.0 * high:.3g} %: " in verdict.table()
    shaken = replace(verdict.steps[0], outside={"theta": 0.0025, "M": 0.0})
    assert (
        "0 of 1 steps in the band; the worst left it for 0.25 % of its time"
        in replace(verdict, steps=(shaken,)).table()
    )


def test_promise_comes_back_from_its_file() -> None:
    made = promise(STOCK, FAMILY, members=60)
    text = json.dumps(made.to_json(), allow_nan=False)
    back = Promise.from_json(json.loads(text))
    assert json.dumps(back.to_json(), allow_nan=False) == text


def test_interval_of_a_figure_that_cannot_be_less() -> None:
    """Half of the overshoots are 0: none is below the interval, and 95 % of fresh ones are in it, not 97.5."""
    rng = np.random.default_rng(1)
    low, middle, high = interval(np.maximum(0.0, rng.standard_normal(4000)), 0.95)
    assert (low, middle) == (0.0, pytest.approx(0.0, abs=0.05))
    fresh = np.maximum(0.0, rng.standard_normal(40_000))
    # 4,000 draws tell a tail of 5 % to +- .35 %: three times that
    assert np.mean((fresh >= low) & (fresh <= high)) == pytest.approx(0.95, abs=0.0105)
    low, _, high = interval(rng.standard_normal(4000), 0.95)
    assert np.mean((fresh := rng.standard_normal(40_000)) < low) == pytest.approx(0.025, abs=0.0075)
    assert np.mean(fresh > high) == pytest.approx(0.025, abs=0.0075)


@pytest.mark.long
def test_promise_holds_for_other_members() -> None:
    """Members and disturbances that were not drawn for the promise: 95 % keep it, up to chance."""
    made = promise(STOCK, FAMILY, members=800, seed=1)
    others, count = FAMILY.draw(300, seed=77), 300
    goal = np.concatenate([np.zeros(500), np.full(len(made.time), made.goal)])
    theta, q, moment = PitchLoop(others, STOCK, FAMILY.gust_time).simulate(
        goal, 78, FAMILY.gust, FAMILY.q_noise, tilt=TILT_WALK
    )
    time = (np.arange(len(goal)) - 500) * PERIOD
    kept = dict.fromkeys(("theta", "q", "M", *made.figures), 0)
    for k in range(count):
        found = made.verdict(time[375:], {"theta": theta[375:, k], "q": q[375:, k], "M": moment[375:, k]})
        for name in kept:
            kept[name] += found.kept(name)
    # 95 % of 300 is 285 +- 3.8, and the 400 members that set a factor tell it to +- 3.3: three times the root of the
    # sum of squares.
    assert all(number >= 285 - 15 for number in kept.values()), kept
    assert all(number < 300 for number in kept.values()), kept


def test_family_of_an_identified_model() -> None:
    row = {"value": 350.0, "unit": "", "sigma": 2.0, "sigma_robust": 5.0}
    document = {
        "estimates": {"mu": row, "tau": {"value": 0.02, "unit": "s", "sigma": 1e-3, "sigma_robust": None}},
        "fixed": {"w_n": 3.0, "xi": 0.1},
        "correlation": [[1.0, 0.5], [0.5, 1.0]],
        "noise": {"q": 0.05},
    }
    family = PitchFamily.from_identified(document)
    assert family.uncertain == ("mu", "dead_time")
    assert family.covariance == pytest.approx(np.array([[25.0, 2.5e-3], [2.5e-3, 1e-6]]))
    drawn = family.draw(20_000, seed=3)
    # 20,000 draws tell a mean to .7 % of sigma and a standard deviation to .5 %: five times that
    assert drawn.mu.mean() == pytest.approx(350.0, abs=0.2)
    assert drawn.mu.std() == pytest.approx(5.0, rel=0.03)
    assert np.corrcoef(drawn.mu, drawn.dead_time)[0, 1] == pytest.approx(0.5, abs=0.03)
    assert json.dumps(PitchFamily.from_json(family.to_json()).to_json()) == json.dumps(family.to_json())


def test_family_of_several_flights_has_their_spread() -> None:
    rows = np.array([[300.0, 0.010, 0.009], [320.0, 0.012, 0.008], [280.0, 0.009, 0.010]])
    names = ("mu", "dead_time", "lag")
    flights = {
        f"{k}.mcap": {
            "estimates": {name: {"value": v, "sigma": 1e-3 * v} for name, v in zip(names, row, strict=True)},
            "fixed": {"w_n": 3.0, "xi": 0.1},
            "correlation": np.eye(3).tolist(),
            "noise": {"q": 0.3},
            "disturbance": {
                "gusts": {
                    "q": {"std": 0.006, "correlation_time": 0.15, "white": 0.003, "narrow": 0.004, "frequency": 38.0}
                }
            },
        }
        for k, row in enumerate(rows.tolist())
    }
    # the sum tau is there beside its parts
    family = PitchFamily.from_identified({"repeated": {name: {} for name in (*names, "tau")}, "flights": flights})
    assert family.uncertain == names
    assert [family.values[name] for name in names] == pytest.approx(rows.mean(axis=0).tolist())
    # what the next flight has: its own part and that of the mean
    assert family.covariance == pytest.approx(np.cov(rows.T) * 4.0 / 3.0)
    assert family.q_noise == pytest.approx(0.005)
    # a gust that pushes as .006 of M does
    assert family.gust == pytest.approx(0.006 * math.sqrt(np.mean(rows[:, 0] ** 2)))
    assert family.gust_time == pytest.approx(0.15)


@pytest.mark.parametrize(
    "call",
    [
        lambda: PitchFamily.from_identified([]),
        lambda: PitchFamily.from_identified({}),
        lambda: PitchFamily.from_identified({"estimates": {}, "correlation": []}),
        lambda: PitchFamily.of({**VALUES, "mu": math.nan}),
        lambda: PitchFamily.of(VALUES, {"sigma": 1.0}),
        lambda: PitchFamily.of(VALUES, {"mu": math.inf}),
        lambda: PitchFamily.of(VALUES, {"dead_time": 5.0}).draw(100),
        lambda: FAMILY.draw(0),
        lambda: FAMILY.draw(2.5),
        lambda: FAMILY.draw("3"),
        lambda: PitchFamily.of({**VALUES, "mu": None}),
        lambda: FAMILY.disturbed(gust=-1.0),
        lambda: promise(STOCK, FAMILY, goal=math.nan),
        lambda: promise(STOCK, FAMILY, members=3),
        lambda: promise(STOCK, FAMILY, members=400.5),
        lambda: promise(STOCK, FAMILY, duration=None),
        lambda: Promise.from_json({"promise": 1}),
        lambda: Promise.from_json("x" * 100_000),
        lambda: promise(STOCK, FAMILY, members=40).verdict([], {}),
        lambda: promise(STOCK, FAMILY, members=40).verdict([0.0, 1.0], {"theta": [0.0, 0.0]}),
    ],
)
def test_refuses_with_a_remedy(call: object) -> None:
    with pytest.raises(ParameterError) as caught:
        call()  # type: ignore[operator]
    assert caught.value.remedy
