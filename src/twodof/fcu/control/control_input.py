"""What the flight code is asked in one tick, next to what is measured."""

from typing import NamedTuple


class ControlInput(NamedTuple):
    """Inputs of the flight code that are not measured; names and units as in `flight.declarations.INPUTS`."""

    mode: int = 0
    arm: bool = False
    x0: float = 0.0
    v0: float = 0.0
    ax0: float = 0.0
    theta0: float = 0.0
    q0: float = 0.0
    thrust: float = 0.0
    M_open: float = 0.0
    use_trim: bool = False
    in_reset: bool = False
    setpoint_new: bool = False
    link_new: bool = False
