"""The catalogue: what an editor must know of the library's blocks, and of a block with given arguments."""

import functools
import hashlib
import inspect
import json
import math
from dataclasses import dataclass
from typing import Any

from twodof.blocks import library
from twodof.blocks.block import REGISTRY, Block
from twodof.blocks.declarations import Param, Port, State, numeric
from twodof.blocks.expressions import numbers
from twodof.blocks.schema.json_form import declared_form, encoded
from twodof.blocks.schema.traced_block import graph_to_json
from twodof.errors import DiagramError

_FIRST = ("math", "control", "nonlinear", "filters", "discrete", "delays", "sources", "logic", "routing")
_CHOICES = "use one of "
_NO_CHOICE = "?"  # what no argument takes that has choices


@dataclass(frozen=True)
class BlockShape:
    """What a block shows outside: its ports and parameters.

    `structure` is alike for two blocks that differ in nothing but the values of their parameters, so that one program
    serves both.
    """

    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    params: tuple[Param, ...]
    structure: str

    def to_json(self) -> dict[str, Any]:
        """Plain data; a bound that is infinite is None, the values of an array stand as in memory."""
        return {
            "inputs": [_port(p) for p in self.inputs],
            "outputs": [_port(p) for p in self.outputs],
            "params": [_parameter(p) for p in self.params],
            "structure": self.structure,
        }


@dataclass(frozen=True)
class CatalogueEntry:
    """A block of the library: its type in JSON, its name in Python, its room, what it says of itself.

    `config` are the arguments that it is made with by default, as JSON keeps them. `choices` are those of the arguments
    that take one of a few words.
    """

    type: str
    name: str
    group: str
    text: str
    config: dict[str, Any]
    choices: dict[str, tuple[str, ...]]
    shape: BlockShape

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "type": self.type,
            "name": self.name,
            "group": self.group,
            "text": self.text,
            "config": encoded(self.config, self.type),
            "choices": {name: list(words) for name, words in self.choices.items()},
            "shape": self.shape.to_json(),
        }


def block_shape(block: Block) -> BlockShape:
    """The ports and parameters of `block`, and what of it a program is made of.

    Raises DiagramError for a block that cannot be traced.
    """
    plain = [
        *(["input", declared_form(p)] for p in block.inputs),
        *(["output", declared_form(p)] for p in block.outputs),
        *(["state", declared_form(s)] for s in block.states),
        *(["derived", declared_form(p)] for p in block.derived),
        *(["parameter", declared_form(p) | {"value": None}] for p in block.params),
        block.crossing,
        graph_to_json(block.trace),
    ]
    text = json.dumps(plain, sort_keys=True, default=str)
    digest = hashlib.sha256(f"{type(block).__qualname__} {text}".encode()).hexdigest()[:16]
    return BlockShape(tuple(block.inputs), tuple(block.outputs), tuple(block.params), digest)


@functools.cache
def catalogue() -> tuple[CatalogueEntry, ...]:
    """The blocks of the library, what is used most first, room by room as each declares them."""
    prefix = f"{library.__name__}."
    classes = [cls for cls in REGISTRY.values() if cls.__module__.startswith(prefix)]
    rooms = [*_FIRST, *dict.fromkeys(cls.__module__.removeprefix(prefix) for cls in classes)]
    classes.sort(key=lambda cls: rooms.index(cls.__module__.removeprefix(prefix)))
    return tuple(_entry(cls, cls.__module__.removeprefix(prefix)) for cls in classes)


def _entry(cls: type[Block], group: str) -> CatalogueEntry:
    block = cls()
    config = dict(getattr(block, "config", {}))
    words = {name: _choices(cls, name) for name, value in config.items() if _is_word(value)}
    choices = {name: found for name, found in words.items() if found}
    text = inspect.cleandoc(cls.__doc__ or "")
    return CatalogueEntry(cls.type_name, cls.__name__, group, text, config, choices, block_shape(block))


def _is_word(value: Any) -> bool:
    """Whether an argument of this default may take words: a word, yes or no, or nothing."""
    return value is None or isinstance(value, bool) or (isinstance(value, str) and bool(value))


def _choices(cls: type[Block], argument: str) -> tuple[str, ...]:
    """What an argument may be, by what the block says of a word that is none; empty if it takes any."""
    make: Any = cls
    try:
        make(**{argument: _NO_CHOICE})
    except DiagramError as error:
        if error.remedy.startswith(_CHOICES):
            return tuple(error.remedy.removeprefix(_CHOICES).split(", "))
    return ()


def _port(port: Port | State) -> dict[str, Any]:
    return {"name": port.name, "kind": port.kind, "width": port.width, "unit": port.unit}


def _parameter(param: Param) -> dict[str, Any]:
    with numbers.precision("float64"):
        value = numbers.plain(numeric(param.value, param.kind, param.width, param.name, param.shape))
    return {
        "name": param.name,
        "kind": param.kind,
        "width": param.width,
        "unit": param.unit,
        "value": encoded(value, param.name),
        "low": param.low if math.isfinite(param.low) else None,
        "high": param.high if math.isfinite(param.high) else None,
        "text": param.text,
    }
