"""mu found while it flies: on the exact model, beside the fit of the whole record, and inside a controller."""

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import bilinear, lfilter

from tests.identify.signals import DT, doublet, pitch_record
from twodof.blocks import Diagram
from twodof.blocks.library import Gain
from twodof.blocks.schema import from_json, to_json
from twodof.compile import build
from twodof.experiment.flight import Laboratory
from twodof.flight.templates import ATTITUDE, check_template
from twodof.flightlog.contents import excitations
from twodof.flightlog.files import read_log
from twodof.flightlog.log import FlightLog
from twodof.identify.greybox import fit
from twodof.identify.record import Record
from twodof.models.moment_gain import PitchRegressors, moment_gain
from twodof.models.plant import PitchRate
from twodof.models.structures import pitch_rate

pytestmark = pytest.mark.slow

MODEL = PitchRate(3.437, 0.0836, 358.5, 0.0187)
PRBS = 0.02 * np.sign(np.random.default_rng(8).standard_normal(400)).repeat(5)


def run(d: Diagram, record: Record, learn: np.ndarray | bool, **values: float) -> dict[str, np.ndarray]:
    machine = build(d, dt=record.dt).machine()
    machine.set_many(values)
    samples = record.outputs["q"]
    q = np.interp(np.arange(record.steps), samples.position, samples.value)
    told = np.broadcast_to(np.asarray(learn), record.steps)
    return machine.run(record.steps, {"M": record.inputs["M"], "q": q, "learn": told})


def test_the_regressors_are_the_filters_of_scipy() -> None:
    """F = w^2 s^2 / E^2 of q, and its first and second integral, by the trapezoidal rule exact at the cut-off."""
    steps, cutoff = 500, 4.0
    rng = np.random.default_rng(2)
    moment, q = rng.standard_normal((2, steps))
    block = PitchRegressors(cutoff=cutoff, tau=1.25 * DT)
    d = Diagram("regressors")
    for port in block.inputs:
        d.input(port.name, unit=port.unit)
    d.add("made", block, M="M", q="q")
    for port in block.outputs:
        d.output(port.name, f"made.{port.name}")
    found = build(d, dt=DT).machine().run(steps, {"M": moment, "q": q})
    omega, w = 2.0 * np.pi * cutoff, 2.0 / DT * np.tan(np.pi * cutoff * DT)

    def filtered(signal: np.ndarray, order: int) -> np.ndarray:
        poles = np.polymul([1.0, 1.4 * w, w**2], [1.0, 1.4 * w, w**2])
        return lfilter(*bilinear([w ** (4 - order), *[0.0] * order], poles, 1.0 / DT), signal)

    before = moment[0]  # of a held input half a step is added to the delay: 1.75 steps
    late = 0.25 * np.append(before, moment[:-1]) + 0.75 * np.concatenate([[before] * 2, moment[:-2]])
    expected = [filtered(late, 1) / omega, -filtered(q, 1) / omega, -filtered(q, 0) / omega**2]
    np.testing.assert_allclose(found["y"], filtered(q, 2), atol=1e-9)
    np.testing.assert_allclose(found["phi"], np.transpose(expected), atol=1e-9)
    assert np.argmax(found["settled"]) == int(10.0 / (omega * DT))


def test_nothing_is_learnt_with_a_delay_longer_than_the_ring() -> None:
    record = pitch_record(MODEL, PRBS, 0.0, np.random.default_rng(0))
    for tau, learns in ((5.5 * DT, True), (5.6 * DT, False)):
        assert (run(moment_gain(ring=8), record, True, tau=tau)["mu"][-1] != 300.0) is np.bool_(learns)


def test_without_noise_it_finds_all_three_numbers() -> None:
    record = pitch_record(MODEL, PRBS, 0.0, np.random.default_rng(0))
    found = run(moment_gain(), record, True, tau=0.0187)
    # The trapezoidal rule of the filters is off by (w T)^2 / 12, a few thousandths at the band's upper end.
    assert found["mu"][-1] == pytest.approx(358.5, rel=0.005)
    assert found["a0"][-1] == pytest.approx(3.437**2, rel=0.15)


