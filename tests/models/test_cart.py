"""The cart's part in the pitch: what the block says, and what a fit gains by it on the rig `lab`."""

import math
from collections.abc import Mapping

import numpy as np
import pytest

from twodof.blocks.reference.interpreter import Reference
from twodof.experiment.flight import Laboratory
from twodof.identify.estimate import Estimate
from twodof.identify.experiments import cut, only
from twodof.identify.greybox import fit
from twodof.identify.ready_made import TRAVEL, known_cart, known_rail, true_values
from twodof.identify.record import Record
from twodof.identify.simulation import simulate
from twodof.models.dry_friction import CartPush
from twodof.models.structure import Structure
from twodof.models.structures import pitch_on_cart, pitch_rate, rail
from twodof.rig.parameters import load_rig
from twodof.rig.rig import model_parameters

pytestmark = pytest.mark.slow

DT = 0.004


def pushed(theta: np.ndarray, q: np.ndarray, values: Mapping[str, float]) -> np.ndarray:
    machine = Reference(Structure.of_block(CartPush()).diagram, dt=DT).machine()
    machine.set_many(values)
    machine.reset()
    return np.array(machine.run(theta.size, {"theta": theta, "q": q})["push"])


def test_a_cart_that_runs_into_its_stop_gives_back_all_that_it_took() -> None:
    values = {"coupling": 0.8, "play": 0.001, "k_v": 5.0, "p_v": 0.0}
    push = pushed(np.full(60, 0.1), np.zeros(60), values)
    drive = 0.8 * 5.0 * math.sin(0.1)
    # Half of 5 sin(.1) t^2 is .001 m after .063 s: 15 whole steps slide, and the 16th is that of the impact.
    assert push[:15] == pytest.approx(np.full(15, drive))
    assert push[15] == pytest.approx(-15.0 * drive)
    assert (push[16:] == 0.0).all()


def test_a_cart_without_play_leaves_only_the_bearing() -> None:
    q = np.array([0.0, 0.2, -0.2, 0.3])
    push = pushed(np.full(4, 0.1), q, {"coupling": 0.8, "lever": 0.004, "play": 0.0, "coulomb": 0.05})
    assert push == pytest.approx([0.0, -0.05, 0.05, -0.05])


def test_a_noisy_gyro_gives_the_friction_that_is_expected() -> None:
    # Of a true q that may be any, drawn about the measured one.
    q = np.linspace(-0.1, 0.1, 41)
    push = pushed(np.zeros(41), q, {"play": 0.0, "coulomb": 0.05, "q_noise": 0.02})
    drawn = np.sign(q[:, None] + np.random.default_rng(1).normal(0.0, 0.02, (41, 100_000)))
    assert push == pytest.approx(-0.05 * drawn.mean(axis=1), abs=0.05 * 4.0 / math.sqrt(100_000) + 2e-5)


def test_dry_friction_of_the_rail_holds_the_cart() -> None:
    values = {"coupling": 0.8, "play": 0.001, "k_v": 5.0, "rail_coulomb": 0.06}
    assert (pushed(np.full(20, 0.011), np.zeros(20), values) == 0.0).all()
    assert (pushed(np.full(20, 0.013), np.zeros(20), values) > 0.0).any()


def test_the_speed_along_the_rail_pitches_the_drone() -> None:
    values = {"coupling": 0.0, "play": 1e3, "k_v": 5.0, "p_v": 0.0, "M_u": 7.0}
    push = pushed(np.full(50, -0.1), np.zeros(50), values)
    # The mean speed of each step of 4 ms, which grows by 5 sin(.1) each second.
    assert push == pytest.approx(7.0 * 5.0 * math.sin(0.1) * DT * (np.arange(50) + 0.5))


