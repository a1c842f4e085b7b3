"""What the diagram page simulates has the bits of the native build, also where it only set parameters anew."""

import base64
import json
import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.patience import PATIENCE_S
from twodof.blocks import Diagram
from twodof.blocks.schema.json_form import block_shape, from_json, to_json
from twodof.flight.gains import DEFAULT
from twodof.flight.starters import starter
from twodof.rig.parameters import lab
from twodof.sim.closed_loop import ClosedLoop
from twodof.sim.initial_state import InitialState
from twodof.sim.portable_loop import portable_loop

pytestmark = pytest.mark.slow

WEB = Path(__file__).resolve().parents[2] / "web"
VITEST = WEB / "node_modules" / "vitest" / "vitest.mjs"
STEPS, STEP_AT, HOVER = 400, 50, 0.4
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


def native(diagram: Diagram, template: str, logged: list[str]) -> dict[str, Any]:
    """The signals of a step at STEP_AT, flown by the native build; each (STEPS,) float64 in base 64."""
    plan = PLANS[template]
    loop = ClosedLoop(DEFAULT, lab(), controllers=[diagram], log=tuple(logged))
    loop.configure({"noise": 0.0, "rings": plan["rings"]})  # after the estimator has settled, as the page does
    loop.start(InitialState(hover=True))
    target = np.where(np.arange(STEPS) < STEP_AT, 0.0, plan["size"])
    out = loop.fly(STEPS, {"mode": plan["mode"], "thrust": HOVER, plan["setpoint"]: target})
    kept = {name: np.asarray(values, np.float64) for name, values in out.items() if np.ndim(values) == 1}
    return {name: base64.b64encode(values.tobytes()).decode() for name, values in kept.items()}


def shapes_of(diagram: Diagram) -> list[tuple[str, dict[str, Any]]]:
    """The keys under which the page knows library blocks (their JSON), and what the server answers."""
    found = []
    for part in json.loads(to_json(diagram))["diagram"]["parts"]:
        item = diagram.parts[part["name"]].item
        if part["block"]["type"] not in ("custom", "state_machine"):
            assert not isinstance(item, Diagram)
            found.append((part["name"], block_shape(item).to_json()))
    return found


def written_blocks(text: str) -> dict[str, Any]:
    """The JSON of each block by its part's name."""
    return {part["name"]: part["block"] for part in json.loads(text)["diagram"]["parts"]}


@pytest.mark.skipif(not VITEST.is_file(), reason="the page's packages are not installed: run make web")
def test_the_page_flies_the_bits_of_the_native_build(tmp_path: Path) -> None:
    given = []
    for name, changes in CASES.items():
        text = to_json(starter(name))
        texts = [text]
        for before, after in changes:
            assert before in text, f"{name} has changed: {before} is not in it"
            texts.append(text.replace(before, after, 1))
        loop = portable_loop(from_json(text))
        logged = [f"{loop.prefix}{path}" for path in loop.signals]
        flights, shapes = [], []
        for one in texts:
            diagram = from_json(one)
            assert to_json(diagram) == one
            flights.append({"text": one, "signals": native(diagram, loop.template, logged)})
            blocks = written_blocks(one)
            shapes += [[json.dumps(blocks[part]), answer] for part, answer in shapes_of(diagram)]
        assert len({json.dumps(flight["signals"]) for flight in flights}) == len(flights), "a change changes nothing"
        given.append({"loop": loop.to_json(), "shapes": shapes, "flights": flights, "steps": STEPS})
    file = tmp_path / "loops.json"
    file.write_text(json.dumps(given), encoding="utf-8")
    done = subprocess.run(
        ["node", str(VITEST), "run", "tests/diagram/flown_as_native.test.ts"],
        cwd=WEB,
        env=os.environ | {"VITE_TWODOF_LOOPS": str(file), "NO_COLOR": "1"},
        capture_output=True,
        text=True,
        timeout=2 * PATIENCE_S,
    )
    assert done.returncode == 0, (done.stdout + done.stderr)[-6000:]
    assert f"Tests  {len(CASES)} passed" in done.stdout, done.stdout
