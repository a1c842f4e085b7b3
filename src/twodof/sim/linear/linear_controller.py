"""The controllers in hover as a linear model: from what they read to the commands of the rotor pairs, mode by mode."""

from collections.abc import Iterable

from twodof.blocks import Diagram
from twodof.compile.linear.linear_model import LinearModel
from twodof.compile.linear.linearize import linearize
from twodof.flight.core import core
from twodof.flight.declarations import IMU
from twodof.flight.gains import DEFAULT, Gains
from twodof.signals import HOVER, MODES, PERIOD

_READ = ("estimator.filter.q", "previous.theta", "estimator.publisher.v", "estimator.publisher.x", *IMU)
_ARMED, _HELD = 1000, 10**6  # steps since arming, and of the level hold: more than the flight code waits for


def linear_controller(mode: str, gains: Gains = DEFAULT, controllers: Iterable[Diagram] = ()) -> LinearModel:
    """The flight core's controllers in `mode` ("rate", ...), level and at their set-points, at 250 Hz.

    The inputs are those of `linear_rig.SIGNALS`, the outputs fore and aft. `controllers` fly in place of the stock
    ones, as in `flight.core`. Raises DiagramError for a diagram that fits no template. Raises it also where a
    controller has no slope: a switch, a limit or a dead zone at just that point.
    """
    at = {
        "mode": MODES.index(mode),
        "thrust": HOVER,
        "acc_z": 0.0,
        "arming.count": _ARMED,
        "hold.samples": _HELD,
        "estimator.filter.started": True,
    }
    return linearize(core(gains, controllers=controllers), PERIOD, at, list(_READ), ["fore", "aft"], time="discrete")
