"""The virtual rig `paper`, flown through the compiled flight code: both methods give its parameters back."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.identify.signals import DT
from twodof.design import LoopTransfer, margins
from twodof.errors import ParameterError
from twodof.experiment import simulate
from twodof.identify import Estimate, Record, fit, identify_pitch
from twodof.models import pitch_rate, rail
from twodof.models.plant import thrust_curve
from twodof.rig.parameters import paper
from twodof.signals import Q_AGE
from twodof.sim.closed_loop import ClosedLoop, InitialState

pytestmark = pytest.mark.slow

Flown = Mapping[str, NDArray[np.float64]]

TRUE_PITCH = {"w_n": 3.437, "xi": 0.0836, "mu[impulse]": 130.0, "mu[doublet 1]": 358.5, "tau": 0.020}
TRUE_VELOCITY = {"k_v": 4.748, "p_v": 1.168}


def pitch_record(loop: ClosedLoop, seed: int, thrust: float, pulses: list[tuple[int, int, float]], name: str) -> Record:
    """One open-loop flight; `pulses` are (from step, to step, moment)."""
    steps = 5000 if thrust == 0.0 else 1500
    moment = np.zeros(steps)
    for first, last, value in pulses:
        moment[first:last] = value
    loop.configure({"seed": seed})
    loop.start(InitialState(hover=thrust > 0.0))
    flown = loop.fly(steps, {"mode": "open-loop", "M_open": moment, "thrust": thrust})
    time = DT * np.arange(steps)
    stamped = {"M": (time, flown["M"]), "q": (time - Q_AGE, flown["q"])}  # as the drone's logs stamp them
    return Record.from_channels(stamped, ["M"], ["q"], name=name)


def fly_velocity(conditions: Mapping[str, float]) -> Flown:
    """The paper's doublet of 15 degrees and 0.8 s, in attitude mode."""
    loop = ClosedLoop(rig=paper(), conditions=conditions)
    loop.start(InitialState(hover=True, x=0.15))
    pitch = np.zeros(900)
    pitch[200:400], pitch[400:600] = np.radians(15.0), -np.radians(15.0)
    return loop.fly(900, {"mode": "attitude", "theta0": pitch, "thrust": 0.4})


@pytest.fixture(scope="module")
def pitch_records() -> tuple[Record, list[Record]]:
    loop = ClosedLoop(rig=paper(), conditions={"rings": True})
    impulse = pitch_record(loop, 1, 0.0, [(250, 300, 0.1)], "impulse")
    edges = [(125, 200, 0.03), (200, 275, -0.03)]
    return impulse, [pitch_record(loop, 1 + i, 0.4, edges, f"doublet {i}") for i in (1, 2, 3)]


@pytest.fixture(scope="module")
def greybox(pitch_records: tuple[Record, list[Record]]) -> Estimate:
    impulse, doublets = pitch_records
    return fit(pitch_rate(), [impulse, doublets[0]], separate=["mu"], validation=doublets[1:])


def test_simple_method_on_the_pitch_rate(pitch_records: tuple[Record, list[Record]]) -> None:
    found = identify_pitch(*pitch_records)
    figures = (found.model.w_n, found.model.xi, found.model.mu)
    assert figures == (pytest.approx(3.437, rel=0.02), pytest.approx(0.0836, rel=0.15), pytest.approx(358.5, rel=0.07))
    assert found.model.tau == pytest.approx(TRUE_PITCH["tau"], abs=DT)
    assert min(value for _, value in found.validation) > 90.0


@pytest.mark.long
def test_grey_box_on_the_pitch_rate(greybox: Estimate) -> None:
    assert greybox.converged
    for label, true in TRUE_PITCH.items():
        assert abs(greybox[label] - true) < 3.0 * greybox.sigma(label), label
    # And that is not because the deviations are large.
    assert greybox.sigma("w_n") < 1e-3
    assert greybox.sigma("mu[doublet 1]") < 1.0
    assert greybox.sigma("tau") < 2e-4


def test_each_record_has_its_own_noise(greybox: Estimate) -> None:
    # Motors idle 1.4 mrad/s and the rounding of 1.07 mrad/s / sqrt(12); in hover 60 mrad/s.
    assert greybox.noise["q[impulse]"] == pytest.approx(0.0015, rel=0.15)
    assert greybox.noise["q[doublet 1]"] == pytest.approx(0.06, rel=0.1)


def test_unseen_doublets_are_predicted(greybox: Estimate) -> None:
    assert [one.record for one in greybox.validation] == ["doublet 2", "doublet 3"]
    for one in greybox.validation:
        # What is left is the noise of hovering.
        assert one.rmse == pytest.approx(0.06, rel=0.1)
        assert one.inputs["M"].passed


