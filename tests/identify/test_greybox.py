"""The grey-box fit: several experiments, any diagram, both domains, honest uncertainty, and what it refuses."""

import json
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from tests.identify.signals import DT, doublet, pitch_record
from twodof.blocks.diagram import Diagram
from twodof.blocks.library import FirstOrder
from twodof.errors import IdentificationError
from twodof.flightlog.log import Channel, FlightLog
from twodof.identify import Estimate, Record, fit, fit_percent
from twodof.identify.record_simulator import program_of
from twodof.models import PAPER_PITCH_RATE, PitchRate, Structure, free_response, linear_model, pitch_rate, velocity

pytestmark = pytest.mark.slow

Array = NDArray[np.float64]
U = doublet(1500, 0.5, 0.6, 0.03)


def lag_structure() -> Structure:
    """Return a user's structure: gain and first-order lag, from column u to column y."""
    d = Diagram("my_lag")
    d.input("u")
    d.param("K", 1.0, low=0.0)
    d.param("T", 0.1, unit="s", low=1e-3)
    d.add("lag", FirstOrder(), params={"gain": "K", "time_constant": "T"}, u="u")
    d.output("y", "lag")
    return Structure(d, ("K", "T"))


def test_a_users_diagram_fits_columns_of_a_table() -> None:
    rng = np.random.default_rng(0)
    t = 0.01 * np.arange(600)
    u = np.sign(np.sin(1.3 * t))
    a = np.exp(-0.01 / 0.25)
    clean = lfilter([0.0, 2.0 * (1.0 - a)], [1.0, -a], u)
    table = {"time": t, "u": u, "y": clean + 0.05 * rng.standard_normal(600)}
    record = Record.from_columns(table["time"], table, ["u"], ["y"])
    found = fit(lag_structure(), record)
    assert abs(found["K"] - 2.0) < 3.0 * found.sigma("K")
    assert abs(found["T"] - 0.25) < 3.0 * found.sigma("T")
    assert found.noise["y"] == pytest.approx(0.05, rel=0.1)
    assert found.white


def motor_record(clock: float = 1.0, u: float = 0.0, y: float = 0.0) -> Record:
    """Return the record of x' = -2 x + 3 u every .02 s, on a clock of another unit or around another point."""
    rng = np.random.default_rng(3)
    applied = np.repeat(rng.choice([-1.0, 1.0], 20), 20)
    a = np.exp(-0.04)
    measured = lfilter([0.0, 1.5 * (1.0 - a)], [1.0, -a], applied) + 0.01 * rng.standard_normal(400)
    columns = {"u": applied + u, "y": measured + y}
    return Record.from_columns(clock * 0.02 * np.arange(400), columns, ["u"], ["y"])


MOTOR = linear_model([["-a"]], [["b"]], [[1]], inputs=["u"], outputs=["y"], guess={"a": 1.0, "b": 1.0})


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("structure", [MOTOR, lag_structure()], ids=["linear", "diagram"])
@pytest.mark.parametrize(("clock", "unit"), [(1e3, "milli"), (1e6, "micro"), (1e9, "nano")])
def test_time_that_is_not_in_seconds_is_named(structure: Structure, clock: float, unit: str) -> None:
    says = f"{re.escape(f'within a step of {0.02 * clock:g} s')}, .*time is in {unit}seconds"
    with pytest.raises(IdentificationError, match=says):
        fit(structure, motor_record(clock))


def test_signals_far_from_zero_are_named() -> None:
    def offsets(found: Estimate) -> list[str]:
        return [one for one in found.remarks if "far from 0" in one]

    assert offsets(fit(MOTOR, motor_record())) == offsets(fit(lag_structure(), motor_record())) == []
    far = motor_record(u=1500.0, y=20.0)
    (said,) = offsets(fit(MOTOR, far))
    assert said.startswith("u lies at 1500 +- 0.95 and y lies at 19.61 +- 0.78 in ")
    assert (
        "estimate u_trim too, or estimate y_bias too, or subtract the means (`--detrend`, `record.detrend()`)" in said
    )
    # Without an unknown for the offset its error is larger than what moves.
    with pytest.raises(IdentificationError, match=r"diverge.*far from 0, .* account for: subtract the mean"):
        fit(lag_structure(), far)
    found = fit(MOTOR, far, estimate=("a", "b", "x1_0", "u_trim"))
    assert (found["a"], found["b"]) == pytest.approx((2.0, 3.0), rel=0.02)
    assert offsets(found) == []


