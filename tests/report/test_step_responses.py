"""Step responses of flights: their figures against closed forms, the published ones of the real drone, and the plot."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from twodof.cli.app import run
from twodof.errors import LogError
from twodof.flightlog.contents import log_summary
from twodof.flightlog.files import read_log, write_log
from twodof.flightlog.log import Channel, FlightLog
from twodof.flightlog.steps import SAFETY
from twodof.report.plots.comparison_view import Align, comparison_view, flight_names, flight_steps, step_rows
from twodof.report.step_responses import folded_steps, most_stepped, step_responses
from twodof.signals import ATTITUDE, PERIOD

pytestmark = pytest.mark.slow

XI, OMEGA = 0.5, 12.0


def second_order(t: np.ndarray) -> np.ndarray:
    """The unit step response of w^2 / (s^2 + 2 xi w s + w^2) from t = 0."""
    damped = OMEGA * math.sqrt(1.0 - XI**2)
    ring = np.cos(damped * t) + XI / math.sqrt(1.0 - XI**2) * np.sin(damped * t)
    return np.where(t > 0.0, 1.0 - np.exp(-XI * OMEGA * np.maximum(t, 0.0)) * ring, 0.0)


def flight(start: float, size: float = 0.2) -> FlightLog:
    """Two steps of the pitch set-point, up at `start` + 1 s and down 2 s later, answered by the textbook's response."""
    time = start + PERIOD * np.arange(round(5.0 / PERIOD))
    up, down = start + 1.0, start + 3.0
    wanted = np.where((time >= up - 1e-9) & (time < down - 1e-9), size, 0.0)
    pitch = size * (second_order(time - up) - second_order(time - down))
    # M answers in the step of the set-point, and is stamped before it.
    moment = np.where(np.diff(wanted, prepend=0.0) != 0.0, 0.3, 0.01)
    return FlightLog(
        {
            "theta0": Channel(time, wanted, "rad"),
            "theta": Channel(time, pitch, "rad"),
            "M": Channel(time - 1e-5, moment, "-"),
            "mode": Channel(time, np.full(time.size, float(ATTITUDE)), ""),
        }
    )


def test_the_figures_are_those_of_the_textbook() -> None:
    up, down = step_responses(flight(10.0))
    assert [(one.loop, one.before, one.after) for one in (up, down)] == [("attitude", 0.0, 0.2), ("attitude", 0.2, 0.0)]
    overshoot = math.exp(-math.pi * XI / math.sqrt(1.0 - XI**2))
    peak_time = math.pi / (OMEGA * math.sqrt(1.0 - XI**2))
    for one in (up, down):
        # Sampled: the peak lies up to half a period beside a sample, which costs (w T / 2)^2 / 2 of it.
        assert one.figures.overshoot == pytest.approx(overshoot, rel=0.001)
        assert one.figures.peak_time == pytest.approx(peak_time, abs=0.5 * PERIOD)
        # Of xi = .5: normalised rise from 10 to 90 % is 1.64 (Ogata, Modern Control Engineering, chapter 5).
        assert one.figures.rise_time * OMEGA == pytest.approx(1.64, abs=0.01)
        assert one.peak_moment == 0.3


def test_step_of_an_open_loop_does_not_count() -> None:
    log = flight(0.0)
    free = FlightLog({**log.channels, "mode": Channel(log["mode"].time, np.zeros(len(log["mode"])), "")})
    assert step_responses(free) == ()
    assert most_stepped(step_responses(free)) == ()
    with pytest.raises(LogError, match="no set-point steps in this flight"):
        comparison_view({"one": log, "other": free})


def test_steps_fold_by_the_parameters_that_they_flew() -> None:
    log = flight(10.0)
    (whole,) = folded_steps(log, step_responses(log))
    assert (whole.loop, whole.after_s, whole.shares.shape[0]) == ("attitude", None, 2)
    np.testing.assert_allclose(whole.shares, [second_order(whole.time)] * 2, atol=0.06)
    rise = [one.figures.rise_time for one in whole.steps]
    expected = (2, np.mean(rise), np.std(rise, ddof=1), min(rise), max(rise))
    assert whole.statistics()["rise [s]"] == pytest.approx(expected)
    changed = FlightLog(log.channels, {"changes": [[12.0, "ATT_KP", 8.0]]})
    before, after = folded_steps(changed, step_responses(changed))
    assert (before.after_s, after.after_s, len(before.steps), len(after.steps)) == (None, 12.0, 1, 1)


def with_safety(log: FlightLog, start: float, end: float) -> FlightLog:
    """The log of a flight in which the failsafe acts from `start` to `end` [s]."""
    time = log["mode"].time
    acts = np.where((time >= start - 1e-9) & (time < end - 1e-9), 1.0, 0.0)
    rows = np.column_stack([acts, acts, acts])
    return FlightLog({**log.channels, "safety": Channel(time, rows, "", SAFETY, "safety")})


def test_what_the_failsafe_flies_is_no_step() -> None:
    log = flight(10.0)
    up, _ = step_responses(log)
    (cut,) = step_responses(with_safety(log, 13.0, 13.5))  # it levels: the set-point's way down is not the user's
    assert (cut.time, cut.end, cut.figures.rise_time) == (up.time, 13.0, up.figures.rise_time)
    (back,) = step_responses(with_safety(log, 12.0, 13.0))  # the set-point returns when it has done, as a step
    assert (back.after, back.end) == (0.2, 12.0)
    assert step_responses(with_safety(log, 10.9, 13.1)) == ()


