"""Fit the cascaded tanks, a benchmark in which one tank overflows into the other, from random first guesses."""

import os
import sys
from pathlib import Path
from typing import Any

import numpy as np

from twodof.blocks import Block, Param, Port, State, maximum, minimum, sqrt
from twodof.identify import Record, fit_from_several, simulate
from twodof.models import Structure

FILE = Path(os.environ.get("TWODOF_BENCHMARK_DATA", ".")) / "dataBenchmark.csv"
if not FILE.is_file():
    print("let TWODOF_BENCHMARK_DATA name the folder with dataBenchmark.csv, from nonlinearbenchmark.org, or from")
    print("github.com/MiladBnit/Uncertainty-quantification-in-neural-state-space-models-applications")
    sys.exit()


class Tanks(Block):
    """Levels [V]; what rises above `full` in the upper tank is spilt, a share of it into the lower tank."""

    inputs = (Port("u"),)
    outputs = (Port("y"),)
    params = (
        Param("pump", 0.05, low=0.0, high=1.0, text="rise of the upper level per volt [1/s]"),
        Param("dead", 0.0, low=-1.0, high=4.0, text="voltage below which the pump lifts nothing"),
        Param("upper", 0.01, low=0.0, high=1.0, text="flow out of the upper tank, in proportion to its level [1/s]"),
        Param("lower", 0.05, low=0.0, high=1.0, text="flow out of the lower tank, by Torricelli's law"),
        Param("full", 8.0, low=1.0, high=60.0, text="level at which the upper tank overflows"),
        Param("caught", 0.5, low=0.0, high=1.0, text="share of what is spilt that the lower tank catches"),
        Param("bias", 0.0, low=-5.0, high=5.0, text="what the sensor shows of an empty tank"),
        Param("h_0", 5.0, low=0.0, high=60.0),
        Param("l_0", 5.0, low=0.0, high=60.0),
    )
    states = (State("h", "h_0", continuous=True), State("l", "l_0", continuous=True))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        """The sensor shows at most 10 V."""
        return minimum(x.l + p.bias, 10.0)

    def derivative(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        """Return inflow minus outflow of each tank; water above an edge leaves within a second."""
        spilt, over = maximum(x.h - p.full, 0.0), maximum(x.l + p.bias - 10.0, 0.0)
        down, out = p.upper * x.h, p.lower * sqrt(maximum(x.l, 0.0))
        return {"h": p.pump * (u.u - p.dead) - down - spilt, "l": down + p.caught * spilt - out - over}


structure = Structure.of_block(Tanks(), scale={"bias": 0.1, "dead": 0.1}, substeps=8)
table = np.genfromtxt(FILE, delimiter=",", skip_header=1, usecols=(0, 1, 2, 3)).T  # uEst, uVal, yEst, yVal
train, test = (
    Record.from_columns(4.0 * np.arange(1024), {"u": table[i], "y": table[i + 2]}, ["u"], ["y"]) for i in (0, 1)
)
wide = {"pump": (0.01, 0.2), "upper": (0.002, 0.1), "lower": (0.01, 0.2), "full": (3.0, 12.0), "caught": (0.1, 0.9)}
found = fit_from_several(structure, train, wide, starts=20, seed=1, disturbance="white")
print(found.best.table(), f"\nfound by {100 * found.share:.0f} % of the first guesses", sep="")
error = test.outputs["y"].value - simulate(structure, test, found.best, initial=50)["y"]
print(f"test: RMSE {np.sqrt(np.mean(error**2)):.3f} V")