def test_the_noise_of_short_records_is_not_underrated() -> None:
    """The variance of the residuals counts the unknowns: over many records of twelve samples it is the true one."""
    rng = np.random.default_rng(7)
    u = np.tile([1.0, 1.0, -1.0, -1.0], 3)
    t = 0.05 * np.arange(u.size)
    a = np.exp(-0.5)
    found = []
    for _ in range(60):
        clean = lfilter([0.0, 2.0 * (1.0 - a)], [1.0, -a], u)
        record = Record.from_columns(t, {"u": u, "y": clean + 0.05 * rng.standard_normal(u.size)}, ["u"], ["y"])
        found.append(fit(lag_structure(), record).noise["y"] ** 2)
    # 60 estimates of 9 degrees of freedom each: a standard error of sqrt(2 / 540), 6 %; three of them.
    assert np.mean(found) == pytest.approx(0.05**2, rel=0.18)


def test_records_share_parameters_and_keep_initial_states() -> None:
    rng = np.random.default_rng(1)
    records = [
        pitch_record(PAPER_PITCH_RATE, sign * U[:700], 0.06, rng, name=name) for sign, name in ((1, "up"), (-1, "down"))
    ]
    alone, both = fit(pitch_rate(), records[0]), fit(pitch_rate(), records)
    assert {"theta_0[up]", "q_0[down]", "mu"} < set(both.labels)
    # Twice the data, half the variance.
    assert fit(pitch_rate(), records, estimate="mu", separate="mu").labels == ("mu[up]", "mu[down]")
    assert both.cramer_rao("mu") == pytest.approx(alone.cramer_rao("mu") / np.sqrt(2.0), rel=0.1)
    for label, true in (("w_n", 3.437), ("xi", 0.0836), ("mu", 358.5), ("tau", 0.020)):
        assert abs(both[label] - true) < 3.5 * both.sigma(label)


def test_validation_records_get_their_own_initial_state_only() -> None:
    rng = np.random.default_rng(3)
    seen = pitch_record(PAPER_PITCH_RATE, U, 0.06, rng, name="seen")
    plant = PAPER_PITCH_RATE.state_space().zero_order_hold(DT)
    q = plant.simulate(U, x0=[0.2, -0.5])[:, 1] + 0.06 * rng.standard_normal(U.size)
    unseen = Record.from_columns(DT * np.arange(U.size), {"M": U, "q": q}, ["M"], ["q"], "unseen")
    found = fit(pitch_rate(), seen, validation=unseen)
    (one,) = found.validation
    assert one.record == "unseen"
    assert one.rmse == pytest.approx(0.06, rel=0.1)
    assert one.fit_percent == pytest.approx(fit_percent(one.measured, one.simulated))
    # A local unknown that is given and not fitted holds for the unseen record too, by its name or for this one alone.
    lifted = replace(unseen, outputs={"q": replace(unseen.outputs["q"], value=q + 0.5)})
    for given in ({"q_bias[unseen]": 0.5}, {"q_bias": 0.5, "q_bias[seen]": 0.0}):
        (same,) = fit(pitch_rate(), seen, validation=lifted, values=given).validation
        assert same.rmse == pytest.approx(one.rmse, rel=1e-3)


def test_the_frequency_domain_agrees_and_drops_a_drift() -> None:
    rng = np.random.default_rng(4)
    record = pitch_record(PAPER_PITCH_RATE, U, 0.06, rng)
    in_time, in_band = fit(pitch_rate(), record), fit(pitch_rate(), record, band=(0.1, 20.0))
    for label in ("w_n", "xi", "mu", "tau"):
        assert in_band[label] == pytest.approx(in_time[label], abs=2.0 * in_time.sigma(label))
        assert in_band.cramer_rao(label) == pytest.approx(in_time.cramer_rao(label), rel=0.25)
    # A slow disturbance, one wave of 1 rad/s over the record (0.17 Hz), ruins the fit in time, not one above 0.3 Hz.
    t = DT * np.arange(U.size)
    q = record.outputs["q"].value + np.sin(2.0 * np.pi * t / (DT * U.size))
    drifting = Record.from_columns(t, {"M": U, "q": q}, ["M"], ["q"])
    truth = {"w_n": 3.437, "xi": 0.0836, "mu": 358.5, "tau": 0.020}

    def worst(band: tuple[float, float] | None) -> float:
        found = fit(pitch_rate(), drifting, estimate=tuple(truth), band=band, disturbance="white")
        return max(abs(found[label] - true) / in_time.sigma(label) for label, true in truth.items())

    assert worst(None) > 10.0
    assert worst((0.3, 20.0)) < 5.0


