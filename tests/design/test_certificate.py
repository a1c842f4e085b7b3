"""The certificate of a region: its formula against the loop's own matrices, its decisions against dense sampling."""

import math

import numpy as np
import pytest

from twodof.design.certified.certificate import RegionStability, certificate
from twodof.design.certified.pitch_region import PitchRegion
from twodof.design.certified.pitch_symbols import pitch_formula
from twodof.design.certified.resolvent import coprime_factors
from twodof.design.certified.stability_radius import stability_radius
from twodof.design.certified.zero_exclusion import Cells
from twodof.design.synthesis.cascade import cascade_design
from twodof.design.synthesis.state_feedback import lqg_attitude
from twodof.design.uncertain.pitch_family import PARAMETERS, PitchFamily, PitchMembers
from twodof.design.uncertain.pitch_loop import GUST, PitchLoop
from twodof.design.uncertain.robustness import robustness
from twodof.design.uncertain.sampled_controller import SampledController
from twodof.errors import ParameterError
from twodof.flight.gains import STUDENT
from twodof.flight.starters.attitude import lqr_attitude, stock_attitude
from twodof.models.plant import PitchRate
from twodof.signals import PERIOD

pytestmark = pytest.mark.slow

VALUES = {"w_n": 3.437, "xi": 0.0836, "mu": 358.5, "dead_time": 0.0113, "lag": 0.0087}
SIGMAS = {"w_n": 0.17, "xi": 0.016, "mu": 12.0, "dead_time": 0.001, "lag": 0.0008}
FAMILY = PitchFamily.of(VALUES, SIGMAS, gust=1.0)
STOCK = SampledController.of(stock_attitude(STUDENT))


def louder(controller: SampledController, factor: float) -> SampledController:
    return SampledController(controller.a, controller.b, factor * controller.c, factor * controller.d)


def in_region(family: PitchFamily, radius: float, count: int, seed: int) -> PitchMembers:
    """Members on the border of the ellipsoid and within it, those beyond the bounds left out."""
    rng = np.random.default_rng(seed)
    k = len(family.uncertain)
    u = rng.standard_normal((count, k))
    u *= (radius * np.where(np.arange(count) % 2, 1.0, rng.uniform(0.0, 1.0, count)) / np.linalg.norm(u, axis=1))[
        :, None
    ]
    size = np.sqrt(np.diag(family.covariance))
    root = size[:, None] * np.linalg.cholesky(family.covariance / np.outer(size, size))
    columns = {name: np.full(count, float(family.values[name])) for name in PARAMETERS}
    for i, name in enumerate(family.uncertain):
        columns[name] = columns[name] + u @ root[i]
    inside = np.all([(columns[n] >= low) & (columns[n] <= high) for n, (low, high) in PARAMETERS.items()], axis=0)
    return PitchMembers(**{name: column[inside] for name, column in columns.items()})


