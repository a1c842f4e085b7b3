"""The page's own code gives what the library gives: the JSON of diagrams, flown bits, figures of steps.

Python computes what is expected and writes it to a file; a test of web/tests reads the file and compares.
"""

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
from tests.web.conftest import PROJECT
from tests.web.written_diagrams import texts
from twodof.blocks import Diagram
from twodof.blocks.schema.json_form import block_shape, from_json, to_json
from twodof.compile.builder import build
from twodof.flight.gains import DEFAULT
from twodof.flight.starters import starter
from twodof.flightlog.log import Channel, FlightLog
from twodof.flightlog.steps import SAFETY
from twodof.report.step_responses import FOLLOWING, step_responses
from twodof.rig.parameters import lab
from twodof.rig.rig import BASE_DT
from twodof.signals import ATTITUDE, MODES, PERIOD, POSITION
from twodof.sim.closed_loop import ARMING, ClosedLoop, InitialState, closed_loop
from twodof.sim.portable_loop import play_program, portable_loop

VITEST = PROJECT / "web" / "node_modules" / "vitest" / "vitest.mjs"
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not VITEST.is_file(), reason="the page's packages are not installed: run make web"),
]

STEPS, STEP_AT, HOVER = 400, 50, 0.4
PLAY_STEPS = 2000
PLANS: dict[str, dict[str, Any]] = {
    "attitude_control": {"mode": "attitude", "setpoint": "theta0", "size": np.radians(10.0), "rings": True},
    "position_control": {"mode": "position", "setpoint": "x0", "size": 0.1, "rings": False},
    "motor_control": {"mode": "attitude", "setpoint": "theta0", "size": np.radians(10.0), "rings": True},
}
CASES = {
    "pid-attitude": (('"high": 20.0, "kind"', '"high": 0.5, "kind"'), ('"value": 11.0', '"value": 7.5')),
    "pid-position": (('"value": 0.4', '"value": 0.41'),),
    "direct-motor": (),
}
"""Starter diagrams, and replacements of values in their text: each gives another diagram of the same structure."""
WANTED = {"rate": "setpoint.q", "attitude": "setpoint.theta", "velocity": "setpoint.v", "position": "setpoint.x"}
CHANNELS = {"setpoint.q": "q0", "setpoint.theta": "theta0", "setpoint.v": "v0", "setpoint.x": "x0"}


def passes(file: str, variable: str, expected: Any, count: int, folder: Path) -> None:
    """Run a file of web/tests; `variable` names the file with what is expected. All `count` tests must pass."""
    path = folder / "expected.json"
    path.write_text(json.dumps(expected), encoding="utf-8")
    done = subprocess.run(
        ["node", str(VITEST), "run", f"tests/{file}"],
        cwd=PROJECT / "web",
        env=os.environ | {variable: str(path), "NO_COLOR": "1"},
        capture_output=True,
        text=True,
        timeout=2 * PATIENCE_S,
    )
    assert done.returncode == 0, (done.stdout + done.stderr)[-6000:]
    assert f"Tests  {count} passed" in done.stdout, done.stdout


def test_the_page_writes_the_json_that_python_writes(tmp_path: Path) -> None:
    passes("diagram/written_by_python.test.ts", "VITE_TWODOF_TEXTS", texts(), len(texts()), tmp_path)


def _base64(values: Any) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f8").tobytes()).decode()


def native(diagram: Diagram, template: str, logged: list[str]) -> dict[str, Any]:
    """The signals of a step at STEP_AT, flown by the native build; each (STEPS,) float64 in base 64."""
    plan = PLANS[template]
    loop = ClosedLoop(DEFAULT, lab(), controllers=[diagram], log=tuple(logged))
    loop.configure({"noise": 0.0, "rings": plan["rings"]})  # after the estimator has settled, as the page does
    loop.start(InitialState(hover=True))
    target = np.where(np.arange(STEPS) < STEP_AT, 0.0, plan["size"])
    out = loop.fly(STEPS, {"mode": plan["mode"], "thrust": HOVER, plan["setpoint"]: target})
    return {name: _base64(values) for name, values in out.items() if np.ndim(values) == 1}


