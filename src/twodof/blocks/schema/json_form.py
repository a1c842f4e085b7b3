"""The JSON form of a diagram. A custom block travels as its traced expressions; loading a file runs nothing of it.

What comes in is bounded before it is used. docs/reference/diagram-files.md describes the form and the limits.
"""

import functools
import hashlib
import inspect
import json
import math
from collections import Counter
from dataclasses import fields
from pathlib import Path
from typing import Any

from twodof.blocks import library
from twodof.blocks.block import REGISTRY, Block, steady_trace
from twodof.blocks.declarations import Param, Port, State, numeric
from twodof.blocks.diagram import Diagram, Part
from twodof.blocks.enumeration import Enumeration
from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.numbers import Integer
from twodof.blocks.schema.loader import DECLARED, MACHINE, POSITIONS, SETTINGS, Loader
from twodof.blocks.schema.traced_block import Fields, TracedBlock, graph_to_json, machine_to_json, read
from twodof.blocks.state_machine import StateMachine
from twodof.errors import DiagramError, shown

SCHEMA = "twodof/diagram"
VERSION = 1
MAX_BYTES = 8 * 2**20
MAX_DIGITS = 40  # of an integer
_FILE: Fields = {"schema": (str, None), "version": (int, None), "diagram": (dict, None)}


def to_json(diagram: Diagram) -> str:
    """`diagram` as JSON text that diffs well: one part, port or node a line, in the diagram's own order.

    Raises DiagramError for a library block whose constructor's arguments are not plain data.
    """
    return _text({"schema": SCHEMA, "version": VERSION, "diagram": _diagram_to(diagram)}) + "\n"


def from_json(text: str | bytes) -> Diagram:
    """Return the diagram in `text`. Raises DiagramError, with the place, for another text or version.

    Nothing of the file is executed. What it makes is bounded in memory, in code and in the work of a step: see
    docs/reference/diagram-files.md. Connections are checked when the diagram is compiled or
    interpreted.
    """
    if len(text) > MAX_BYTES:
        raise DiagramError(f"{len(text)} bytes of diagram", "file", f"at most {MAX_BYTES} are read")
    try:
        data = json.loads(
            text,
            parse_constant=_no_constant,
            parse_float=_finite,
            parse_int=_integer,
            object_pairs_hook=_without_duplicates,
        )
    except (ValueError, RecursionError) as error:
        raise DiagramError(f"this is no JSON: {error!s:.200}", "file", "save the diagram again") from error
    if not isinstance(data, dict) or data.get("schema") != SCHEMA:
        remedy = f'give a file that `twodof diagram new` or to_json wrote; one has "schema": "{SCHEMA}"'
        raise DiagramError("this is not a diagram", "file", remedy)
    if data.get("version") != VERSION or type(data["version"]) is not int:
        raise DiagramError(
            f"schema version {shown(data.get('version'))} is unknown", "file", f"this twodof reads version {VERSION}"
        )
    return Loader().diagram(read(data, "a diagram", _FILE, "file")["diagram"])


def read_diagram(path: str | Path) -> Diagram:
    """Return the diagram in the file at `path`; no more is read than a diagram may have. Errors as `from_json`'s."""
    file = Path(path)
    try:
        if not file.is_file():
            raise DiagramError("no such file", f"{path!s:.200}", "name a diagram's JSON file")
        with file.open("rb") as stream:
            data = stream.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        raise DiagramError(
            f"it cannot be read: {error!s:.200}", f"{path!s:.200}", "name a diagram's JSON file"
        ) from error
    try:
        return from_json(data)
    except DiagramError as error:
        where = f"{path}: {error.where}" if error.where != "file" else str(path)
        raise DiagramError(error.what, where, error.remedy) from error


def _no_constant(text: str) -> float:
    raise ValueError(f"{text} is no JSON number")


def _finite(text: str) -> float:
    value = float(text)
    if math.isinf(value):
        raise ValueError(f'{text:.40} is beyond the largest float64 (infinity is written {{"float": "inf"}})')
    return value


def _integer(text: str) -> int:
    if len(text) > MAX_DIGITS:
        raise ValueError(f"an integer of {len(text)} digits")
    return int(text)


def _without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    made = dict(pairs)
    if len(made) < len(pairs):
        twice, _ = Counter(key for key, _ in pairs).most_common(1)[0]
        raise ValueError(f"the key {shown(twice)} stands twice in one object")
    return made


def _diagram_to(d: Diagram) -> dict[str, Any]:
    return {
        "name": d.name,
        "text": d.text,
        "inputs": [declared_form(p) for p in d.inputs.values()],
        "params": [declared_form(p) for p in d.params.values()],
        "parts": [_part_to(p) for p in d.parts.values()],
        "connections": [[source, f"{part}.{port}"] for (part, port), source in d.connections.items()],
        "outputs": [[name, source] for name, source in d.outputs.items()],
        **{key: {name: list(at) for name, at in getattr(d, key).items()} for key in POSITIONS if getattr(d, key)},
    }


def _part_to(part: Part) -> dict[str, Any]:
    settings = {key: encoded(getattr(part, key), part.name) for key in SETTINGS}
    form = {"name": part.name} | {key: v for key, v in settings.items() if v != SETTINGS[key][1]}
    if isinstance(part.item, Diagram):
        return form | {"diagram": _diagram_to(part.item)}
    return form | {"block": _block_to(part.item, part.name)}


