"""Fly a doublet on the virtual rig and identify gain and delay from its log."""

from twodof.experiment.flight import Laboratory
from twodof.experiment.protocol import experiment
from twodof.identify.greybox import fit
from twodof.identify.record import Record
from twodof.models.structures import pitch_rate

flight = Laboratory("paper").fly(experiment("doublet"), seed=1)
print(f"checks: {', '.join(f'{check.name} ({check.seen})' for check in flight.checks)}")

# The last 1.2 s before the motors stop: rest at the trim moment, the doublet, a little of what follows.
log = flight.log
stop = log.armed()[-1][1]
channels = {name: (log[name].time, log[name].value) for name in ("M", "q")}
record = Record.from_channels(channels, ["M"], ["q"], start=stop - 1.15, stop=stop, name="doublet")

# The doublet is over before the poles show, so they are given; the trim and the rate at the start are not.
found = fit(pitch_rate(), record, estimate=("mu", "tau", "M_trim", "q_0"), values={"w_n": 3.437, "xi": 0.0836})
print(found.table())
