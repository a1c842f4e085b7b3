"""The library of blocks; docs/library.md lists them with their ports and parameters."""

from twodof.blocks.library.continuous import FirstOrder, Integrator, SecondOrder, StateSpace, TransferFunction
from twodof.blocks.library.control import Pid
from twodof.blocks.library.delays import Delay, FractionalDelay, RateTransition, UnitDelay, ZeroOrderHold
from twodof.blocks.library.discrete import (
    DiscreteDerivative,
    DiscreteFilter,
    DiscreteIntegrator,
    DiscreteStateSpace,
    DiscreteTransferFunction,
    MovingAverage,
)

__all__ = [
    "Delay",
    "DiscreteDerivative",
    "DiscreteFilter",
    "DiscreteIntegrator",
    "DiscreteStateSpace",
    "DiscreteTransferFunction",
    "FirstOrder",
    "FractionalDelay",
    "Integrator",
    "MovingAverage",
    "Pid",
    "RateTransition",
    "SecondOrder",
    "StateSpace",
    "TransferFunction",
    "UnitDelay",
    "ZeroOrderHold",
]
