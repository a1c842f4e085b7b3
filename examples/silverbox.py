"""Fit the Silverbox, a benchmark with a cubic spring: its inputs are band-limited between the samples."""

import os
import sys
from pathlib import Path
from typing import Any

import numpy as np

from twodof.blocks import Block, Param, Port, State
from twodof.identify import Record, fit, simulate
from twodof.models import Structure

FILE = Path(os.environ.get("TWODOF_BENCHMARK_DATA", ".")) / "SNLS80mV.csv"
if not FILE.is_file():
    print("let TWODOF_BENCHMARK_DATA name the folder with SNLS80mV.csv, from nonlinearbenchmark.org, Silverbox, or")
    print("from examples/statespace/silverbox of github.com/forgi86/pytorch-ident")
    sys.exit()


class Silverbox(Block):
    """y'' = gain u + offset - (k + k_2 y + k_3 y^2) y - (d + more y^2 / (y^2 + from_y^2)) y', in volts and seconds."""

    # Damping that grew on with y^2 would explain the training data less well, and fail beyond their amplitude.
    inputs = (Port("u"),)
    outputs = (Port("y"),)
    params = (
        *(Param(name, guess) for name, guess in {"gain": 2e5, "k": 2e5, "k_2": 0.0, "k_3": 1e6}.items()),
        *(Param(name, guess) for name, guess in {"d": 50.0, "more": 1.0, "offset": 0, "y_0": 0.0, "v_0": 0.0}.items()),
        Param("from_y", 0.05, low=0.001, high=1.0, unit="V", text="where half of the further damping has set in"),
    )
    states = (State("y", "y_0", continuous=True), State("v", "v_0", continuous=True))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        """The voltage is the first state."""
        return x.y

    def derivative(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        """Newton's law."""
        spring = (p.k + p.k_2 * x.y + p.k_3 * x.y * x.y) * x.y
        square = x.y * x.y
        damping = p.d + p.more * square / (square + p.from_y * p.from_y)
        return {"y": x.v, "v": p.gain * u.u + p.offset - spring - damping * x.v}


structure = Structure.of_block(Silverbox(), scale={"k_2": 1e4, "y_0": 0.01, "from_y": 0.01}, substeps=4)
u, y = np.genfromtxt(FILE, delimiter=",", skip_header=1, usecols=(0, 1)).T
dt = 2**14 / 1e7  # [s]
whole = Record.from_columns(dt * np.arange(u.size), {"u": u, "y": y}, ["u"], ["y"], hold="band-limited")
parts = {  # a record from one sample to another; the multisine has ten realisations, of which the last is the test
    "train": whole.part(40_600 * dt, 118_700 * dt),
    "test": whole.part(119_188 * dt, 127_379 * dt),
    "arrow": whole.part(100 * dt, 40_499 * dt),
    "arrow, no extrapolation": whole.part(100 * dt, 30_900 * dt),
}
found = fit(structure, parts["train"], disturbance="white")  # what counts here is the simulation
print(found.table())
for name, part in parts.items():
    error = part.outputs["y"].value - simulate(structure, part, found, initial=50)["y"]
    print(f"{name}: RMSE {1e3 * np.sqrt(np.mean(error**2)):.3f} mV")
