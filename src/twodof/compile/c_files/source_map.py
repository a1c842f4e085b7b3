"""Whose line is whose: from the generated C back to the blocks, by the comments that stand above their lines."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

from twodof.compile.c.tick import DISABLED, FROZEN, INTEGRATION, NEXT_TICK, RATES_DUE, RETURNED
from twodof.compile.program.check import compiled
from twodof.compile.program.flat_program import FlatProgram, Node
from twodof.compile.program.layout import MemoryLayout

ROLES = {
    RATES_DUE: "rates",
    DISABLED: "disabled outputs",
    RETURNED: "returned signals",
    INTEGRATION: "integration",
    FROZEN: "disabled states",
    NEXT_TICK: "next tick",
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
_HEAD = re.compile(r"[\w ]*\bvoid (\w+)\(")
_COMMENT = re.compile(r"/\*.*?\*/")
_PATH = re.compile(r"/\* ([A-Za-z][\w.]*)(?:: \w+)?(?:; .*)? \*/")
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
    _by_block: dict[str, list[SourceLine]] = field(default_factory=dict)

    def of(self, path: str) -> dict[str, list[tuple[int, int]]]:
        """The ranges of line numbers (first, last) that a block became, by function or struct."""
        if not self._by_block:
            for line in self.lines:
                self._by_block.setdefault(line.block, []).append(line)
        found: dict[str, list[tuple[int, int]]] = {}
        for line in self._by_block.get(path, []):
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
    for part, first, last in _parts(text, program.name):
        owned = (
            _struct(text, first, last, part, members)
            if part[0].isupper()
            else _function(text, first, last, part, nodes)
        )
        for at, block, role in owned:
            default = _DEFAULT.search(text[at]) if part == "defaults" and not block else None
            if default:
                block = members.get(("P", default[1]), "")
                role = "" if block else role
            lines[at] = SourceLine(at + 1, text[at], part, block, role)
    needed = compiled(program)
    kinds = {path: n.block.type_name or type(n.block).__name__ for path, n in nodes.items()}
    return SourceMap(lines, kinds, tuple(path for path in nodes if path not in needed))


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
    inner = ("", _OF_FUNCTION.get(part, ""))
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
    named = _PATH.fullmatch(line)
    return (named[1], "") if named and named[1] in nodes else None