def _block_to(block: Block, name: str) -> dict[str, Any]:
    kind = type(block).type_name
    if REGISTRY.get(kind) is type(block):  # a class made from one of the library is another block
        return {"type": kind, "config": encoded(getattr(block, "config", {}), name)}
    trace = steady_trace(block, name)
    kind = MACHINE if isinstance(block, StateMachine) else "custom"
    label = block.label if isinstance(block, (StateMachine, TracedBlock)) else ""
    return {
        "type": kind,
        "name": label or type(block).__name__,
        **{key: [declared_form(d) for d in getattr(block, key)] for key in DECLARED[kind]},
        "crossing": block.crossing,
        **(machine_to_json(block) if isinstance(block, StateMachine) else graph_to_json(trace)),
    }


def declared_form(item: Port | State | Param) -> dict[str, Any]:
    """Return the value, and each field that differs from its default."""
    values = {f.name: (getattr(item, f.name), f.default) for f in fields(item)}
    return {
        key: encoded(value, item.name)
        for key, (value, default) in values.items()
        if (key in ("value", "initial") or value != default) and not (key == "width" and item.shape)
    }


def encoded(value: Any, where: str) -> Any:
    """Return a value as JSON holds it: infinities and NaN as {"float": "inf"}. DiagramError for any other type."""
    if isinstance(value, float) and not math.isfinite(value):
        return {"float": str(value)}
    if isinstance(value, (list, tuple)):
        return [encoded(v, where) for v in value]
    if isinstance(value, dict):
        return {str(k): encoded(v, where) for k, v in value.items()}
    if isinstance(value, Enumeration):
        return value.form()
    if isinstance(value, Integer):  # a member of an enumeration, in an argument
        return value.value
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    raise DiagramError(f"a {type(value).__name__} has no JSON form", where, "use numbers, strings and lists")


def _text(value: Any, indent: int = 0) -> str:
    """JSON in which a short value stands on one line and a long one has a line for each of its items."""
    flat = json.dumps(value, ensure_ascii=False)
    if not isinstance(value, (dict, list)) or len(flat) <= 80:
        return flat
    pad = " " * (indent + 1)
    if isinstance(value, dict):
        rows = [f"{pad}{json.dumps(k)}: {_text(v, indent + 1)}" for k, v in value.items()]
        return "{\n" + ",\n".join(rows) + "\n" + " " * indent + "}"
    return "[\n" + ",\n".join(f"{pad}{_text(v, indent + 1)}" for v in value) + "\n" + " " * indent + "]"


_FIRST = ("math", "control", "nonlinear", "filters", "discrete", "delays", "sources", "logic", "routing")
_CHOICES = "use one of "
_NO_CHOICE = "?"  # what no argument takes that has choices


def block_shape(block: Block) -> dict[str, Any]:
    """Return the ports and parameters of `block` as plain data.

    `structure` is equal for two blocks that differ only in the values of their parameters, so that one program serves
    both. A bound that is infinite is None, the values of an array stand as in memory. Raises DiagramError for a block
    that cannot be traced.
    """
    declared = {key: [declared_form(d) for d in getattr(block, key)] for key in DECLARED["custom"]}
    declared["params"] = [form | {"value": None} for form in declared["params"]]
    text = json.dumps([declared, block.crossing, graph_to_json(block.trace)], sort_keys=True, default=str)
    digest = hashlib.sha256(f"{type(block).__qualname__} {text}".encode()).hexdigest()[:16]
    return {
        "inputs": [_port(p) for p in block.inputs],
        "outputs": [_port(p) for p in block.outputs],
        "params": [_parameter(p) for p in block.params],
        "structure": digest,
    }


@functools.cache
def catalogue() -> tuple[dict[str, Any], ...]:
    """Return the blocks of the library as plain data, the most used rooms first, in the order of their declaration.

    `type` is a block's type in JSON, `name` its name in Python, `group` its room, `text` its docstring, `config` the
    arguments by default. `choices` are the words of the arguments that take one of a few. `shape` is its `block_shape`.
    """
    prefix = f"{library.__name__}."
    classes = [cls for cls in REGISTRY.values() if cls.__module__.startswith(prefix)]
    rooms = [*_FIRST, *dict.fromkeys(cls.__module__.removeprefix(prefix) for cls in classes)]
    classes.sort(key=lambda cls: rooms.index(cls.__module__.removeprefix(prefix)))
    return tuple(_entry(cls, cls.__module__.removeprefix(prefix)) for cls in classes)


def _entry(cls: type[Block], group: str) -> dict[str, Any]:
    block = cls()
    config = dict(getattr(block, "config", {}))
    words = {name: _choices(cls, name) for name, value in config.items() if _is_word(value)}
    return {
        "type": cls.type_name,
        "name": cls.__name__,
        "group": group,
        "text": inspect.cleandoc(cls.__doc__ or ""),
        "config": encoded(config, cls.type_name),
        "choices": {name: found for name, found in words.items() if found},
        "shape": block_shape(block),
    }


def _is_word(value: Any) -> bool:
    """Return True if an argument of this default may take words: a word, yes or no, or nothing."""
    return value is None or isinstance(value, bool) or (isinstance(value, str) and bool(value))


def _choices(cls: type[Block], argument: str) -> list[str]:
    """Return the words that an argument may be, by the block's error for another word; empty if any is taken."""
    make: Any = cls
    try:
        make(**{argument: _NO_CHOICE})
    except DiagramError as error:
        if error.remedy.startswith(_CHOICES):
            return error.remedy.removeprefix(_CHOICES).split(", ")
    return []


def _port(port: Port | Param) -> dict[str, Any]:
    return {"name": port.name, "kind": port.kind, "width": port.width, "unit": port.unit}


def _parameter(param: Param) -> dict[str, Any]:
    with numbers.precision("float64"):
        value = numbers.plain(numeric(param.value, param.kind, param.width, param.name, param.shape))
    return {
        **_port(param),
        "value": encoded(value, param.name),
        "low": param.low if math.isfinite(param.low) else None,
        "high": param.high if math.isfinite(param.high) else None,
        "text": param.text,
    }
