"""Grade flights by their steps of pitch and position: `python grade_flights.py flights/*.mcap > grades.csv`.

A simulated flight can be flown again to the bit, so the same figures are a copy; one in real time never repeats.
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
from twodof.report.step_responses import folded_steps, step_responses

FIGURES = ("rise_time", "overshoot", "settling_time")  # s, share of the step, s
LIMITS = {"attitude": (0.2, 0.2, 0.6), "position": (1.5, 0.1, 4.0)}


def origin(about: dict[str, Any], until: float | None) -> list[str]:
    """Return seed, rig, controllers and changed parameters from a log's provenance, "-" for each that it lacks."""
    # A recording has them in `drone`, an experiment in `about` and in `flown`.
    drone, flown = (one if isinstance(one := about.get(name), dict) else {} for name in ("drone", "flown"))
    controllers = about.get("controllers") or drone.get("controllers")
    given = controllers.values() if isinstance(controllers, dict) else []
    names = "+".join(str(one.get("name")) for one in given if isinstance(one, dict))
    stock = {**drone, **flown}.get("controller", "stock" if "experiment" in about else "-")
    changes = {name: value for time, name, value in about.get("changes", ()) if until is not None and time <= until}
    tuned = {**({**drone, **about}.get("parameters") or {}), **changes}
    said = " ".join(f"{name}={value}" for name, value in tuned.items()) or "-"
    found = about.get("seed", drone.get("seed", "-")), about.get("rig", drone.get("rig", "-")), names or stock, said
    return [str(one).replace(",", ";") for one in found]


if not (logs := [Path(name) for name in sys.argv[1:]]):  # a flight to try it on, and a file that is no flight
    logs = [Path(tempfile.mkdtemp()) / name for name in ("student.mcap", "empty.csv")]
    write_log(simulate("attitude-steps", gains="student").log, logs[0])
    logs[1].write_text("")

print(f"flight,seed,rig,controller,parameters,loop,steps,{','.join(FIGURES)},points,remark")
seen = dict[str, str]()
for path in logs:
    folds, remark = [], "no step of pitch or position"
    try:
        log = read_log(path)
        found = [one for one in folded_steps(log, step_responses(log)) if one.loop in LIMITS]
        folds = [(one, origin(log.provenance, one.after_s)) for one in found]
    except (TwodofError, TypeError, ValueError) as reason:  # a damaged file, or a foreign one: the others are graded
        remark = str(reason).splitlines()[0].replace(",", ";")
    for fold, about in folds:  # steps under the same parameters; a figure that is never reached is infinite
        rows = [[math.inf if math.isnan(v := getattr(one.figures, n)) else v for n in FIGURES] for one in fold.steps]
        figures = [median(column) for column in zip(*rows, strict=True)]
        points = sum(figure <= limit for figure, limit in zip(figures, LIMITS[fold.loop], strict=True))
        row = [*about, fold.loop, str(len(rows)), *(f"{one:.3g}" for one in figures)]
        first = seen.setdefault(str(row + figures), str(path))
        print(",".join([str(path), *row, str(points), "" if first == str(path) else f"the same as in {first}"]))
    if not folds:
        print(",".join([str(path), *"------", *("" for _ in FIGURES), "0", remark]))