def test_grey_box_on_velocity_from_gyro_and_range() -> None:
    curve = thrust_curve(TRUE_PITCH["mu[impulse]"], TRUE_PITCH["mu[doublet 1]"])
    records = []
    for seed in (5, 6, 7):
        flown = fly_velocity({"seed": seed})
        t, new = DT * np.arange(900), flown["dist_new"].astype(bool)
        channels = {
            "q": (t, flown["gyro_y"]),
            "M": (t, flown["M"]),
            "T": (t, flown["T"]),
            "x": (t[new], flown["dist"][new] - 0.5),
        }
        records.append(Record.from_channels(channels, ["q", "M", "T"], ["x"], smooth=["q"], name=f"velocity {seed}"))
    found = fit(rail(thrust=True), records, values={"curve": curve})
    for label, true in TRUE_VELOCITY.items():
        assert abs(found[label] - true) < 3.0 * found.sigma(label), label
        assert found.sigma(label) < 0.02
    assert found.white


def test_without_noise_the_structure_is_the_rig() -> None:
    flown = fly_velocity({"noise": 0.0})
    t = DT * np.arange(900)
    channels = {name: (t, flown[key]) for name, key in (("q", "true_q"), ("M", "M"), ("T", "T"), ("v", "true_v"))}
    record = Record.from_channels(channels, ["q", "M", "T"], ["v"], smooth=["q"])
    curve = thrust_curve(TRUE_PITCH["mu[impulse]"], TRUE_PITCH["mu[doublet 1]"])
    found = fit(
        rail(thrust=True),
        record,
        estimate=("k_v", "p_v", "theta_0", "v_0"),
        values={"curve": curve, "rotor_delay": TRUE_PITCH["tau"] + Q_AGE},
        disturbance="white",
    )
    # The structure takes q between its 4 ms samples as a straight line, which for a loop of 12 rad/s errs by
    # (12 * 0.004)^2 / 8 of it.
    assert found["k_v"] == pytest.approx(4.748, rel=2.9e-4)
    assert found["p_v"] == pytest.approx(1.168, rel=2.9e-4)
    # A constant thrust would cost 3 % of p_v: hard pitch manoeuvres lift more.
    constant = fit(rail(), record, estimate=("k_v", "p_v", "theta_0", "v_0"), disturbance="white")
    assert constant["p_v"] < 0.98 * 1.168


def test_results_print_as_one_short_line(greybox: Estimate, pitch_records: tuple[Record, list[Record]]) -> None:
    flight = simulate("doublet", seed=3)
    shown = (flight, flight.log, flight.log["q"], greybox, greybox.linear(DT), *greybox.identification)
    for one in (*shown, *pitch_records[1]):
        assert len(repr(one)) < 600, type(one)
        assert "\n" not in repr(one), type(one)
    assert repr(flight).startswith(
        "<Flight doublet, seed 3: good; log=<FlightLog log: 10.00 to 32.20 s, 22 channels: acc"
    )
    assert repr(pitch_records[0]) == "<Record impulse: 5000 steps of 0.004 s from 0 s; inputs M; outputs q>"
    assert repr(flight.log["q"]) == "<Channel q [rad/s]: 5550 samples, 10.00 to 32.20 s>"
    mu, sigma = greybox["mu[impulse]"], greybox.sigma("mu[impulse]")
    assert f" mu[impulse] {mu:.4g} +- {sigma:.2g} rad/s2, " in repr(greybox)
    assert f" mu[impulse] {mu:.4g} (at its bound), " in repr(replace(greybox, at_bound=("mu[impulse]",)))


def test_an_estimate_goes_to_python_control(greybox: Estimate) -> None:
    """At low frequencies q / M is mu j w / w_n^2 of the pendulum for any delay."""
    system = greybox.linear(DT).to_control()
    omega = 0.01
    (gain,) = np.abs(system(np.exp(1j * omega * DT))[system.output_labels.index("q")])
    assert gain == pytest.approx(greybox["mu[impulse]"] * omega / greybox["w_n"] ** 2, rel=1e-3)
    loop = LoopTransfer.of(greybox.linear(DT), "M", "q")
    found = margins(loop.scaled(0.1))
    phase = f"{found.phase_margin_deg:.1f} deg at {found.crossover:.3g} rad/s"
    assert f"gain margin +{found.gain_margin_db:.1f} dB, phase margin {phase}, delay margin" in repr(found)
    with pytest.raises(ParameterError, match=r"estimate\.linear\(dt\)"):
        margins(greybox)
