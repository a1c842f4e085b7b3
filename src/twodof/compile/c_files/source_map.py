"""Whose line is whose: from the generated C back to the blocks, by the comments that stand above their lines."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from twodof.compile.c.text.pieces import PIECES
from twodof.compile.c.tick import DISABLED, FROZEN, INTEGRATION, NEXT_TICK, RATES_DUE, RETURNED
from twodof.compile.program.check import compiled
from twodof.compile.program.flat_program import FlatProgram, Node
from twodof.compile.program.layout import BlockKindLayout, MemoryLayout

ROLES = {
    RATES_DUE: "rates",
    DISABLED: "disabled outputs",
    RETURNED: "returned signals",
    INTEGRATION: "integration",
    FROZEN: "disabled states",
    NEXT_TICK: "next tick",
    PIECES: "pieces",
}
"""The comments above lines of no single block, and what these lines are for."""

_OF_FUNCTION = {
    "defaults": "default parameters",
    "init": "initial states",
    "along": "integration",
    "integrate": "integration",
    "step": "one step",
    "run": "many steps",
}
SHARED = "shared by copies"
_HEAD = re.compile(r"(?:td_(?:apart|shared) \w+|[\w ]*\bvoid) (\w+)\(")
_EACH = re.compile(r"/\* each of \d+: \w+ \*/")
_PIECE = re.compile(r"(defaults|prepare|init|derivative|step|advance)_\d+")
_COMMENT = re.compile(r"/\*.*?\*/")
_PATH = re.compile(r"/\* ([A-Za-z][\w.]*)(?:: \w+)?(?:; .*)? \*/")
_ROW = re.compile(r"}, /\* ([\w.]+)(?:: \w+)? \*/$")
_DEFAULT = re.compile(r"\bp->(\w+)")
_IDLE = re.compile(r"\(void\)\w+;")
_MEMBER = re.compile(r"(\w+)(?:\[\d+\])?;")


@dataclass(frozen=True)
class SourceLine:
    """A line of C: its number (from 1), the function or struct it stands in, and whose it is.

    `block` is a path, or "" for a line of no single block, whose `role` then says what it is for ("" if unknown).
    """

    number: int
    text: str
    part: str
    block: str
    role: str

    @property
    def executable(self) -> bool:
        """Whether it is more than braces and comments."""
        return bool(_COMMENT.sub("", self.text).strip(" {}"))


@dataclass
class SourceMap:
    """The C of one program, line by line, and its blocks."""

    lines: list[SourceLine]
    blocks: dict[str, str]  # path -> type
    left_out: tuple[str, ...] = ()  # blocks of which nothing runs
    kinds: dict[str, str] = field(default_factory=dict)  # path of a copy -> its kind: `part` is then `kind.function`
    _by_block: dict[str, list[SourceLine]] = field(default_factory=dict)

    def of(self, path: str) -> dict[str, list[tuple[int, int]]]:
        """The ranges of line numbers (first, last) that a block became, by function or struct; also what it shares."""
        if not self._by_block:
            for line in self.lines:
                kind, dot, _ = line.part.partition(".")
                self._by_block.setdefault(f".{kind}" if dot else line.block, []).append(line)
        found: dict[str, list[tuple[int, int]]] = {}
        shared = self._by_block.get(f".{self.kinds[path]}", []) if path in self.kinds else []
        for line in [*shared, *self._by_block.get(path, [])]:
            ranges = found.setdefault(line.part, [])
            if ranges and ranges[-1][1] == line.number - 1:
                ranges[-1] = ranges[-1][0], line.number
            else:
                ranges.append((line.number, line.number))
        return found


def source_map(program: FlatProgram, source: str, layout: MemoryLayout) -> SourceMap:
    """The map of `program`'s part of the C file `source`."""
    nodes = {n.path: n for n in program.nodes}
    text = source.splitlines()
    lines = [SourceLine(i + 1, t, "", "", "") for i, t in enumerate(text)]
    members = _members(program, layout)
    shared = {k.prefix.removeprefix(f"{program.name}_"): k for k in layout.block_kinds}
    for name, first, last in _parts(text, program.name):
        kind, function = _shared(name, shared)
        piece = _PIECE.fullmatch(name)
        work = name.endswith("_Work")
        part = f"{kind}.{function}" if kind else piece[1] if piece else "Work" if work else name
        owned = (
            _struct(text, first, last, part, members)
            if text[first].startswith("typedef")
            else _function(text, first, last, part, nodes)
        )
        for at, block, role in owned:
            default = (_DEFAULT.search(text[at]) or _ROW.search(text[at])) if part == "defaults" and not block else None
            if default:
                block = members.get(("P", default[1]), default[1] if default[1] in nodes else "")
                role = "" if block else role
            lines[at] = SourceLine(at + 1, text[at], part, block, role)
    needed = compiled(program)
    kinds = {path: n.block.type_name or type(n.block).__name__ for path, n in nodes.items()}
    copies = {n.path: k.name for n, (k, _) in layout.of.items()}
    return SourceMap(lines, kinds, tuple(path for path in nodes if path not in needed), copies)