def test_settling_is_of_the_mean_response() -> None:
    calm, gust = flight(10.0), 0.1 * 0.2
    time = calm["theta"].time
    # Up late after the first step, as far down late after the second one, which goes down: the mean does not move.
    push = np.where((time % 2.0 > 0.5) & (time % 2.0 < 0.7), gust, 0.0) * np.where(time < 12.0, 0.0, 1.0)
    blown = Channel(time, calm["theta"].value + push, "rad")
    log = FlightLog({**calm.channels, "theta": blown})
    expected, (up, down) = step_responses(calm)[0].figures.settling_time, step_responses(log)
    assert up.figures.settling_time == down.figures.settling_time == pytest.approx(expected, abs=PERIOD)
    assert up.averaged == down.averaged == 2
    tuned = FlightLog(log.channels, {"changes": [[12.0, "ATT_KP", 9.0]]})
    assert [one.averaged for one in step_responses(tuned)] == [1, 1]
    assert step_responses(tuned)[0].figures.settling_time > 1.0 > expected, "each alone is moved by the gust"


def test_the_real_drone_answers_as_published(flight_data: Path) -> None:
    """Default gains: rise .084 to .096 s, overshoot 3 to 6.5 %; the student's: rise .17 to .46 s, 4 to 10 %."""
    default, student = (
        [
            one.figures
            for one in most_stepped(step_responses(read_log(flight_data / f"attitude-steps-10deg-{name}.mat")))
        ]
        for name in ("default", "student")
    )
    assert len(default) == len(student) == 4
    assert all(0.0835 <= one.rise_time <= 0.097 and 0.03 <= one.overshoot <= 0.065 for one in default)
    assert all(0.165 <= one.rise_time <= 0.465 and 0.04 <= one.overshoot <= 0.10 for one in student)


def test_flights_are_aligned_at_their_first_steps() -> None:
    logs = {"mine": flight(10.0), "stock": flight(123.0, size=0.1)}
    view = comparison_view(logs)
    pitch, moment = view.views
    assert [curve.label for curve in pitch.curves] == ["set-point", "mine", "stock"]
    assert [curve.label for curve in moment.curves] == ["mine", "stock"]
    assert view.span == (-0.5, 5.0)
    mine, stock = pitch.curves[1:]
    np.testing.assert_allclose(mine.time, stock.time, atol=1e-9)
    np.testing.assert_allclose(mine.value, 2.0 * stock.value, atol=1e-9)
    assert len(view.notes) == 2
    assert len(rows := step_rows(flight_steps(logs))) == 4
    assert all(row[5].endswith("mean of 2") for row in rows)
    assert comparison_view(logs, Align.start).span == pytest.approx((0.0, 5.0), abs=2.0 * PERIOD)


def test_recorded_flights_are_named_by_their_gains() -> None:
    def recorded(**tuned: float) -> FlightLog:
        return FlightLog(flight(10.0).channels, {"drone": {"controller": "stock", "parameters": tuned}})

    logs = {"one": recorded(), "other": recorded(ATT_KP=5.0)}  # what is not told has its default
    assert flight_names(logs) == {"one": "ATT_KP 11", "other": "ATT_KP 5"}
    assert [log_summary(log)["tuned"] for log in logs.values()] == [[], [["ATT_KP", 5.0]]]


def test_flights_of_two_drones_are_named_by_them() -> None:
    logs = {str(k): FlightLog(flight(10.0).channels, {"drone": {"system": k, "controller": "stock"}}) for k in (1, 2)}
    assert flight_names(logs) == {"1": "drone 1", "2": "drone 2"}


@pytest.mark.parametrize(
    ("names", "window", "said"),
    [
        (["one"], None, "1 flights"),
        ([str(k) for k in range(7)], None, "7 flights"),
        (["one", "two"], (2.0, 1.0), "is empty"),
        (["one", "two"], (700.0, 701.0), "nothing was logged"),
    ],
)
def test_what_cannot_be_compared_is_refused(names: list[str], window: tuple[float, float] | None, said: str) -> None:
    with pytest.raises(LogError, match=said):
        comparison_view(dict.fromkeys(names, flight(0.0)), window=window)


def test_the_command_draws_and_tells_every_step(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [tmp_path / "mine.mat", tmp_path / "stock.mat"]
    for file, start in zip(files, (10.0, 20.0), strict=True):
        write_log(flight(start), file)
    assert run(["log", "plot", *map(str, files), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["file"] == str(tmp_path / "mine-compared.png")
    assert (tmp_path / "mine-compared.png").stat().st_size > 10_000
    assert [step["time"] for step in said["steps"]["stock"]] == pytest.approx([21.0, 23.0])
    assert run(["log", "plot", *map(str, files), "--force"]) == 0
    table = capsys.readouterr().out
    assert table.count("0 to 11.5 deg") == table.count("11.5 to 0 deg") == 2
    for wrong in ([str(files[0])], ["--topics", "theta"]):
        assert run(["log", "plot", *map(str, files), *wrong, "--force"]) == 2