def test_a_large_moment_that_lacks_something_is_told_from_a_small_gain() -> None:
    known = {"w_n": 2.4, "xi": 0.05, "mu": 300.0, "dead_time": 0.01, "lag": 0.012, "bend": 1.5, "play": 0.0}
    kicks = 0.05 * np.sign(np.sin(np.arange(900) / 30.0))
    kicks[::90] *= 7.0
    inputs, time = {"M": kicks, "theta": np.zeros(900), "gyro": np.zeros(900)}, DT * np.arange(900)

    def record_with(q: np.ndarray) -> Record:
        return Record.from_columns(time, {**inputs, "q": q}, list(inputs), ["q"], "a pulse of .35 in every .36 s")

    truth = np.asarray(simulate(pitch_on_cart(), record_with(np.zeros(900)), known)["q"])
    record = record_with(truth + 0.01 * np.random.default_rng(1).normal(size=900))
    held = {name: value for name, value in known.items() if name not in ("mu", "bend")}
    both = fit(pitch_on_cart(), record, estimate=("mu", "bend", "theta_0", "q_0"), values=held)
    alone = fit(pitch_on_cart(), record, estimate=("mu", "theta_0", "q_0"), values=held, disturbance="white")
    for name in ("mu", "bend"):
        assert abs(both[name] - known[name]) < 3.3 * both.sigma(name), name
    assert both["bend"] > 5.0 * both.sigma("bend")
    # Without it a pulse of .35 seems to be one of .35 (1 - 1.5 .35^2).
    assert alone["mu"] < 300.0 - 5.0 * alone.sigma("mu")


def test_with_the_cart_the_model_is_the_rig() -> None:
    # Without noise what is left is what the structure leaves out. It leaves out the wake that a pitched drone meets,
    # and the battery, by which mu falls by 2 % within the flight.
    parameters = load_rig("lab")
    for name, value in (("wake_fade", 0.0), ("resistance", 0.0), ("capacity", 1e9)):
        parameters.set(name, value)
    laboratory = Laboratory(parameters, noise=0.0)
    rig = parameters.snapshot()
    log = laboratory.fly("attitude-prbs").log
    record = cut(log, "attitude")
    known = model_parameters(rig)
    poles = {"w_n": known["w_n_run"], "xi": known["xi_run"]}
    unknowns = ("mu", "dead_time", "lag", "theta_0", "q_0")
    cart = {**poles, **known_cart(rig, pitch_on_cart(), free=False), "coulomb": known["coulomb_run"]}

    def found(structure: Structure, values: Mapping[str, float]) -> tuple[float, Estimate]:
        one = fit(structure, record, estimate=unknowns, values=values, disturbance="white")
        return float(np.std(record.outputs["q"].value - simulate(structure, record, one)["q"])), one

    (left, on_cart), (more, _) = found(pitch_on_cart(), cart), found(pitch_rate(lag=True), poles)
    assert left < more / 3.0
    assert on_cart["mu"] == pytest.approx(known["mu"], rel=1e-3)
    assert on_cart["tau"] == pytest.approx(known["tau"], abs=5e-5)


def test_the_lever_takes_the_bias_off_a_velocity_doublet() -> None:
    laboratory = Laboratory("lab", noise=0.0)
    rig = laboratory.parameters.snapshot()
    log = laboratory.fly("velocity-doublet").log
    record = only(cut(log, "velocity"), "x")
    known, _ = known_rail(rig)
    dry = {"coulomb": model_parameters(rig)["rail_coulomb"]}

    def gain(lever: float) -> float:
        return fit(rail(thrust=True), record, estimate=TRAVEL, values={**known, **dry, "lever": lever})["k_v"]

    truth = true_values(rig, "velocity", log, record.start, float(record.time[-1]))["k_v"]
    # .2 % is left: the rotors' lag, which the structure takes for a delay, and the part of the friction that goes with
    # the lever.
    assert gain(known["lever"]) == pytest.approx(truth, rel=0.003)
    assert gain(0.0) < 0.99 * truth


def test_the_default_knows_what_the_rig_has() -> None:
    rig = load_rig("lab")
    # Physics, equation (2): what a radian of pitch moves the drone's centre by, shared with the cart.
    moved = rig["offset"] * rig["mass_drone"] / (rig["mass_drone"] + rig["mass_cart"])
    assert known_rail(rig.snapshot())[0]["lever"] == pytest.approx(moved, rel=1e-12)
    assert 0.003 < moved < 0.006