@pytest.mark.long
def test_quoted_intervals_hold_for_coloured_residuals() -> None:
    # Noise through a lag of 5 samples: the white-noise covariance is several times too small, the robust one is not.
    rng = np.random.default_rng(5)
    truth = {"w_n": 3.437, "xi": 0.0836, "mu": 358.5, "tau": 0.020}
    clean = PAPER_PITCH_RATE.state_space().zero_order_hold(DT).simulate(U)[:, 1]
    errors, claimed, robust = [], [], []
    for _ in range(60):
        e = lfilter([0.02], [1.0, -0.8], rng.standard_normal(U.size + 100))[100:]
        record = Record.from_columns(DT * np.arange(U.size), {"M": U, "q": clean + e}, ["M"], ["q"])
        found = fit(pitch_rate(), record, estimate=tuple(truth), disturbance="white")
        assert not found.white
        errors.append([found[label] - true for label, true in truth.items()])
        claimed.append(np.diag(found.covariance))
        robust.append(np.diag(found.robust))
        i = found.labels.index("mu")
        assert found.sigma("mu") == pytest.approx(np.sqrt(found.robust[i, i]), rel=1e-9)
    scatter = np.var(errors, axis=0)
    # 60 samples tell a variance to 18 %, and the estimate of the residuals' colour has its own scatter.
    assert (np.mean(robust, axis=0) / scatter > 0.5).all()
    assert (np.mean(robust, axis=0) / scatter < 2.0).all()
    assert (np.mean(claimed, axis=0)[:3] / scatter[:3] < 0.3).all()


@pytest.mark.long
def test_residuals_tell_that_the_structure_is_wrong() -> None:
    rng = np.random.default_rng(6)
    values = {"w_n": 3.0, "xi": 0.03, "coulomb": 0.25, "mu": 130.0}
    u = np.concatenate([np.zeros(50), np.full(50, 0.1), np.zeros(1900)])
    machine = program_of(free_response(), DT).machine()
    machine.set_many(values)
    machine.reset()
    q = machine.run(u.size, {"M": u})["q"] + 0.01 * rng.standard_normal(u.size)
    record = Record.from_columns(DT * np.arange(u.size), {"M": u, "q": q}, ["M"], ["q"])
    wrong = fit(pitch_rate(), record)
    right = fit(free_response(), record, estimate=("w_n", "xi", "mu", "coulomb", "hardening", "tau"))
    assert wrong.disturbance.kind == "ar"
    assert right.disturbance.kind == "white"
    assert right.white
    plain = fit(pitch_rate(), record, disturbance="white")
    assert not plain.white
    assert any("not white" in remark for remark in plain.remarks)
    for label, true in values.items():
        assert abs(right[label] - true) < 3.5 * right.sigma(label)


OTHERS = tuple(name for name in pitch_rate().estimate if name != "mu")


@pytest.mark.long
def test_a_bound_that_holds_is_named() -> None:
    record = pitch_record(PAPER_PITCH_RATE, U, 0.06, np.random.default_rng(7))
    found = fit(pitch_rate(), record, bounds={"mu": (100.0, 300.0)}, values={"mu": 200.0})
    assert found.at_bound == ("mu",)
    assert found["mu"] == 300.0
    assert np.isnan(found.sigma("mu"))
    # What goes with mu is as unsure as if mu were free.
    assert found.sigma("w_n") > fit(pitch_rate(), record, estimate=OTHERS, values={"mu": 300.0}).sigma("w_n")
    assert any("mu is held by its bound" in remark for remark in found.remarks)
    assert "at bound" in found.table()
    assert "nan" not in found.table()
    assert json.loads(found.to_json())["estimates"]["mu"]["sigma"] is None


