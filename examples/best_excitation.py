"""Design the excitation that tells most before flying it, fly it, and compare what it told with what was promised."""

import numpy as np

from twodof.experiment import Laboratory, experiment
from twodof.identify import KINDS, PITCH_LIMITS, best, cut, doublets, fit, multisines, three_two_one_ones
from twodof.models import PAPER_PITCH_RATE, pitch_rate

# What is known beforehand: a rough model, and below the noise of q in hover [rad/s] and how far the pitch may go.
guess = {"w_n": PAPER_PITCH_RATE.w_n, "xi": PAPER_PITCH_RATE.xi, "mu": 360.0, "tau": 0.02}
wanted = ("mu", "tau", "M_trim", "q_0")
families = {"doublet": doublets(), "3-2-1-1": three_two_one_ones(), "multisine": multisines()}
shapes = {"doublet": np.arange(0.2, 1.3, 0.1), "3-2-1-1": np.arange(0.7, 2.2, 0.3), "multisine": (0.8, 1.2, 1.6)}

print(f"{'':12}{'length, s':>10}{'amplitude':>11}{'sigma mu':>10}{'sigma tau, ms':>15}")
designs = {}
for name, family in families.items():
    design = best(
        pitch_rate(),
        family,
        shapes[name],
        duration=2.5,
        dt=0.004,
        noise={"q": 0.06},
        limits=PITCH_LIMITS,
        values=guess,
        estimate=wanted,
    )
    designs[name] = design
    promised = dict(zip(design.information.labels, design.information.sigma, strict=True))
    print(f"{name:12}{design.excitation.pattern:10.2f}{design.excitation.peak:11.4f}", end="")
    print(f"{promised['mu']:10.2f}{1e3 * promised['tau']:15.3f}")

# Fly the doublet that was found, and identify from its log.
design = designs["doublet"]
flight = Laboratory("paper").fly(experiment("doublet", excitation=design.excitation), seed=1)
found = fit(pitch_rate(), cut(flight.log, KINDS["doublet"], name="best doublet"), estimate=wanted, values=guess)
print(found.table())
# The promise takes the noise for white; in hover it is a vibration at 38 Hz, and little of it lies where q answers M.
print(design.information.beside(found))
