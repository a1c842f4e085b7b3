"""The H-infinity norm against a dense grid, structured synthesis against dense searches."""

import functools
import math
from datetime import date

import numpy as np
import pytest

from twodof.design.cascade import HIGH, LOW, HinfCascade, cascade_hinf, weighted_cascade
from twodof.design.pitch_family import PitchFamily
from twodof.design.promise import promise
from twodof.design.sampled_controller import SampledController
from twodof.design.specification import Specification, check, read_specification
from twodof.design.structured_hinf import System, hinf_norm, largest_norm, structured_hinf
from twodof.errors import ParameterError
from twodof.flight.starters.attitude import pid_attitude
from twodof.signals import PERIOD

pytestmark = pytest.mark.slow

FAMILY = PitchFamily.of(
    {"w_n": 3.437, "xi": 0.0836, "mu": 358.5, "tau": 0.02}, {"mu": 10.0, "dead_time": 0.0005}, gust=0.5, q_noise=0.01
)

ASKED = Specification(
    bandwidth=5.0, gain_margin_db=6.0, phase_margin_deg=40.0, peak_sensitivity=2.1, overshoot=0.1, peak_moment=0.3
)


@functools.cache
def optimum() -> HinfCascade:
    return cascade_hinf(FAMILY, ASKED)


@pytest.mark.parametrize("dt", [None, 0.01])
def test_norm_is_the_largest_of_a_dense_grid(dt: float | None) -> None:
    rng = np.random.default_rng(3)
    for _ in range(10):
        a = rng.standard_normal((5, 5))
        a = a - (np.linalg.eigvals(a).real.max() + 0.1) * np.eye(5) if dt is None else 0.97 * a / _radius(a)
        b, c, d = rng.standard_normal((5, 2)), rng.standard_normal((3, 5)), rng.standard_normal((3, 2))
        norm, omega = hinf_norm(a, b, c, d, dt)
        grid = np.append(np.linspace(0.0, 30.0 if dt is None else math.pi / 0.01, 4001), omega)
        s = 1j * grid if dt is None else np.exp(1j * grid * 0.01)
        response = c @ np.linalg.solve(s[:, None, None] * np.eye(5) - a, np.broadcast_to(b, (4002, 5, 2)) + 0j) + d
        sizes = np.linalg.svd(response, compute_uv=False).max(axis=1)
        # the norm is met where it says, and nowhere exceeded: TOLERANCE, and what the arithmetic loses near a pole
        assert sizes[-1] == pytest.approx(norm, rel=1e-6)
        assert sizes.max() <= norm * (1.0 + 1e-6)


def test_norm_of_known_systems() -> None:
    one = np.ones((1, 1))
    assert hinf_norm(-2.0 * one, one, 3.0 * one, 0.0 * one)[0] == pytest.approx(1.5, rel=1e-6)
    # w^2 / (s^2 + 2 xi w s + w^2) has the peak 1 / (2 xi sqrt(1 - xi^2)) at w sqrt(1 - 2 xi^2)
    a, xi = np.array([[0.0, 1.0], [-9.0, -0.06]]), 0.01
    norm, omega = hinf_norm(a, np.array([[0.0], [9.0]]), np.array([[1.0, 0.0]]), np.zeros((1, 1)))
    assert norm == pytest.approx(1.0 / (2.0 * xi * math.sqrt(1.0 - xi**2)), rel=1e-6)
    assert omega == pytest.approx(3.0 * math.sqrt(1.0 - 2.0 * xi**2), rel=1e-3)
    assert math.isinf(hinf_norm(2.0 * one, one, one, one)[0])


def test_integral_gain_at_the_kink_of_two_peaks() -> None:
    """3 / (z - 1 + k) is largest at 0 below k = 1, 3 / k, and at the Nyquist frequency above, 3 / (2 - k)."""

    def closed(gains: np.ndarray) -> list[System]:
        a, one = np.array([[1.0 - gains[0]]]), np.ones((1, 1))
        return [(a, gains[0] * one, -one, one), (a, 3.0 * one, one, 0.0 * one)]

    starts = [np.full(1, start) for start in (0.1, 1.6, 3.0)]  # the last one is unstable
    found = structured_hinf(closed, starts, PERIOD, np.zeros(1), np.full(1, 4.0))
    assert found.gains[0] == pytest.approx(1.0, rel=1e-5)
    assert found.norms == pytest.approx([3.0] * 3, rel=1e-5)