@pytest.mark.parametrize("controller", [STOCK, SampledController.of(lqr_attitude())], ids=["stock", "lqr"])
def test_formula_is_the_characteristic_polynomial(controller: SampledController) -> None:
    """At points and over boxes: det(z - A) of `PitchLoop` is the formula, up to what is nowhere 0 on the circle."""
    rng = np.random.default_rng(1)
    factors = coprime_factors(controller.a, controller.b[:, 1:], controller.c, controller.d[:, 1:])
    for trial in range(12):
        values = {
            "w_n": rng.uniform(0.5, 20.0),
            "xi": 1.0 if trial == 0 else rng.uniform(-0.2, 1.5),
            "mu": rng.uniform(20.0, 900.0),
            "dead_time": rng.uniform(0.001, 0.04),
            "lag": rng.choice([0.0, 0.0004, 0.003, 0.02]),
        }
        sigmas = {"w_n": 0.05, "mu": 4.0, "dead_time": 1e-4, **({"lag": 2e-5} if values["lag"] > 1e-3 else {})}
        region = PitchRegion.of(PitchFamily.of(values, sigmas), 2.0)
        k = len(sigmas)
        whole = math.floor((values["dead_time"] - (1e-5 if values["lag"] == 0.0 else 0.0)) / PERIOD)
        angle, half = rng.uniform(0.01, 3.0, 20), np.full((20, k + 1), 0.02)
        half[:, 0] = 1e-3
        centre = np.concatenate([angle[:, None], rng.uniform(-0.5, 0.5, (20, k))], axis=1)
        cells = Cells(centre, half, np.full(20, whole, dtype=np.int64))
        if not (whole + 0.05) * PERIOD < values["dead_time"] < (whole + 0.95) * PERIOD:
            continue
        found = pitch_formula(region, factors)(cells)
        assert (found.rest < 0.2 * np.abs(found.centre)).all()
        for _ in range(3):
            e = rng.uniform(-1.0, 1.0, (20, k + 1))
            point = Cells(centre + half * e, np.zeros_like(half), cells.kind)
            a = PitchLoop(region.members(point), controller).matrices[0]
            a = np.delete(np.delete(a, GUST, axis=1), GUST, axis=2)
            z = np.exp(1j * point.centre[:, 0])
            eye, inner = np.eye(a.shape[1]), np.eye(len(factors.a))
            own = np.linalg.det(z[:, None, None] * inner - factors.a) * z ** (a.shape[1] - 3 - len(factors.a))
            value = np.linalg.det(z[:, None, None] * eye - a) / own
            off = np.abs(value - found.centre - (found.slopes * e).sum(axis=1))
            # 1e-8 of the value: what a determinant of 15 states loses to rounding
            assert (off <= found.rest + 1e-8 * np.abs(value)).all()


@pytest.mark.long
@pytest.mark.parametrize("count", [6, pytest.param(100, marks=pytest.mark.soak)])
def test_decisions_stand_against_dense_sampling(count: int) -> None:
    """Random families and gains, from calm to far too loud: what is proved has no unstable member among thousands."""
    rng = np.random.default_rng(count)
    seen = []
    for trial in range(count):
        values = {
            "w_n": rng.uniform(2.5, 4.0),
            "xi": rng.uniform(0.05, 0.2),
            "mu": rng.uniform(270.0, 380.0),
            "dead_time": rng.uniform(0.010, 0.020),
            "lag": rng.uniform(0.002, 0.011),
        }
        sigmas = {"w_n": 0.05 * values["w_n"], "mu": rng.uniform(0.01, 0.08) * values["mu"], "dead_time": 0.0008}
        if trial % 2:
            sigmas["lag"] = 0.1 * values["lag"]
        family = PitchFamily.of(values, sigmas)
        plant = PitchRate(values["w_n"], values["xi"], values["mu"], values["dead_time"])
        gains = cascade_design(plant, float(rng.uniform(10.0, 28.0)), lag=values["lag"]).gains
        controller = louder(SampledController.of_cascade(*gains.rate, gains.attitude), rng.uniform(0.8, 3.0))
        found = certificate(controller, family, 4.0)
        seen.append(found.decision)
        radii = PitchLoop(in_region(family, 4.0, 2000, trial), controller).radii()
        if found.decision is RegionStability.stable:
            assert radii.max() < 1.0
        else:
            assert found.witness is not None or found.decision is RegionStability.undecided
        if radii.max() >= 1.0:
            assert found.decision is not RegionStability.stable
    assert {RegionStability.stable, RegionStability.unstable} <= set(seen), "the cases are on both sides of the border"
    # what is left open is refused; it may not be the rule
    assert seen.count(RegionStability.undecided) <= 0.1 * count


@pytest.mark.long
def test_border_of_what_is_proved_is_near_the_first_unstable_member() -> None:
    """The gap between both is what the proof gives away: with two parameters it can be told to a per mille."""
    family = PitchFamily.of(VALUES, {"mu": 18.0, "dead_time": 0.0015})
    controller = louder(STOCK, 2.0)
    angle = np.linspace(0.0, 2.0 * math.pi, 500)

    def worst(radius: float) -> float:
        n = len(angle)
        columns = {name: np.full(n, float(value)) for name, value in VALUES.items()}
        columns["mu"] += 18.0 * radius * np.cos(angle)
        columns["dead_time"] += 0.0015 * radius * np.sin(angle)
        return float(PitchLoop(PitchMembers(**columns), controller).radii().max())

    low, high = 0.1, 6.0
    for _ in range(14):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if worst(middle) < 1.0 else (low, middle)
    assert certificate(controller, family, 0.998 * low).decision is RegionStability.stable
    assert certificate(controller, family, 1.002 * high).decision is RegionStability.unstable


