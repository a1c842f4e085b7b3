"""The figures of steps that the page shows as they are flown: those that Python reads from the same log."""

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.patience import PATIENCE_S
from twodof.flightlog.log import Channel, FlightLog
from twodof.report.step_responses import FOLLOWING, step_responses
from twodof.signals import MODES, PERIOD

pytestmark = pytest.mark.slow

WEB = Path(__file__).resolve().parents[2] / "web"
VITEST = WEB / "node_modules" / "vitest" / "vitest.mjs"
WANTED = {"rate": "setpoint.q", "attitude": "setpoint.theta", "velocity": "setpoint.v", "position": "setpoint.x"}
CHANNELS = {"setpoint.q": "q0", "setpoint.theta": "theta0", "setpoint.v": "v0", "setpoint.x": "x0"}


def _flight(seed: int, loop: str) -> dict[str, Any]:
    """A flight with steps of one loop, some held too briefly, some answered before the loop is closed."""
    rng = np.random.default_rng(seed)
    time = 3.0 + PERIOD * np.arange(4000)
    wanted = np.zeros(time.size)
    at = 300
    while at < time.size:
        wanted[at:] = rng.choice([-0.2, 0.0, 0.1, 0.25])
        at += int(rng.choice([20, 40, 250, 700]))
    omega, xi = rng.uniform(4.0, 15.0), rng.uniform(0.2, 1.1)
    value, speed, response = 0.0, 0.0, np.empty(time.size)
    for k in range(time.size):
        speed += PERIOD * (omega**2 * (wanted[k] - value) - 2.0 * xi * omega * speed)
        value += PERIOD * speed
        response[k] = value
    response += rng.normal(0.0, 1e-3, time.size)
    mode = np.full(time.size, float(MODES.index(loop)))
    mode[:600] = mode[2600:2800] = 0.0
    moment = np.clip(0.5 * (wanted - response), -0.3, 0.3)
    # The page keeps float32, as the drone sends it.
    columns = {
        **{name: np.zeros(time.size) for name in CHANNELS},
        **{f"estimate.{name}": np.zeros(time.size) for name in ("q", "theta", "v", "x")},
        WANTED[loop]: wanted,
        f"estimate.{FOLLOWING[loop]}": response,
        "state.mode": mode,
        "command.M": moment,
    }
    columns = {name: np.float64(np.float32(one)) for name, one in columns.items()}
    # x and v come less often than the rows: at 100 Hz, so two of five.
    sparse = np.isin(np.arange(time.size) % 5, (0, 2))
    rare = {"estimate.x", "estimate.v"}
    names = {
        **CHANNELS,
        **{f"estimate.{one}": one for one in FOLLOWING.values()},
        "state.mode": "mode",
        "command.M": "M",
    }
    log = FlightLog(
        {
            names[name]: Channel(*((time[sparse], one[sparse]) if name in rare else (time, one)))
            for name, one in columns.items()
        }
    )
    return {
        "name": f"{loop} {seed}",
        "time": time.tolist(),
        "columns": {
            name: [
                value if name not in rare or there else None for value, there in zip(one.tolist(), sparse, strict=True)
            ]
            for name, one in columns.items()
        },
        "found": [one.to_json() for one in step_responses(log)],
    }


@pytest.mark.skipif(not VITEST.is_file(), reason="the page's packages are not installed: run make web")
def test_the_page_reads_the_figures_that_python_reads(tmp_path: Path) -> None:
    cases = [_flight(seed, loop) for seed in range(3) for loop in FOLLOWING]
    assert sum(len(one["found"]) for one in cases) > 20  # there is something to compare
    file = tmp_path / "steps.json"
    file.write_text(json.dumps(cases), encoding="utf-8")
    done = subprocess.run(
        ["node", str(VITEST), "run", "tests/step_watch.test.ts"],
        cwd=WEB,
        env=os.environ | {"VITE_TWODOF_STEPS": str(file), "NO_COLOR": "1"},
        capture_output=True,
        text=True,
        timeout=2 * PATIENCE_S,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"Tests  {3 * len(cases)} passed" in done.stdout, done.stdout