def test_the_result_speaks_to_people_and_machines() -> None:
    record = pitch_record(PAPER_PITCH_RATE, U, 0.06, np.random.default_rng(8))
    found = fit(pitch_rate(), record)
    table, plain = found.table(), json.loads(found.to_json())
    assert "rad/s2" in table
    assert "FIT" in table
    assert plain["estimates"]["mu"]["value"] == found["mu"]
    assert plain["identification"][0]["fit_percent"] == found.identification[0].fit_percent
    low, high = found.interval("mu", 0.95)
    assert high - low == pytest.approx(2 * 1.959964 * found.sigma("mu"), rel=1e-6)
    with pytest.raises(IdentificationError, match="'lag' was not estimated"):
        found["lag"]


def test_gaps_are_for_the_time_domain() -> None:
    record = pitch_record(PAPER_PITCH_RATE, U, 0.06, np.random.default_rng(13))
    t, q = record.output_time("q"), record.outputs["q"].value
    lost = np.ones(t.size, dtype=bool)
    lost[[200, 201, 640]] = False
    gappy = Record.from_channels({"M": (t, U), "q": (t[lost], q[lost])}, ["M"], ["q"])
    found = fit(pitch_rate(), gappy)
    assert abs(found["mu"] - 358.5) < 3.5 * found.sigma("mu")
    with pytest.raises(IdentificationError, match="single ones are lost"):
        fit(pitch_rate(), gappy, band=(0.1, 10.0))


def test_lost_samples_hardly_change_a_frequency_domain_fit() -> None:
    record = pitch_record(PAPER_PITCH_RATE, U, 0.06, np.random.default_rng(13))
    t, q = record.output_time("q"), record.outputs["q"].value
    kept = np.ones(t.size, dtype=bool)
    kept[50::40] = False
    lossy = Record.from_channels({"M": (t, U), "q": (t[kept], q[kept])}, ["M"], ["q"])
    whole, found = fit(pitch_rate(), record, band=(0.1, 20.0)), fit(pitch_rate(), lossy, band=(0.1, 20.0))
    for label in found.labels:
        # One sample in 40 was replaced by its neighbours' mean: noise of 1.5 / 40 of the record's variance is new.
        assert abs(found[label] - whole[label]) < 3.0 * np.sqrt(1.5 / 40.0) * whole.cramer_rao(label)
        assert found.cramer_rao(label) == pytest.approx(whole.cramer_rao(label), rel=0.1)


def test_a_slow_output_has_its_own_frequencies() -> None:
    record = pitch_record(PAPER_PITCH_RATE, U, 0.06, np.random.default_rng(15))
    t, q = record.output_time("q")[2::5], record.outputs["q"].value[2::5]
    slow = Record.from_channels({"M": (record.time, U), "q": (t, q)}, ["M"], ["q"])
    found = fit(pitch_rate(), slow, band=(0.1, 20.0))
    assert abs(found["mu"] - 358.5) < 3.5 * found.sigma("mu")
    with pytest.raises(IdentificationError, match="no Fourier coefficient lies in 30"):
        fit(pitch_rate(), slow, band=(30.0, 100.0))


def test_pieces_between_lost_inputs_give_the_truth() -> None:
    rng = np.random.default_rng(3)
    truth = PitchRate(w_n=3.4, xi=0.08, mu=300.0, tau=0.02)
    u = 0.05 * np.sign(np.sin(np.cumsum(rng.uniform(0.05, 0.4, 1500))))
    whole = pitch_record(truth, u, 0.01, rng)
    lost = np.zeros(u.size, dtype=bool)
    for start in range(100, 1500, 200):
        lost[start : start + 12] = True
    time = DT * np.arange(u.size)
    channels = {"M": (time[~lost], u[~lost]), "q": (time, whole.outputs["q"].value)}
    holed = Record.from_channels(channels, ["M"], ["q"], name="holed")
    held = fit(pitch_rate(), holed, disturbance="white")
    assert any("M has 7 gaps in 'holed', the longest of 52 ms" in remark for remark in held.remarks)
    pieces = fit(pitch_rate(), holed.pieces(), disturbance="white")
    assert len(holed.pieces()) == 8
    assert not any("gap" in remark for remark in pieces.remarks)
    assert abs(pieces["mu"] - 300.0) < 4.0 * pieces.sigma("mu")
    # What was held instead of known costs far more than that.
    assert abs(held["mu"] - 300.0) > 10.0 * pieces.sigma("mu")


