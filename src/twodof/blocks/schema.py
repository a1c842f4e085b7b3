"""The JSON form of a diagram. A custom block travels as its traced expressions; loading a file runs nothing of it.

What comes in is bounded before it is used (the MAX_ constants); docs/language.md section 5 describes the form.
"""

from __future__ import annotations

import json
import math
from typing import Any

from twodof.blocks.block import REGISTRY, Block, Param, Port, State
from twodof.blocks.diagram import Diagram, Part
from twodof.blocks.traced import TracedBlock, graph_from_json, graph_to_json
from twodof.errors import DiagramError, TwodofError

SCHEMA = "twodof/diagram"
VERSION = 1
MAX_BYTES = 16 * 2**20
MAX_DEPTH = 64
MAX_PARTS = 100_000
MAX_ELEMENTS = 10_000_000  # array elements of all ports, states and parameters together


def to_json(diagram: Diagram) -> str:
    """`diagram` as JSON text that diffs well: one part, port or node a line, in the diagram's own order.

    Raises DiagramError for a library block whose constructor's arguments are not plain data.
    """
    return _text({"schema": SCHEMA, "version": VERSION, "diagram": _diagram_to(diagram)}) + "\n"


def from_json(text: str | bytes) -> Diagram:
    """The diagram in `text`. Raises DiagramError, naming the place, for what is no diagram of this version.

    Connections are checked when the diagram is compiled or interpreted.
    """
    if len(text) > MAX_BYTES:
        raise DiagramError(f"{len(text)} bytes of diagram", "file", f"at most {MAX_BYTES} are read")
    try:
        data = json.loads(text, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise DiagramError(f"this is no JSON: {error!s:.200}", "file", "save the diagram again") from error
    if not isinstance(data, dict) or data.get("schema") != SCHEMA:
        raise DiagramError("this is no diagram", "file", f'its "schema" is not "{SCHEMA}"')
    if data.get("version") != VERSION:
        raise DiagramError(
            f"schema version {data.get('version')!r:.20} is unknown", "file", f"this twodof reads version {VERSION}"
        )
    return _Loader().diagram(_get(data, "diagram", dict, "file"), "", 0)


def _no_constant(text: str) -> float:
    raise ValueError(f"{text} is no JSON number")


def _diagram_to(d: Diagram) -> dict[str, Any]:
    return {
        "name": d.name,
        "text": d.text,
        "inputs": [_declared_to(p) for p in d.inputs.values()],
        "params": [_declared_to(p) for p in d.params.values()],
        "parts": [_part_to(p) for p in d.parts.values()],
        "connections": [[source, f"{part}.{port}"] for (part, port), source in d.connections.items()],
        "outputs": [[name, source] for name, source in d.outputs.items()],
    }


def _part_to(part: Part) -> dict[str, Any]:
    form: dict[str, Any] = {"name": part.name}
    if tuple(part.rate) != (1, 0):
        form["rate"] = list(part.rate)
    for key in ("params", "enable", "reset"):
        if getattr(part, key):
            form[key] = getattr(part, key)
    if part.disabled != "hold":
        form["disabled"] = part.disabled
    if part.position is not None:
        form["position"] = list(part.position)
    if isinstance(part.item, Diagram):
        return form | {"diagram": _diagram_to(part.item)}
    return form | {"block": _block_to(part.item, part.name)}


def _block_to(block: Block, name: str) -> dict[str, Any]:
    if type(block).type_name:
        return {"type": type(block).type_name, "config": _encode(getattr(block, "config", {}), name)}
    return {
        "type": "custom",
        "name": block.label if isinstance(block, TracedBlock) else type(block).__name__,
        **{
            k: [_declared_to(d) for d in getattr(block, k)]
            for k in ("inputs", "outputs", "states", "params", "derived")
        },
        "crossing": block.crossing,
        **graph_to_json(block.trace),
    }


_DEFAULTS: dict[str, Any] = {
    "kind": "real",
    "width": None,
    "unit": "",
    "text": "",
    "tunable": True,
    "continuous": False,
}


def _declared_to(item: Port | State | Param) -> dict[str, Any]:
    form = {}
    for key, value in vars(item).items():
        infinite = key in ("low", "high") and math.isinf(value)
        if not infinite and not (key in _DEFAULTS and value == _DEFAULTS[key]):
            form[key] = _encode(value, item.name)
    return form


def _encode(value: Any, where: str) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return {"float": str(value)}
    if isinstance(value, (list, tuple)):
        return [_encode(v, where) for v in value]
    if isinstance(value, dict):
        return {str(k): _encode(v, where) for k, v in value.items()}
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    raise DiagramError(f"a {type(value).__name__} has no JSON form", where, "use numbers, strings and lists")


def _decode(value: Any) -> Any:
    if isinstance(value, dict):
        if set(value) == {"float"} and value["float"] in ("inf", "-inf", "nan"):
            return float(value["float"])
        return {k: _decode(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_decode(v) for v in value]
    return value


def _text(value: Any, indent: int = 0) -> str:
    """JSON in which whatever is short stands on one line and everything else has a line for each of its items."""
    flat = json.dumps(value, ensure_ascii=False)
    if not isinstance(value, (dict, list)) or len(flat) <= 80:
        return flat
    pad = " " * (indent + 1)
    if isinstance(value, dict):
        rows = [f"{pad}{json.dumps(k)}: {_text(v, indent + 1)}" for k, v in value.items()]
        return "{\n" + ",\n".join(rows) + "\n" + " " * indent + "}"
    return "[\n" + ",\n".join(f"{pad}{_text(v, indent + 1)}" for v in value) + "\n" + " " * indent + "]"


def _get(data: dict[str, Any], key: str, kind: type | tuple[type, ...], where: str, default: Any = None) -> Any:
    value = data.get(key, default)
    if not isinstance(value, kind) or (isinstance(value, bool) and kind is int):
        raise DiagramError(f"{key!r} is missing or of the wrong kind", where, "see docs/language.md, section 5")
    return value


class _Loader:
    """Builds a diagram and counts what it costs."""

    def __init__(self) -> None:
        self.parts = 0
        self.elements = 0

    def diagram(self, data: dict[str, Any], path: str, depth: int) -> Diagram:
        if depth > MAX_DEPTH:
            raise DiagramError(f"sub-diagrams are nested more than {MAX_DEPTH} deep", path, "flatten the diagram")
        d = Diagram(_get(data, "name", str, path or "diagram"), _get(data, "text", str, path, ""))
        path = path or d.name
        for form in _get(data, "inputs", list, path, []):
            port = self._declared(Port, form, path)
            d.input(port.name, port.kind, port.width, port.unit)
        for form in _get(data, "params", list, path, []):
            p = self._declared(Param, form, path)
            fields = {k: v for k, v in vars(p).items() if k not in ("name", "value")}
            d.param(p.name, p.value, **fields)
        for form in _get(data, "parts", list, path, []):
            self._part(d, form, path, depth)
        for pair in _get(data, "connections", list, path, []):
            if not (isinstance(pair, list) and len(pair) == 2 and all(isinstance(s, str) for s in pair)):
                raise DiagramError(f"{pair!r:.80} is no connection", path, 'write ["source", "part.port"]')
            self._connect(d, pair[0], pair[1])
        for pair in _get(data, "outputs", list, path, []):
            named = isinstance(pair, list) and len(pair) == 2 and isinstance(pair[0], str)
            if not named or not isinstance(pair[1], (str, type(None))):
                raise DiagramError(f"{pair!r:.80} is no output", path, 'write ["name", "source"]')
            d.output(pair[0], pair[1])
        return d

    def _connect(self, d: Diagram, source: str, destination: str) -> None:
        part, _, _ = destination.partition(".")
        if part not in d.parts:
            raise DiagramError(
                f"a connection leads to {destination!r:.80}, which is not there", d.name, "name a part's input"
            )
        d.connect(source, destination)

    def _part(self, d: Diagram, form: Any, path: str, depth: int) -> None:
        if not isinstance(form, dict):
            raise DiagramError(f"{form!r:.80} is no part", path, "a part is an object with a name")
        name = _get(form, "name", str, path)
        where = f"{path}.{name:.80}"
        self.parts += 1
        if self.parts > MAX_PARTS:
            raise DiagramError(f"more than {MAX_PARTS} parts", where, "make the diagram smaller")
        item: Block | Diagram
        if "diagram" in form:
            item = self.diagram(_get(form, "diagram", dict, where), where, depth + 1)
        else:
            item = self._block(_get(form, "block", dict, where), where)
        rate = _get(form, "rate", list, where, [1, 0])
        if len(rate) != 2 or not all(type(r) is int for r in rate):
            raise DiagramError(f"rate {rate!r:.80}", where, "write [divider, offset]")
        bound = _get(form, "params", dict, where, {})
        if not all(isinstance(v, str) for v in bound.values()):
            raise DiagramError("params binds something that is no name", where, 'write {"inner": "outer"}')
        position = form.get("position")
        if position is not None:
            good = isinstance(position, list) and len(position) == 2 and all(type(c) in (int, float) for c in position)
            if not good:
                raise DiagramError(f"position {position!r:.80}", where, "write [x, y]")
        d.add(
            name,
            item,
            rate=(rate[0], rate[1]),
            params=bound,
            enable=_get(form, "enable", (str, type(None)), where),
            reset=_get(form, "reset", (str, type(None)), where),
            disabled=_get(form, "disabled", str, where, "hold"),
            position=None if position is None else (float(position[0]), float(position[1])),
        )

    def _block(self, form: dict[str, Any], where: str) -> Block:
        kind = _get(form, "type", str, where)
        if kind == "custom":
            block: Block = self._custom(form, where)
        elif kind in REGISTRY:
            config = _decode(_get(form, "config", dict, where, {}))
            try:
                block = REGISTRY[kind](**config)
            except TwodofError as error:
                raise DiagramError(error.what, where, error.remedy) from error
            except (TypeError, ValueError, ArithmeticError, LookupError) as error:
                raise DiagramError(f"{kind} cannot be made: {error!s:.200}", where, "see docs/library.md") from error
        else:
            raise DiagramError(f"unknown block type {kind!r:.80}", where, "see docs/library.md for the types there are")
        declared: list[Any] = [*block.inputs, *block.outputs, *block.states, *block.params, *block.derived]
        self._count(sum(item.width or 1 for item in declared), where)
        return block

    def _custom(self, form: dict[str, Any], where: str) -> TracedBlock:
        kinds: dict[str, type] = {"inputs": Port, "outputs": Port, "states": State, "params": Param, "derived": Port}
        declared = {
            k: [self._declared(cls, f, where) for f in _get(form, k, list, where, [])] for k, cls in kinds.items()
        }
        crossing = _get(form, "crossing", bool, where, False)
        block = TracedBlock(_get(form, "name", str, where), declared, crossing)
        graph_from_json(block, form, where)
        return block

    def _declared(self, cls: type, form: Any, where: str) -> Any:
        fields = {"name", "kind", "width", "unit"}
        fields |= {"initial", "continuous"} if cls is State else set()
        fields |= {"value", "low", "high", "text", "tunable"} if cls is Param else set()
        if not isinstance(form, dict) or not set(form) <= fields:
            raise DiagramError(
                f"{form!r:.80} is no {cls.__name__.lower()}", where, f"it may have {', '.join(sorted(fields))}"
            )
        width = form.get("width")
        if width is not None and (type(width) is not int or width < 1):
            raise DiagramError(f"width {width!r:.40}", where, "give an integer from 1, or leave it out")
        self._count(width or 1, where)
        return _typed(cls, {k: _decode(v) for k, v in form.items()}, where)

    def _count(self, elements: int, where: str) -> None:
        self.elements += elements
        if self.elements > MAX_ELEMENTS:
            raise DiagramError(f"more than {MAX_ELEMENTS} values", where, "make arrays and delays shorter")


_FIELD_TYPES: dict[str, tuple[type, ...]] = {
    "name": (str,),
    "kind": (str,),
    "width": (int, type(None)),
    "unit": (str,),
    "text": (str,),
    "tunable": (bool,),
    "continuous": (bool,),
    "low": (int, float),
    "high": (int, float),
    "value": (bool, int, float, list),
    "initial": (bool, int, float, list, str),
}


def _typed(cls: type, fields: dict[str, Any], where: str) -> Any:
    for key, value in fields.items():
        if not isinstance(value, _FIELD_TYPES[key]):
            raise DiagramError(f"{key!r} is {value!r:.80}", where, "see docs/language.md, section 5")
    if "name" not in fields:
        raise DiagramError("a declaration has no name", where, "name it")
    return cls(**fields)
