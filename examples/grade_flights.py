"""Grade flights by their steps of pitch and position: `python grade_flights.py flights/*.mcap > grades.csv`.

Two flights with the same seed, rig and controller and the same figures are one flight. That holds for experiments that
are simulated or flown in lockstep; a flight in real time never repeats bit for bit.
"""

import math
import sys
import tempfile
from pathlib import Path
from statistics import median
from typing import Any

from twodof.errors import TwodofError
from twodof.experiment import simulate
from twodof.flightlog import read_log, write_log
from twodof.report.step_responses import step_responses

FIGURES = ("rise_time", "overshoot", "settling_time")  # s, share of the step, s
LIMITS = {"attitude": (0.2, 0.2, 0.6), "position": (1.5, 0.1, 4.0)}


def origin(about: dict[str, Any]) -> list[str]:
    """Return seed, rig and controllers from a log's provenance, "-" for each that it does not have."""
    # A recording has them in `drone`, an experiment in `about` and in `flown`.
    drone, flown = (one if isinstance(one := about.get(name), dict) else {} for name in ("drone", "flown"))
    controllers = about.get("controllers") or drone.get("controllers")
    given = controllers.values() if isinstance(controllers, dict) else []
    names = "+".join(str(one.get("name")) for one in given if isinstance(one, dict))
    stock = {**drone, **flown}.get("controller", "stock" if "experiment" in about else "-")
    found = about.get("seed", drone.get("seed", "-")), about.get("rig", drone.get("rig", "-")), names or stock
    return [str(one).replace(",", ";") for one in found]


logs = [Path(name) for name in sys.argv[1:]]
if not logs:  # a flight to try it on, and a file that is no flight
    logs = [Path(tempfile.mkdtemp()) / name for name in ("student.mcap", "empty.csv")]
    write_log(simulate("attitude-steps", gains="student").log, logs[0])
    logs[1].write_text("")

print(f"flight,seed,rig,controller,loop,steps,{','.join(FIGURES)},points,remark")
for path in logs:
    remark, steps, row = "no step of pitch or position", [], [path.name, "-", "-", "-"]
    try:
        log = read_log(path)
        row[1:] = origin(log.provenance)
        steps = [one for one in step_responses(log) if one.loop in LIMITS]
    except TwodofError as reason:  # a damaged file, or one of another program: the others are graded
        remark = reason.what.replace(",", ";")
    for loop in sorted({one.loop for one in steps}):
        flown = [one.figures for one in steps if one.loop == loop]
        # A figure that a step never reached counts as infinite.
        reached = [[math.inf if math.isnan(one := getattr(step, name)) else one for name in FIGURES] for step in flown]
        figures = [median(column) for column in zip(*reached, strict=True)]
        points = sum(figure <= limit for figure, limit in zip(figures, LIMITS[loop], strict=True))
        print(",".join([*row, loop, str(len(flown)), *(f"{one:.3g}" for one in figures), str(points), ""]))
    if not steps:
        print(",".join([*row, "-", "0", *("" for _ in FIGURES), "0", remark]))