@pytest.mark.long
def test_cascade_beats_a_dense_search_over_gains() -> None:
    found, closed = optimum(), weighted_cascade(FAMILY, ASKED)
    best = math.inf
    for kp in np.linspace(0.04, 0.1, 5):
        for ki in (0.02, 0.12, 0.25):
            for kd in (0.0, 0.0006, 0.0012):
                for attitude in np.linspace(3.0, 8.0, 4):
                    best = min(best, largest_norm(closed(np.array([kp, ki, kd, attitude])), PERIOD)[0])
    assert found.norm <= best
    # The grid is coarse, yet near the minimum the norm is flat: if the best of 180 were far above, the model is wrong.
    assert found.norm > 0.8 * best
    gains = np.array([*found.gains.rate, found.gains.attitude])
    assert (gains >= LOW).all()
    assert (gains <= HIGH).all()
    # And no gain near by is better, along each and in 40 random directions of a per cent.
    rng = np.random.default_rng(5)
    for step in [*(0.01 * np.eye(4)), *(-0.01 * np.eye(4)), *(0.01 * rng.standard_normal((40, 4)))]:
        assert largest_norm(closed(np.clip(gains * (1.0 + step), LOW, HIGH)), PERIOD)[0] >= found.norm * (1.0 - 1e-4)


@pytest.mark.long
def test_specification_is_checked() -> None:
    controller = SampledController.of(pid_attitude(optimum().gains))
    rows = check(ASKED, controller, FAMILY, promise(controller, FAMILY, members=80))
    assert [row.name for row in rows] == [name for name in ASKED.required if name != "step_deg"]
    assert all(row.met for row in rows), [row.text for row in rows]
    sharper = Specification(bandwidth=50.0, delay_margin=0.5)
    assert not any(row.met for row in check(sharper, controller, FAMILY))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[roll]\nbandwidth = 3",
        "pitch = 3",
        "[pitch]\nbandwidth = true",
        "[pitch]\nbandwith = 3",
        "[pitch]\nbandwidth = -1",
        "[pitch]\nbandwidth = nan",
        "[pitch]\nbandwidth = 'x'",
        "]",
    ],
)
def test_refuses_a_bad_specification(text: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("spec") / "spec.toml"
    path.write_text(text)
    with pytest.raises(ParameterError) as caught:
        read_specification(path)
    assert caught.value.remedy


def test_refuses_with_a_remedy() -> None:
    unstable = (np.ones((1, 1)), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1)))
    one = (PERIOD, np.zeros(1), np.full(1, 2.0))
    for call in (
        lambda: structured_hinf(lambda x: [unstable], [], *one),
        lambda: structured_hinf(lambda x: [unstable], [np.array([math.nan])], *one),
        lambda: structured_hinf(lambda x: [unstable], [np.ones(1)], *one),
        lambda: structured_hinf(lambda x: [unstable], [np.ones(2)], *one),
        lambda: structured_hinf(lambda x: [unstable], [np.ones(1)], PERIOD, np.ones(1), np.ones(1)),
        lambda: hinf_norm(np.ones((2, 2)), np.ones((1, 1)), np.ones((1, 1)), np.ones((1, 1))),
        lambda: hinf_norm(*(math.nan * np.ones((1, 1)) for _ in range(4))),
        lambda: check(Specification(overshoot=0.1), SampledController.of(pid_attitude()), FAMILY),
        lambda: Specification(bandwidth=[6.0]),  # type: ignore[arg-type]
        lambda: Specification(overshoot=date(2026, 1, 1)),  # type: ignore[arg-type]
        lambda: Specification(step_deg=None),  # type: ignore[arg-type]
        lambda: Specification.of({"rail": {"loop": ["velocity"]}}, table="rail"),
    ):
        with pytest.raises(ParameterError) as caught:
            call()
        assert caught.value.remedy


def _radius(a: np.ndarray) -> float:
    return float(np.abs(np.linalg.eigvals(a)).max())