def _parts(text: list[str], name: str) -> Iterator[tuple[str, int, int]]:
    """The structs and functions of a program: (name without its prefix, first line, last line)."""
    start, prefix = -1, f"{name}_"
    for i, line in enumerate(text):
        if line.startswith("typedef struct {") or (line == "{" and i and _HEAD.match(text[i - 1])):
            start = i
        elif start >= 0 and line.startswith("}"):
            head = _HEAD.match(text[start - 1]) if line == "}" else re.match(r"} (\w+);", line)
            if head and head[1].startswith(prefix):
                part = head[1].removeprefix(prefix)
                yield "step" if part == "advance" else part, start - (line == "}"), i
            start = -1


def _shared(name: str, kinds: Mapping[str, BlockKindLayout]) -> tuple[str, str]:
    """The kind that shares a struct or function, and its name without the kind's; a number may end it."""
    stem = name.rpartition("_")[0]
    for begin in (stem, stem.rpartition("_")[0]):
        if begin in kinds:
            return kinds[begin].name, name.removeprefix(f"{begin}_")
    return "", name


def _members(program: FlatProgram, layout: MemoryLayout) -> dict[tuple[str, str], str]:
    """(struct, member) -> the block that it belongs to."""
    found: dict[tuple[str, str], str] = {}
    for node in program.nodes:
        for parameter in node.parameters.values():
            if parameter.path.startswith(f"{node.path}."):
                found["P", layout.parameters[parameter].name] = node.path
        for o in node.block.derived:
            found["P", layout.derived[node, o.name].name] = node.path
        for s in node.block.states:
            found["X" if s.continuous else "S", layout.states[node, s.name].name] = node.path
        for signal in node.outputs.values():
            if signal in layout.stored:
                found["S", layout.stored[signal].name] = node.path
    return found


def _struct(
    text: list[str], first: int, last: int, part: str, members: dict[tuple[str, str], str]
) -> Iterator[tuple[int, str, str]]:
    for at in range(first, last + 1):
        named = _MEMBER.search(_COMMENT.sub("", text[at]))
        block = members.get((part, named[1]), "") if named and at not in (first, last) else ""
        yield at, block, "" if block else "declaration"


def _function(
    text: list[str], first: int, last: int, part: str, nodes: dict[str, Node]
) -> Iterator[tuple[int, str, str]]:
    """Whose each line is: that of the last comment at its depth, or further out."""
    inner = ("", SHARED if "." in part else _OF_FUNCTION.get(part, ""))
    owners = [inner]  # by depth of braces
    opened: list[tuple[tuple[str, str], bool]] = []  # of each open brace: whose, and whether it is a condition
    yield first, "", "head"
    yield first + 1, "", "head"
    for at in range(first + 2, last):
        line = text[at].strip()
        code = _COMMENT.sub("", line)
        if not code.strip() and line:
            owners[-1] = _named(line, nodes) or owners[-1]
            yield at, *owners[-1]
            continue
        if code.startswith("} else"):
            yield at, *opened[-1][0]
            continue
        if code.startswith("}"):
            owners.pop()
            owner, condition = opened.pop()
            if condition:
                owners[-1] = inner
            if code.endswith("{"):  # else
                opened.append((owner, condition))
                owners.append(owner)
            yield at, *owner
            continue
        if _IDLE.fullmatch(code):
            yield at, "", "unused argument"
            continue
        if code.count("{") > code.count("}"):
            following = _named(text[at + 1].strip(), nodes)
            condition = following is not None and bool(following[0])
            owner = ("", "condition") if condition else owners[-1]
            opened.append((owner, condition))
            owners.append(owner)
            yield at, *owner
            continue
        yield at, *owners[-1]
    yield last, "", "head"


def _named(line: str, nodes: dict[str, Node]) -> tuple[str, str] | None:
    """The block or the role that a comment names."""
    if line in ROLES:
        return "", ROLES[line]
    if _EACH.fullmatch(line):
        return "", SHARED
    named = _PATH.fullmatch(line)
    return (named[1], "") if named and named[1] in nodes else None