@pytest.mark.long
def test_stability_radius_is_that_of_a_dense_search() -> None:
    """mu of two real parameters by branch and bound, against the first unstable member on 500 rays."""
    family = PitchFamily.of(VALUES, {"mu": 18.0, "dead_time": 0.0015})
    controller = louder(STOCK, 2.0)
    found = stability_radius(controller, family, tolerance=0.05)
    assert found.witness is not None
    assert found.broken <= 1.05 * found.proved
    angle = np.linspace(0.0, 2.0 * math.pi, 500)
    worst = {}
    for radius in (found.proved, found.broken):
        columns = {name: np.full(len(angle), float(value)) for name, value in VALUES.items()}
        columns["mu"] += 18.0 * radius * np.cos(angle)
        columns["dead_time"] += 0.0015 * radius * np.sin(angle)
        worst[radius] = float(PitchLoop(PitchMembers(**columns), controller).radii().max())
    assert worst[found.proved] < 1.0 <= worst[found.broken]
    low, high = found.mu
    assert low == 1.0 / found.broken < high == 1.0 / found.proved
    # a loop that is far from unstable: no member within 20 standard deviations
    calm = stability_radius(STOCK, PitchFamily.of(VALUES, {"mu": 3.0}))
    assert (calm.proved, calm.broken) == (20.0, math.inf)


def test_other_controllers_are_certified_too() -> None:
    paper = PitchFamily.of({**VALUES, "dead_time": 0.02, "lag": 0.0}, {"mu": 12.0, "dead_time": 0.0005})
    assert certificate(SampledController.of(lqr_attitude()), paper, 3.7).decision is RegionStability.stable
    assert certificate(SampledController.of(lqg_attitude(FAMILY)), FAMILY, 2.0).decision is RegionStability.stable
    assert certificate(STOCK, PitchFamily.of(VALUES), 1.0).decision is RegionStability.stable


def test_bounds_of_a_member_cut_the_region() -> None:
    """A dead time that may be none: the region is cut at 0, through three whole samples, and still decided."""
    family = PitchFamily.of({**VALUES, "dead_time": 0.004}, {"dead_time": 0.0015, "lag": 0.003, "mu": 10.0})
    found = certificate(STOCK, family, 3.0)
    assert found.decision is RegionStability.stable
    assert PitchLoop(in_region(family, 3.0, 3000, 1), STOCK).radii().max() < 1.0


def test_what_is_left_open_counts_as_refused() -> None:
    sure = robustness(STOCK, FAMILY, members=50)
    assert sure.robust
    assert sure.decision is RegionStability.stable
    left = robustness(STOCK, FAMILY, members=50, most=1)
    assert left.decision is RegionStability.undecided
    assert not left.robust
    assert "NOT PROVED" in left.text
    # an integral that nothing shows: no proof, and it says why
    hidden = SampledController(
        np.block([[STOCK.a, np.zeros((len(STOCK.a), 1))], [np.zeros((1, len(STOCK.a))), np.ones((1, 1))]]),
        np.vstack([STOCK.b, np.ones((1, 3))]),
        np.hstack([STOCK.c, np.zeros((1, 1))]),
        STOCK.d,
    )
    assert certificate(hidden, FAMILY, 1.0).decision is not RegionStability.stable


@pytest.mark.parametrize("radius", [0.0, -1.0, math.nan, math.inf])
def test_refuses_a_radius_that_cannot_be(radius: float) -> None:
    with pytest.raises(ParameterError) as caught:
        certificate(STOCK, FAMILY, radius)
    assert caught.value.remedy
