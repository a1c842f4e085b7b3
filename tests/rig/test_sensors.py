"""Sensors: rates, age, quantisation, and the noise of the logs or none."""

from typing import Any

import numpy as np
import pytest

from twodof.blocks import Diagram
from twodof.compile import CompiledMachine, CompiledProgram, build
from twodof.rig.dynamics import Turbulence
from twodof.rig.sensors import Imu, NoiseSource, RangeSensor

TS = 0.004
LOADS = ("load", "load_fore", "load_aft")


def sensors() -> Diagram:
    """The sensors on signals from outside, at 250 Hz."""
    d = Diagram("sensors", "sensors alone")
    for name, unit in (("theta", "rad"), ("q", "rad/s"), ("v", "m/s"), ("x", "m"), *((name, "") for name in LOADS)):
        d.input(name, unit=unit)
    d.add("noise", NoiseSource())
    loads = {name: name for name in LOADS}
    d.add("imu", Imu(), theta="theta", q="q", v="v", **loads, n_x="noise.n0", n_z="noise.n1", n_q="noise.n2")
    d.add("range", RangeSensor(), x="x", n="noise.n3")
    d.add("gust", Turbulence(), load="load")
    for name in ("acc_x", "acc_z", "gyro_y"):
        d.output(name, f"imu.{name}")
    for name in ("dist", "dist_new", "dist_age"):
        d.output(name, f"range.{name}")
    d.output("gust", "gust.moment")
    return d


@pytest.fixture(scope="module")
def program() -> CompiledProgram:
    return build(sensors(), TS)


def machine(program: Any, noise: float, **parameters: Any) -> CompiledMachine:
    m = program.machine()
    m.set_many({"imu.noise": noise, "range.noise": noise, "gust.noise": noise, **parameters})
    m.reset()
    return m


def test_without_noise_the_imu_is_exact(program: CompiledProgram) -> None:
    t = np.arange(500) * TS
    theta = 0.3 * np.sin(3.0 * t)
    q = 0.9 * np.cos(3.0 * t)
    v = 0.2 * np.sin(5.0 * t)
    place = {"imu.imu_below": 0.02, "imu.imu_ahead": 0.03}
    out = machine(program, 0.0, **place).run(500, {"theta": theta, "q": q, "v": v, "load": 1.0})
    along, turning = np.diff(v) / TS, np.diff(q) / TS
    assert out["gyro_y"] == pytest.approx(q, abs=1e-15)
    # Specific force of the drone's axes: R(theta) (acceleration - gravity), and the IMU's own turn.
    s, c = np.sin(theta[1:]), np.cos(theta[1:])
    pulled = q[1:] ** 2
    assert out["acc_x"][1:] == pytest.approx(c * along + 9.81 * s + 0.02 * turning - 0.03 * pulled, abs=1e-12)
    assert out["acc_z"][1:] == pytest.approx(s * along - 9.81 * c - 0.02 * pulled - 0.03 * turning, abs=1e-12)


def test_the_range_has_its_own_clock(program: CompiledProgram) -> None:
    n = 250 * 1000
    new = machine(program, 0.0).run(n, {"x": 0.0})["dist_new"].astype(bool)
    assert abs(int(new.sum()) - 18350) <= 1
    gaps = np.diff(np.flatnonzero(new)) * TS
    assert set(gaps.round(6)) == {0.052, 0.056}  # 54.5 ms on a 4 ms grid


@pytest.mark.parametrize("age", [0.0, 0.0037, 0.032, 0.1])
def test_the_range_is_old_by_its_age(program: CompiledProgram, age: float) -> None:
    x = 0.1 + 0.25 * np.arange(600) * TS
    m = machine(program, 0.0, **{"range.tof_age": age, "range.tof_stamp": 0.005, "range.x_start": 0.1})
    out = m.run(600, {"x": x})
    new = np.flatnonzero(out["dist_new"])[3:]
    assert out["dist"][new] == pytest.approx(x[new] - 0.25 * age + 0.5, abs=1e-12)
    assert np.all(out["dist_age"] == 0.005)
    held = np.flatnonzero(out["dist_new"])[4]
    assert np.all(out["dist"][held : held + 13] == out["dist"][held])


def test_readings_are_quantised(program: CompiledProgram) -> None:
    out = machine(program, 1.0).run(2000, {"theta": 0.1, "x": 0.05, "load": 1.0})
    for name, step in (("acc_x", 0.0024), ("acc_z", 0.0024), ("gyro_y", 0.00107), ("dist", 0.001)):
        counts = out[name][20:] / step
        assert np.abs(counts - counts.round()).max() < 1e-6
        assert np.unique(out[name][20:]).size > 5


