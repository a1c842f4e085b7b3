"""Grade models by the truth, which a virtual rig knows: `python grade_models.py models/*.json > grades.csv`.

The files are those that `twodof identify LOG --out MODEL.json` writes. Without any, two are made to try it on.
"""

import json
import sys
import tempfile
from pathlib import Path

from twodof.errors import TwodofError
from twodof.experiment import Laboratory, simulate
from twodof.identify.identified_flight import identify_flight
from twodof.rig.rig import model_parameters

DEVIATION = {"w_n": 0.01, "xi": 0.05, "mu": 0.1, "tau": 0.1, "k_v": 0.1, "p_v": 0.3}
"""The largest standard deviation for a point, as a share of the truth. The truth must lie within 3 deviations."""
GRADED = {"impulse": ("w_n", "xi"), "doublet": ("mu", "tau"), "velocity": ("k_v", "p_v")}
"""What an experiment tells. Without thrust mu is another one, and with it the pitch hardly swings."""

models = [Path(name) for name in sys.argv[1:]]
if not models:  # a model, and a file that is none
    folder = Path(tempfile.mkdtemp())
    models = [folder / "doublet.json", folder / "empty.json"]
    models[0].write_text(json.dumps(identify_flight(simulate("doublet", "lab").log).model()))
    models[1].write_text("{}")

print("model,rig,experiment,unknown,value,deviation,truth,point,remark")
seen = dict[str, str]()
for path in models:
    shown = str(path).replace(",", ";")
    try:
        model = json.loads(path.read_text())
        known = model_parameters(Laboratory(model["rig"]).parameters.snapshot())
        for name in GRADED[model["experiment"]]:
            found, truth = {**model["estimates"], **model["sums"]}[name], known[name]
            sigma = found.get("sigma_quoted", found["sigma"])  # robust where the residual is not white; so are sums'
            point = abs(found["value"] - truth) <= 3.0 * sigma <= 3.0 * DEVIATION[name] * abs(truth)
            figures = ",".join(f"{one:.4g}" for one in (found["value"], sigma, truth))
            row = f"{model['rig']},{model['experiment']},{name},{figures},{int(point)}"
            first = seen.setdefault(row, shown)
            print(f"{shown},{row},{'' if first == shown else f'the same as in {first}'}")
    except (TwodofError, LookupError, TypeError, ValueError):  # the others are graded
        print(f"{shown},-,-,no model of a virtual rig's {' or '.join(GRADED)},,,,0,")