def test_records_may_be_the_values_of_a_mapping() -> None:
    record = pitch_record(PAPER_PITCH_RATE, U, 0.06, np.random.default_rng(9))
    by_name = {"first": record, "second": replace(record, name="again")}
    found = [
        fit(pitch_rate(), given, estimate=("mu", "tau"), disturbance="white")
        for given in (list(by_name.values()), by_name.values(), (one for one in by_name.values()))
    ]
    assert found[0]["mu"] == found[1]["mu"] == found[2]["mu"]


TEN = DT * np.arange(10)
UNMEASURED = Record.from_columns(TEN, {"M": U[:10], "z": U[:10]}, ["M"], ["z"])
LOG = FlightLog({"M": Channel(TEN, U[:10], "-", (), "M")})


@pytest.mark.parametrize(
    ("structure", "records", "options", "message"),
    [
        (pitch_rate(), "one", {"estimate": ("muu",)}, r"no unknown is called 'muu'.*there are: .*w_n"),
        (pitch_rate(), "one", {"estimate": ["w_n", "mu", "mu"]}, "'mu' is named twice"),
        (pitch_rate(), "one", {"estimate": ()}, "names no unknown"),
        (pitch_rate(), "one", {"values": {"k": 1.0}}, "no unknown is called 'k'"),
        (pitch_rate(), "one", {"values": {"mu": 9000.0}}, "first guess 9000 of 'mu' is not within"),
        (pitch_rate(), "one", {"noise": {"q": -1.0}}, r"noise -1\.0 for 'q'"),
        (pitch_rate(), "one", {"values": {"w_n": float("nan")}}, "the value of 'w_n' is nan"),
        (pitch_rate(), "one", {"values": {"mu": "300"}}, "the value of 'mu' is '300'"),
        (pitch_rate(), "one", {"bounds": {"mu": (1.0,)}}, r"the bounds of 'mu' are \(1.0,\)"),
        (pitch_rate(), "one", {"bounds": {"mu": (500.0, 1.0)}}, "the bounds of 'mu' are"),
        (pitch_rate(), "one", {"band": 5.0}, "the band is 5.0"),
        (pitch_rate(), "one", {"band": (0.01, 0.02)}, "no Fourier coefficient lies in"),
        (pitch_rate(), "one", {"estimate": ("mu", "theta_bias")}, "say nothing about 'theta_bias'"),
        (pitch_rate(), "one", {"estimate": ("w_n", "xi", "mu", "q_0", "theta_0", "M_trim")}, "'theta_0' and 'M_trim'"),
        (pitch_rate(), "one", {"validation": LOG}, "a FlightLog is not a record"),
        (velocity(), "one", {}, "input 'theta' is not in the record"),
        (pitch_rate, "one", {}, r"pitch_rate: a function is not a structure.*pitch_rate\(\)"),
        (free_response(), "one", {"values": {"xi": -1.0, "w_n": 60.0, "hardening": 1e9}}, "not finite at the first"),
        (pitch_rate(), "twice", {}, "two records have one name"),
        (pitch_rate(), [], {}, "no record is given"),
        (pitch_rate(), UNMEASURED, {}, "none of the structure's outputs"),
        (pitch_rate(), LOG, {}, r"a FlightLog is not a record.*cut"),
        (pitch_rate(), [UNMEASURED, LOG], {}, "a FlightLog is not a record"),
        (pitch_rate(), None, {}, "a NoneType is not a record"),
        (pitch_rate(), {"M": UNMEASURED}, {}, "a dict is not a record"),
    ],
)
def test_wrong_arguments_are_refused_by_name(
    structure: Any, records: Any, options: dict[str, Any], message: str
) -> None:
    record = pitch_record(PAPER_PITCH_RATE, U, 0.06, np.random.default_rng(9))
    given = {"one": record, "twice": [record, record]}.get(records, records) if isinstance(records, str) else records
    with pytest.raises(IdentificationError, match=message):
        fit(structure, given, **options)