@pytest.mark.long
@pytest.mark.parametrize("applied", [PRBS, doublet(1000, 1.0, 0.6, 0.03)], ids=["prbs", "doublet"])
def test_its_sigma_covers_the_truth_and_the_batch_fit(applied: np.ndarray) -> None:
    off, beside = [], []
    diagram = moment_gain()
    for seed in range(12):
        record = pitch_record(MODEL, applied, 0.06, np.random.default_rng(seed))
        found = run(diagram, record, True, tau=0.0187)
        off.append((found["mu"][-1] - 358.5) / found["sigma"][-1])
        if seed < 2:
            whole = fit(pitch_rate(), record, estimate=["mu"], values={"w_n": 3.437, "xi": 0.0836, "tau": 0.0187})
            beside.append((found["mu"][-1] - whole["mu"]) / found["sigma"][-1])
    # It is cautious by up to two: every tenth sample counts alone. Regression's own bias is within it.
    assert 0.2 < np.sqrt(np.mean(np.square(off))) < 1.6
    assert np.abs(beside).max() < 3.0


def test_it_says_how_sure_it_is_while_it_learns() -> None:
    record = pitch_record(MODEL, PRBS, 0.06, np.random.default_rng(1))
    found = run(moment_gain(), record, np.arange(PRBS.size) > 500, tau=0.0187)
    assert (found["mu"][:500] == 300.0).all()
    assert (np.diff(found["sigma"][[600, 900, 1500, 1999]]) < 0.0).all()


def flown(log: FlightLog) -> tuple[Record, np.ndarray]:
    """The flight's M and q, and when its excitation played."""
    start = max(float(log["M"].time[0]), float(log["q"].time[0]))
    record = Record.from_log(log, ["M"], ["q"], start, float(log["M"].time[-1]))
    played = max(excitations(log), key=lambda one: one.edges[-1] - one.edges[0])
    return record, (record.time > played.edges[0] - 0.05) & (record.time < played.edges[-1] + 0.1)


def test_on_a_virtual_flight_it_finds_the_rig_s_mu() -> None:
    record, plays = flown(Laboratory("paper").fly("attitude-steps", seed=1).log)
    found = run(moment_gain(), record, plays, tau=0.0187)
    # In closed loop M answers the noise a little: eight flights gave 357.0 +- .4, claiming 2.6.
    assert found["mu"][-1] == pytest.approx(358.5, abs=3.0 * found["sigma"][-1])
    assert found["sigma"][-1] < 5.0


def test_it_runs_inside_a_controller_that_flies() -> None:
    d = Diagram("watching", "a rate loop that watches its own mu")
    for port in ATTITUDE.inputs:
        d.input(port.name, port.kind, unit=port.unit)
    d.add("damper", Gain(-0.05), u="q")
    d.add("watch", moment_gain(), M="damper", q="q", learn="FLAG_ATTITUDE_ENABLED")
    d.output("M", "damper")
    check_template(d)
    machine = build(from_json(to_json(d)), dt=DT, precision="float32", log=["watch.mu"]).machine()
    q = np.random.default_rng(1).standard_normal(500)
    rows = machine.run(500, {"q": q, "FLAG_ATTITUDE_ENABLED": np.ones(500, dtype=bool)})
    assert np.isfinite(rows["watch.mu"]).all()
    assert np.ptp(rows["watch.mu"]) > 0.0


def test_on_a_real_flight_it_agrees_with_the_fits(flight_data: Path) -> None:
    record, plays = flown(read_log(flight_data / "attitude-steps-10deg-default.mat"))
    found = run(moment_gain(), record, plays, tau=0.0092, lag=0.012)
    # The fit between 3 and 20 Hz gives 280 +- 10 (docs/explanation/identification.md, section 9).
    assert abs(found["mu"][-1] - 280.0) < 2.0 * np.hypot(10.0, found["sigma"][-1])
