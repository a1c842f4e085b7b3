"""AeroID's filter error fits, in a Python that has it, of the records in records.npz.

Writes aeroid.npz: estimates and standard deviations, (records, unknowns), and the seconds of a fit. The filter is told
the true noises; ours has to find them.
"""

import time
from pathlib import Path
from typing import Any

import aeroid
import numpy as np

given = np.load("records.npz")
dt, names = float(given["dt"]), [str(one) for one in given["names"]]
u = given["u"]
clock = dt * np.arange(u.size)


def pitch(t: float, x: Any, _: Any, p: Any) -> Any:
    """theta' = q, q' = -k theta - d q + mu M, with M held from sample to sample."""
    held = u[min(int(t / dt + 1e-6), u.size - 1)]
    return np.array([x[1], -p["k"] * x[0] - p["d"] * x[1] + p["mu"] * held])


guess = dict(zip(names, given["guess"], strict=True))
model = aeroid.Model(states=["theta", "q"], controls=["M"], parameters=guess, dynamics=pitch)
noise = dict(zip(("theta", "q"), given["measurement"] ** 2, strict=True))
push = {"theta": 1e-12, "q": float(given["push"]) ** 2}
start = {"substeps": 4, "P0": {"theta": 1e-6, "q": 1e-6}}
options = {"x0": [0.0, 0.0], "process_noise": push, "measurement_noise": noise, "filter_options": start}
before, values, sigma = time.process_time(), [], []
for theta, q in zip(given["theta"], given["q"], strict=True):
    data = aeroid.FlightData(time=clock, channels={"M": u, "theta": theta, "q": q})
    one = aeroid.identify(model, data, names, method="filter_error", **options)
    values.append([one.parameters[name] for name in names])
    sigma.append([one.stderr[name] for name in names])
seconds = (time.process_time() - before) / len(values)
np.savez(Path("aeroid.npz"), values=values, sigma=sigma, seconds=seconds)
