"""The loops of the stock cascade over one member of a family, each broken where the drone's own margins break it."""

import numpy as np

from twodof.design.loop_transfer import LoopTransfer
from twodof.design.uncertain.pitch_family import PitchMembers
from twodof.design.uncertain.pitch_loop import GUST, PitchLoop
from twodof.design.uncertain.sampled_controller import SampledController
from twodof.flight.gains import Gains
from twodof.signals import PERIOD

PITCH_LOOPS = ("motors", "rate", "attitude")
"""At M with both loops closed, at q in rate mode, and at theta with the rate loop closed."""


def pitch_loops(member: PitchMembers, gains: Gains) -> dict[str, LoopTransfer]:
    """L of each of `PITCH_LOOPS`, sampled at 250 Hz as it flies, for the first of `member` and stock `gains`."""
    plant = PitchLoop(member, SampledController.of_cascade(*gains.rate, gains.attitude))
    rate = plant.under(SampledController.of_cascade(*gains.rate, 0.0))
    inner = plant.under(SampledController.of_cascade(*gains.rate, gains.attitude, theta_loop=False))
    a, drive, _, _ = (part[0] for part in inner.matrices)
    kept = np.delete(np.arange(len(a)), GUST)
    # The theta that the attitude loop reads is the last state of the plant.
    read = np.zeros((1, len(a)))
    read[0, inner.plant[1].shape[1] - 1] = 1.0
    attitude = LoopTransfer(a[np.ix_(kept, kept)], drive[kept][:, :1], read[:, kept], 0.0, PERIOD)
    return {"motors": plant.loop_transfer(), "rate": rate.loop_transfer(), "attitude": attitude}