IDLE = {"acc_x": 0.17, "acc_z": 0.07, "gyro_y": 0.0014}
HOVER = {"acc_x": 1.0, "acc_z": 2.5, "gyro_y": 0.01}


@pytest.mark.parametrize(("load", "sigma"), [(0.0, IDLE), (1.0, {k: np.hypot(IDLE[k], HOVER[k]) for k in IDLE})])
def test_noise_is_that_of_the_thrust(program: CompiledProgram, load: float, sigma: dict[str, float]) -> None:
    out = machine(program, 1.0).run(50_000, {"load": load})
    for name, expected in sigma.items():
        # 50,000 samples of band-limited noise: the standard deviation is good to a per cent.
        assert out[name][100:].std() == pytest.approx(expected, rel=0.03)
    new = np.flatnonzero(out["dist_new"])
    assert out["dist"][new].std() == pytest.approx(0.004, rel=0.05)


def test_vibration_is_a_band_and_has_no_constant_part(program: CompiledProgram) -> None:
    y = machine(program, 1.0, **{"imu.acc_x_idle": 0.0}).run(65_536, {"load": 1.0})["acc_x"][4096:]
    assert np.corrcoef(y[1:], y[:-1])[0, 1] == pytest.approx(0.46, abs=0.12)  # the logs: .57 to .7
    spectrum = np.abs(np.fft.rfft(y * np.hanning(y.size))) ** 2
    f = np.fft.rfftfreq(y.size, TS)
    assert f[np.argmax(np.convolve(spectrum, np.ones(400), "same"))] == pytest.approx(38.0, abs=4.0)
    low, peak = spectrum[(f > 0.1) & (f < 1.0)].mean(), spectrum[(f > 36) & (f < 40)].mean()
    assert low < 1e-2 * peak  # a velocity integrated from it must not walk away


def test_a_rotor_is_a_line_where_the_samples_fold_its_speed(program: CompiledProgram) -> None:
    line = {"imu.acc_x_line": 0.5, "imu.rotor_hz": 280.0, "imu.acc_x_idle": 0.0, "imu.acc_x_hover": 0.0}
    n, f = 25_000, np.fft.rfftfreq(25_000, TS)
    # The speed goes with the root of the thrust: 280 and 266 Hz, seen by 250 Hz as 30 and 16 Hz.
    pairs = {"load_fore": 1.0, "load_aft": (266.0 / 280.0) ** 2}
    y = machine(program, 1.0, **line).run(n, {"load": 1.0, **pairs})["acc_x"]
    spectrum = np.abs(np.fft.rfft(y * np.hanning(n)))
    fore, aft = f > 23.0, f < 23.0
    assert f[fore][np.argmax(spectrum[fore])] == pytest.approx(30.0, abs=f[1])
    assert f[aft][np.argmax(spectrum[aft])] == pytest.approx(16.0, abs=f[1])
    # A sample is the mean of 4 ms, which leaves the slower rotor less.
    passed = np.sinc(266.0 * TS) / np.sinc(280.0 * TS)
    assert y.std() == pytest.approx(0.5 * np.sqrt(0.5 * (1.0 + (passed * pairs["load_aft"]) ** 2)), rel=0.01)
    # Nothing turns at rest, and locked the drone shakes more.
    assert np.all(machine(program, 1.0, **line).run(1000, {"load": 0.0})["acc_x"] == 0.0)
    locked = machine(program, 1.0, **line, **{"imu.rings": True, "imu.ring_shake": 2.0})
    assert locked.run(n, {"load": 1.0, **pairs})["acc_x"].std() == pytest.approx(2.0 * y.std(), rel=0.01)


def test_the_gust_has_its_size_and_its_memory(program: CompiledProgram) -> None:
    m = machine(program, 1.0, **{"gust.gust": 2e-3, "gust.gust_time": 0.1})
    y = m.run(200_000, {"load": 1.0})["gust"][500:]
    # 800 s hold some 4000 correlation times: 3 % for the standard deviation, and the memory within as much.
    assert y.std() == pytest.approx(2e-3, rel=0.06)
    lag = round(0.1 / TS)
    assert np.corrcoef(y[lag:], y[:-lag])[0, 1] == pytest.approx(np.exp(-1.0), abs=0.06)
    assert np.all(machine(program, 1.0).run(100, {"load": 0.0})["gust"] == 0.0)
