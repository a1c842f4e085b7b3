"""The page Play flies what the native build flies: the closed loop in the browser's engine against it, bit for bit."""

from __future__ import annotations

import base64
import json
import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests import toolchains
from tests.patience import PATIENCE_S
from twodof.compile.builder import build
from twodof.rig.rig import BASE_DT
from twodof.signals import ATTITUDE, POSITION
from twodof.sim.closed_loop import ARMING, closed_loop
from twodof.sim.portable_loop import PlayProgram, play_program

pytestmark = pytest.mark.slow

WEB = Path(__file__).resolve().parents[2] / "web"
VITEST = WEB / "node_modules" / "vitest" / "vitest.mjs"
STEPS = 2000


@pytest.fixture(scope="module")
def play() -> PlayProgram:
    return play_program()


def _inputs(ticks: int, per_step: int) -> dict[str, np.ndarray]:
    """A flight with steps of pitch, a change to position, a set-point that is lost, and a disarming at the end."""
    step = np.arange(ticks) // per_step
    attitude = step < 1000
    columns = {
        "mode": np.where(attitude, ATTITUDE, POSITION),
        "thrust": np.where(step >= ARMING + 5, 0.4, 0.0),
        "theta0": np.where(attitude & (step // 100 % 2 == 1), 0.1, 0.0),
        "x0": np.where(step > 1200, 0.1, 0.0),
        "arm": (step >= ARMING) & (step < 1950),
        "setpoint_new": (step < 1500) | (step > 1700),
        "link_new": np.ones(ticks),
        "imu_new": np.ones(ticks),
    }
    return {name: np.asarray(values, dtype=np.float64) for name, values in columns.items()}


def _base64(values: Any) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f8").tobytes()).decode()


@pytest.mark.skipif(not VITEST.is_file(), reason="the page's packages are not installed: run make web")
def test_the_page_flies_the_bits_of_the_native_build(play: PlayProgram, tmp_path: Path) -> None:
    toolchains.need("cc")
    data = play.data
    ticks = STEPS * data["ticks"]
    inputs = _inputs(ticks, data["ticks"])
    parameters = {**data["rigs"]["lab"], **data["starts"]["rest"]["parameters"], "rig.noise": 1.0, "rig.seed": 7.0}
    states = data["starts"]["rest"]["states"]

    program = build(closed_loop(failsafe=True), BASE_DT)
    machine = program.machine()
    machine.set_many({**parameters, "rig.seed": 7})
    machine.reset()
    for path, value in states.items():
        machine.set_state(path, value)
    kinds = {entry["path"]: entry["type"] for entry in data["table"]["inputs"]}
    native = machine.run(ticks, {name: values.astype(kinds[name]) for name, values in inputs.items()})
    # There is something to compare: it flew, it was noisy, the failsafe acted.
    assert np.ptp(native["true_theta"]) > 0.1
    assert {0, 2, 3} <= set(np.unique(native["state"]))

    file = tmp_path / "flight.json"
    flight = {
        "table": data["table"],
        "module": base64.b64encode(play.module).decode(),
        "parameters": parameters,
        "states": states,
        "ticks": ticks,
        "inputs": {name: _base64(values) for name, values in inputs.items()},
        "native": {name: _base64(values) for name, values in native.items()},
    }
    file.write_text(json.dumps(flight), encoding="utf-8")
    done = subprocess.run(
        ["node", str(VITEST), "run", "tests/program.test.ts"],
        cwd=WEB,
        env=os.environ | {"VITE_TWODOF_FLIGHT": str(file), "NO_COLOR": "1"},
        capture_output=True,
        text=True,
        timeout=2 * PATIENCE_S,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Tests  3 passed" in done.stdout, done.stdout
