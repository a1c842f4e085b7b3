"""The block language: write a block once, interpret it, compile it. See docs/language.md."""

from twodof.blocks.block import Block, Param, Port, State
from twodof.blocks.diagram import Diagram, Rate
from twodof.blocks.expr import (
    build,
    fold,
    int32,
    maximum,
    minimum,
    multiply_high,
    real,
    sqrt,
    store,
    to_int32,
    to_real,
    to_uint32,
    uint32,
    vector,
    where,
)

__all__ = [
    "Block",
    "Diagram",
    "Param",
    "Port",
    "Rate",
    "State",
    "build",
    "fold",
    "int32",
    "maximum",
    "minimum",
    "multiply_high",
    "real",
    "sqrt",
    "store",
    "to_int32",
    "to_real",
    "to_uint32",
    "uint32",
    "vector",
    "where",
]
