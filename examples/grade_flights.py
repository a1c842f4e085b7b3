"""Grade flights by their steps of the pitch: `python grade_flights.py flights/*.mcap > grades.csv`.

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

LIMITS = {"rise_time": 0.2, "overshoot": 0.2, "settling_time": 0.6}  # s, share of the step, s


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
if not logs:  # two flights to try it on, and a file that is no flight
    folder = Path(tempfile.mkdtemp())
    for gains in ("default", "student"):
        logs.append(folder / f"{gains}.mcap")
        write_log(simulate("attitude-steps", gains=gains).log, logs[-1])
    logs.append(folder / "empty.csv")
    logs[-1].write_text("")

print(f"flight,seed,rig,controller,steps,{','.join(LIMITS)},points,remark")
for path in logs:
    remark, steps, row = "", [], [path.name, "-", "-", "-"]
    try:
        log = read_log(path)
        row[1:] = origin(log.provenance)
        steps = [one.figures for one in step_responses(log) if one.loop == "attitude"]
    except TwodofError as reason:  # a damaged file, or one of another program: the others are graded
        remark = reason.what.replace(",", ";")
    if not steps:
        print(f"{','.join(row)},0,{',' * len(LIMITS)}0,{remark or 'no step of the pitch'}")
        continue
    # A figure that a step never reached counts as infinite.
    reached = [{name: getattr(one, name) for name in LIMITS} for one in steps]
    figures = {name: median(math.inf if math.isnan(one[name]) else one[name] for one in reached) for name in LIMITS}
    points = sum(figures[name] <= limit for name, limit in LIMITS.items())
    row += [str(len(steps)), *(f"{value:.3g}" for value in figures.values())]
    print(f"{','.join(row)},{points},{remark}")
