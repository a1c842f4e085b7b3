"""Grade flights by their steps of the pitch: `python grade_flights.py flights/*.mcap > grades.csv`."""

import math
import sys
from pathlib import Path
from statistics import median

from twodof.errors import TwodofError
from twodof.experiment import simulate
from twodof.flightlog import read_log, write_log
from twodof.report.step_responses import step_responses

LIMITS = {"rise_time": 0.2, "overshoot": 0.2, "settling_time": 0.6}  # s, share of the step, s

logs = [Path(name) for name in sys.argv[1:]]
if not logs:  # two flights to try it on, and a file that is no flight
    for gains in ("default", "student"):
        logs.append(Path(f"{gains}.mcap"))
        logs[-1].unlink(missing_ok=True)
        write_log(simulate("attitude-steps", gains=gains).log, logs[-1])
    logs.append(Path("empty.csv"))
    logs[-1].write_text("")

print(f"flight,steps,{','.join(LIMITS)},points,remark")
for path in logs:
    remark, steps = "", []
    try:
        steps = [one.figures for one in step_responses(read_log(path)) if one.loop == "attitude"]
    except TwodofError as reason:  # a damaged file, or one of another program: the others are graded
        remark = reason.what.replace(",", ";")
    if not steps:
        print(f"{path.name},0,{',' * len(LIMITS)}0,{remark or 'no step of the pitch'}")
        continue
    # A figure that a step never reached counts as infinite.
    reached = [{name: getattr(one, name) for name in LIMITS} for one in steps]
    figures = {name: median(math.inf if math.isnan(one[name]) else one[name] for one in reached) for name in LIMITS}
    points = sum(figures[name] <= limit for name, limit in LIMITS.items())
    print(f"{path.name},{len(steps)},{','.join(f'{value:.3g}' for value in figures.values())},{points},{remark}")