def shapes_of(diagram: Diagram) -> list[tuple[str, dict[str, Any]]]:
    """The keys under which the page knows library blocks (their JSON), and what the server answers."""
    found = []
    for part in json.loads(to_json(diagram))["diagram"]["parts"]:
        item = diagram.parts[part["name"]].item
        if part["block"]["type"] not in ("custom", "state_machine"):
            assert not isinstance(item, Diagram)
            found.append((part["name"], block_shape(item)))
    return found


def written_blocks(text: str) -> dict[str, Any]:
    """The JSON of each block by its part's name."""
    return {part["name"]: part["block"] for part in json.loads(text)["diagram"]["parts"]}


@pytest.mark.long
def test_the_diagram_page_flies_the_native_bits(tmp_path: Path) -> None:
    given = []
    for name, changes in CASES.items():
        text = to_json(starter(name))
        texts = [text]
        for before, after in changes:
            assert before in text, f"{name} has changed: {before} is not in it"
            texts.append(text.replace(before, after, 1))
        loop = portable_loop(from_json(text))
        logged = [f"{loop['prefix']}{path}" for path in loop["signals"]]
        flights, shapes = [], []
        for one in texts:
            diagram = from_json(one)
            assert to_json(diagram) == one
            flights.append({"text": one, "signals": native(diagram, loop["template"], logged)})
            blocks = written_blocks(one)
            shapes += [[json.dumps(blocks[part]), answer] for part, answer in shapes_of(diagram)]
        assert len({json.dumps(flight["signals"]) for flight in flights}) == len(flights), "a change changes nothing"
        given.append({"loop": loop, "shapes": shapes, "flights": flights, "steps": STEPS})
    passes("diagram/flown_as_native.test.ts", "VITE_TWODOF_LOOPS", given, len(CASES), tmp_path)


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


@pytest.mark.long
def test_play_flies_the_native_bits(tmp_path: Path) -> None:
    toolchains.need("cc")
    module, data = play_program()
    ticks = PLAY_STEPS * data["ticks"]
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

    flight = {
        "table": data["table"],
        "module": base64.b64encode(module).decode(),
        "parameters": parameters,
        "states": states,
        "ticks": ticks,
        "inputs": {name: _base64(values) for name, values in inputs.items()},
        "native": {name: _base64(values) for name, values in native.items()},
    }
    passes("program.test.ts", "VITE_TWODOF_FLIGHT", flight, 3, tmp_path)


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
    mode[:600] = mode[2600:2800] = mode[-1] = 0.0
    action = np.zeros(time.size)
    action[1500:1700] = 1.0  # the failsafe levels it meanwhile
    moment = np.clip(0.5 * (wanted - response), -0.3, 0.3)
    # The page keeps float32, as the drone sends it.
    columns = {
        **{name: np.zeros(time.size) for name in CHANNELS},
        **{f"estimate.{name}": np.zeros(time.size) for name in ("q", "theta", "v", "x")},
        WANTED[loop]: wanted,
        f"estimate.{FOLLOWING[loop]}": response,
        "state.mode": mode,
        "safety.action": action,
        "command.M": moment,
    }
    columns = {name: np.float64(np.float32(one)) for name, one in columns.items()}
    # x and v come less often than the rows: at 100 Hz, so two of five.
    sparse = np.isin(np.arange(time.size) % 5, (0, 2))
    rare = {"estimate.x", "estimate.v"}
    changes = [float(time[1000]), float(time[2200])]
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
            if name in names
        }
        | {"safety": Channel(time, np.column_stack([action] * 3), "", SAFETY, "safety")},
        provenance={"changes": [[at, "RATE_KP", 0.1] for at in changes]},
    )
    return {
        "name": f"{loop} {seed}",
        "time": time.tolist(),
        "changes": changes,
        "columns": {
            name: [
                value if name not in rare or there else None for value, there in zip(one.tolist(), sparse, strict=True)
            ]
            for name, one in columns.items()
        },
        "found": [one.to_json() for one in step_responses(log)],
    }


@pytest.mark.long
def test_step_figures_equal_those_of_python(tmp_path: Path) -> None:
    cases = [_flight(seed, loop) for seed in range(3) for loop in FOLLOWING]
    assert sum(len(one["found"]) for one in cases) > 20  # there is something to compare
    passes("step_watch.test.ts", "VITE_TWODOF_STEPS", cases, 3 * len(cases), tmp_path)
