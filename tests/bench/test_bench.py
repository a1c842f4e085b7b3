"""The benchmarks run, the loops that they time compute the same, and their check would see it if they did not."""

import json
from pathlib import Path

import numpy as np
import pytest

from bench.__main__ import BENCHMARKS, RESULTS, main, markdown
from bench.computing import closed_loop, greybox, start_up
from bench.computing.closed_loop import AGREEMENT, CompiledLoop, numbered
from bench.computing.hand_loop import HandLoop
from bench.computing.mujoco_loop import MujocoLoop
from bench.measure import Figure, timed
from twodof.errors import ParameterError
from twodof.identify import Record
from twodof.identify.record_simulator import RecordSimulator
from twodof.models import pitch_rate
from twodof.rig.parameters import lab

pytestmark = pytest.mark.slow


@pytest.mark.long
@pytest.mark.parametrize(("precision", "noise"), [("float64", 0.0), ("float32", 0.0), ("float64", 1.0)])
def test_the_hand_written_loop_computes_what_the_compiled_one_does(precision: str, noise: float) -> None:
    gap, where = closed_loop.difference(precision, noise)
    assert gap <= AGREEMENT[precision], where


def test_the_flight_of_the_comparison_reaches_the_stops_of_pitch_and_rail() -> None:
    loop = CompiledLoop("float64", noise=0.0)
    flown = [loop.run(round(1e3 * seconds), numbered(setpoints)) for seconds, setpoints in closed_loop.FLIGHT]
    theta, x = (np.abs(np.concatenate([part[name] for part in flown])) for name in ("true_theta", "true_x"))
    rig = lab()
    assert theta.max() >= 0.99 * rig["pitch_stop"]
    assert x.max() >= 0.99 * rig["rail_stop"]


@pytest.mark.parametrize(
    "path",
    [
        "rig.curve",
        "rig.coulomb_run",
        "rig.polarised_time",
        "rig.tof_age",
        "flight.cascade.rate.kd",
        "flight.estimator.filter.sigma_a",
    ],
)
def test_a_coefficient_wrong_in_its_sixth_digit_would_be_seen(path: str) -> None:
    ours = CompiledLoop("float64", noise=0.0)
    other = CompiledLoop("float64", noise=0.0)
    other.machine.set(path, ours.machine.get(path) * (1.0 + 1e-6))
    hand = HandLoop(other.machine, "float64")
    gap = 0.0
    for seconds, setpoints in closed_loop.FLIGHT:
        ticks, values = round(1e3 * seconds), numbered(setpoints)
        left, right = ours.run(ticks, values), hand.run(ticks, values)
        gap = max(gap, max(float(np.abs(left[name] - right[name]).max()) for name in ("true_theta", "true_x", "M")))
    assert gap > 10.0 * AGREEMENT["float64"]


def test_both_loops_hover_alike_with_noise() -> None:
    """Other random numbers, the same amount: the pitch rate wanders alike. 60 s are some 300 correlation times of q.
    So two standard deviations differ by less than 25 %, which is over four sigma."""
    ours = CompiledLoop("float64")
    hand = HandLoop(ours.machine, "float64")
    hover = numbered(closed_loop.HOVER)
    deviations = []
    for loop in (ours, hand):
        loop.run(10_000, hover)
        deviations.append({name: float(np.std(column)) for name, column in loop.run(60_000, hover).items()})
    for name in ("true_q", "gyro_y", "acc_x", "acc_z", "M"):
        assert deviations[0][name] == pytest.approx(deviations[1][name], rel=0.25), name


def test_a_parameter_that_only_one_loop_has_is_refused() -> None:
    ours = CompiledLoop("float64")
    ours.machine.parameters = ours.machine.parameters | {"rig.novelty": ours.machine.parameters["rig.curve"]}
    with pytest.raises(ParameterError, match="rig_novelty"):
        HandLoop(ours.machine, "float64")


def test_mujocos_cascade_draws_the_cart_to_its_set_point() -> None:
    loop = MujocoLoop(lab())
    loop.fly(6_000, 0.1)
    x, theta = loop.data.qpos
    # Coulomb friction on the rail stops it short of the set-point, by mm.
    assert x == pytest.approx(0.1, abs=0.01)
    assert abs(theta) < 0.05


def test_the_peer_of_the_fit_simulates_the_same_model() -> None:
    u = greybox.doublets(1500)
    values = np.array(list(greybox.TRUE.values()))
    record = Record.from_columns(greybox.DT * np.arange(1500), {"M": u, "q": u}, ["M"], ["q"])
    ours = RecordSimulator(pitch_rate(), record).run(dict(greybox.TRUE))["q"]
    # scipy's matrix exponential and ours differ by 1e-13, over 1500 steps of an amplitude of 5 rad/s.
    np.testing.assert_allclose(greybox.exact(u, values), ours, rtol=0.0, atol=1e-10)
    # The delay by interpolation smears each edge over the step before it, a twentieth of a step's q at most.
    np.testing.assert_allclose(greybox.sampled(u, values), ours, rtol=0.0, atol=2e-3)


def test_the_large_diagram_has_as_many_blocks_as_asked_for() -> None:
    assert len(start_up.large_diagram(900).parts) == 900


@pytest.mark.long
def test_a_benchmark_runs_and_writes_its_results(tmp_path: Path) -> None:
    assert main(["greybox", "--quick", "--out", str(tmp_path)]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["greybox.json", "results.md"]
    assert json.loads((tmp_path / "greybox.json").read_text())["figures"]


def test_the_page_of_results_says_what_the_files_beside_it_say() -> None:
    assert (RESULTS / "results.md").read_text(encoding="utf-8") == markdown(RESULTS)


@pytest.mark.soak
def test_all_benchmarks_run_and_write_their_results(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--quick", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    for name in BENCHMARKS:
        assert name in printed
        result = json.loads((tmp_path / f"{name}.json").read_text())
        assert result["processor"]
        assert result["compilers"]
        assert all(np.isfinite(figure["value"]) for figure in result["figures"])
    assert "| python-control, linear loop |" in (tmp_path / "results.md").read_text()


def test_a_missed_target_fails_only_where_it_is_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    slow = [Figure("speed", 1.0, "steps/s", target=2.0)]
    monkeypatch.setattr("bench.__main__.BENCHMARKS", {"slow": lambda quick: slow})
    assert main(["--out", str(tmp_path)]) == 0
    assert main(["--strict", "--out", str(tmp_path)]) == 1


def test_an_unknown_benchmark_is_refused() -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["nonsense"])


def test_timings_take_turns_and_leave_the_first_round_out() -> None:
    calls: list[str] = []
    first, second = timed([lambda: calls.append("a"), lambda: calls.append("b")], 3)
    assert calls == ["a", "b"] * 4
    assert len(first.seconds) == len(second.seconds) == 3
    assert first.best <= first.median
