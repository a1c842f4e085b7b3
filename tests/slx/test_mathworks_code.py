"""A controller of a public repository beside the C that MathWorks' coder made of it.

TWODOF_SLX_REPOS names a folder of checkouts, OWNER+NAME, of which nothing is kept here:
JakubRichardson/IGDP-DroneProj at f54bdc9. The model and its C must have the same version.
"""

import os
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

from bench.computing.simulink_controller import GENERATED, MODEL, STATES, flight_controller
from twodof.compile import build
from twodof.slx.model import read_model

REPOS = os.environ.get("TWODOF_SLX_REPOS", "")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not REPOS, reason="let TWODOF_SLX_REPOS name the folder of the public repositories' checkouts"),
]
STEPS = 2000
KEPT = ("Attitude.Discrete_Time_Integrator.x", "Attitude.Delay.buffer", "S_R_Flip_Flop.Q.x")
DRIVER = """
#include <stdio.h>
#include "flightController.h"
#include "flightController_private.h"
int main(void) {
  CommandBus c = {0};
  statesEstim_t s;
  float in[20], out[12];
  flightController_Init();
  while (fread(in, sizeof in, 1, stdin) == 1) {
    c.controlModePosVSOrient = in[0] != 0.0F;
    c.takeoff_flag = in[1] != 0.0F;
    for (int i = 0; i < 3; i++) { c.pos_ref[i] = in[2 + i]; c.orient_ref[i] = in[5 + i]; }
    for (int i = 0; i < 12; i++) ((float *) &s)[i] = in[8 + i];
    flightController_run(&c, &s, out, out + 4);
    fwrite(out, sizeof out, 1, stdout);
    fwrite(flightController_DW.DiscreteTimeIntegrator_DSTATE, sizeof(float), 2, stdout);
    fwrite(flightController_DW.Delay_DSTATE, sizeof(float), 2, stdout);
    float taken_off = flightController_DW.Memory_PreviousInput;
    fwrite(&taken_off, sizeof(float), 1, stdout);
  }
  return 0;
}
"""


def sines(seed: int) -> np.ndarray:
    """Seeded sums of sines as the 20 inputs, the first two as flags."""
    draw = np.random.default_rng(seed)
    t = np.arange(STEPS)[:, None] * 0.005
    size = np.r_[1.0, 1.0, 1.0, 1.0, 1.0, [0.3] * 3, 1.0, 1.0, 1.0, [0.5] * 3, 0.5, 0.5, 0.5, 2.0, 2.0, 2.0]
    found = sum(size * np.sin(t * draw.uniform(0.5, 20.0, 20) + draw.uniform(0.0, 6.0, 20)) for _ in range(3))
    found[:, :2] = found[:, :2] > 0.5
    return found.astype(np.float32)


def by_mathworks(folder: Path, inputs: np.ndarray, made: Path) -> np.ndarray:
    """Return what the C gives: motors, pose, and its five states after each step."""
    (made / "driver.c").write_text(DRIVER, encoding="utf-8")
    parts = [f"-I{folder}", f"-I{folder.parent / '_sharedutils'}", str(folder / "flightController.c")]
    command = ["gcc", "-O1", "-ffp-contract=off", "-w", *parts, str(made / "driver.c"), "-o", str(made / "run"), "-lm"]
    subprocess.run(command, check=True)
    done = subprocess.run([str(made / "run")], input=inputs.tobytes(), stdout=subprocess.PIPE, check=True)
    return np.frombuffer(done.stdout, np.float32).reshape(STEPS, 17)


def by_import(repository: Path, inputs: np.ndarray) -> np.ndarray:
    found = flight_controller(repository)
    assert found.diagram is not None, found.refused
    assert found.dt == 0.005
    machine = build(found.diagram, dt=found.dt, precision="float32").machine()
    rows = []
    for row in inputs:
        command = {"controlModePosVSOrient": bool(row[0]), "takeoff_flag": bool(row[1]), "pos_ref": row[2:5],
                   "orient_ref": row[5:8], "live_time_ticks": 0}  # fmt: skip
        estimate = dict(zip(STATES, row[8:].tolist(), strict=True))
        got = machine.step({"ReferenceValueServerBus": command, "states_estim": estimate})
        kept = [np.ravel(machine.state(f"Flight_Controller.{path}")) for path in KEPT]
        rows.append(np.concatenate([np.ravel(got["motors_refout"]), np.ravel(got["pose_refout"]), *kept]))
    return np.array(rows, np.float32)


def both(tmp_path: Path, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what the C and the import give. The model and the C must have one version."""
    repository = Path(REPOS) / "JakubRichardson+IGDP-DroneProj"
    folder = repository / GENERATED[0]
    said = re.search(r"Model version\s*: ([\d.]+)", (folder / "flightController.c").read_text(encoding="utf-8"))
    assert said is not None
    assert read_model(repository / MODEL).version == said[1]
    return by_mathworks(folder, inputs, tmp_path), by_import(repository, inputs)


@pytest.mark.parametrize("positions", [False, True])
def test_a_flight_controller_has_the_bits_of_mathworks_c(tmp_path: Path, positions: bool) -> None:
    """2,000 steps of outputs and states: set-points of the attitude, and of positions where the yaw is 0."""
    inputs = sines(11)
    inputs[:, 0] = positions
    if positions:
        inputs[:, 8 + STATES.index("yaw")] = 0.0  # no elementary function but sin(0) and cos(0)
    wanted, found = both(tmp_path, inputs)
    assert np.array_equal(found[:, :12], wanted[:, :12])
    assert np.array_equal(found[:, 12:], wanted[:, 12:])
    assert np.ptp(wanted[:, :4], axis=0).min() > 100.0


def test_sines_of_the_yaw_stay_within_two_units_in_the_last_place(tmp_path: Path) -> None:
    inputs = sines(12)
    wanted, found = both(tmp_path, inputs)
    # Of a signal's largest value: a sum of nearly opposite terms is smaller than its own rounding.
    unit = np.spacing(np.abs(wanted).max(axis=0))
    assert (np.abs(found - wanted).max(axis=0) <= 2.0 * unit).all()
    assert 0.2 < inputs[:, 0].mean() < 0.8
