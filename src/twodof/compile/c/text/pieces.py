"""Long functions in pieces, for a compiler needs a time that grows with the square of a function's length.

The text is as the emitter writes it: a statement a line, a comment above what belongs together, and a name that is used
once in a function. What one piece declares and another one reads stands in a struct that the pieces hand on.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass

LONGEST = 2000  # lines of a function that stays whole
PIECE = 400  # lines of a piece, about

_FUNCTION = re.compile(
    r"(?m)^(?P<head>[^\n]*\bvoid (?P<name>\w+)\((?P<arguments>[^\n]*)\))\n\{\n(?P<body>(?:(?!\}\n)[^\n]*\n)*)\}\n"
)
_DECLARED = re.compile(
    r"    (?P<const>const )?(?P<type>\w+) (?P<star>\*const )?(?P<name>\w+)(?P<size>\[\w+\])?(?P<value> = .*)?;"
)
_WORD = re.compile(r"/\*.*?\*/|(?<![\w>.])[A-Za-z_]\w*")  # a comment, or a name that is no member's
PIECES = "/* what it does, in pieces */"
_ARGUMENT = re.compile(r"\w+$")


@dataclass(frozen=True)
class _Local:
    """A variable that stands in the function's outermost block."""

    piece: int
    const: bool
    type: str
    star: bool
    size: str
    value: str

    @property
    def stays(self) -> bool:
        """Whether it stays where it is declared, and others read a copy: it cannot change."""
        return self.const and not self.star

    def member(self, name: str) -> str:
        """Its line in the struct that is handed on."""
        if self.star:
            return f"    {'const ' if self.const else ''}{self.type} *{name};"
        return f"    {self.type} {name}{self.size};"


def in_pieces(text: str) -> tuple[str, int]:
    """`text` with its long functions in pieces, and how many variables are handed on."""
    handed = 0

    def cut(match: re.Match[str]) -> str:
        nonlocal handed
        body = match["body"].splitlines()
        if len(body) <= LONGEST:
            return match[0]
        made, count = _cut(match["head"], match["name"], match["arguments"], _parts(body))
        handed += count
        return made

    return _FUNCTION.sub(cut, text), handed


@dataclass(frozen=True)
class _Part:
    """What a function does one after another: its pieces, under a condition (a line of C, "" for none)."""

    condition: str
    pieces: list[list[str]]


def _parts(body: Sequence[str]) -> list[_Part]:
    """A function's body; what a long `if` holds is in pieces of its own."""
    parts, start, at = [], 0, 0
    while at < len(body):
        if body[at].startswith("    if ("):
            end = body.index("    }", at)
            if end - at > PIECE:
                parts += [_Part("", _divided(body[start:at]))] if at > start else []
                above = [body[at - 1]] if at > start and body[at - 1].startswith("    /*") else []
                inside = [line[4:] for line in body[at + 1 : end]]
                parts.append(_Part(body[at], _divided([*above, *inside])))
                start = end + 1
            at = end
        at += 1
    return [*parts, _Part("", _divided(body[start:]))] if start < len(body) else parts


def _divided(body: Sequence[str]) -> list[list[str]]:
    """The lines of each piece: a piece begins with a comment of the outermost block."""
    pieces: list[list[str]] = [[]]
    for line in body:
        if len(pieces[-1]) >= PIECE and line.startswith("    /*"):
            pieces.append([])
        pieces[-1].append(line)
    return pieces


def _cut(head: str, name: str, arguments: str, parts: Sequence[_Part]) -> tuple[str, int]:
    """The C of the struct, the pieces and the function that calls them, and the number of the struct's members."""
    pieces = [piece for part in parts for piece in part.pieces]
    found = _locals(pieces)
    handed = _handed(pieces, found, [part.condition for part in parts])
    words = {word for piece in pieces for line in piece for word in _WORD.findall(line)}
    work = "work"
    while work in words:
        work += "_"
    kind, text, calls = f"{name}_Work", "", f"    {PIECES}\n"
    more, passed = (f", {kind} *restrict {work}", f", &{work}") if handed else ("", "")
    if handed:
        members = "\n".join(local.member(v) for v, local in found.items() if v in handed)
        text = f"typedef struct {{ /* what the pieces of {name} hand on */\n{members}\n}} {kind};\n\n"
        calls += f"    {kind} {work};\n"
    own = ", ".join(_argument(a) for a in arguments.split(", "))
    number = 0
    for part in parts:
        indent = "    "
        if part.condition:
            calls += _moved(part.condition, -1, found, handed, f"{work}.")[0] + "\n"
            indent = "        "
        for lines in part.pieces:
            moved = [new for line in lines for new in _moved(line, number, found, handed, f"{work}->")]
            number += 1
            text += "\n".join([f"td_apart void {name}_{number}({arguments}{more})", "{", *moved, "}", "", ""])
            calls += f"{indent}{name}_{number}({own}{passed});\n"
        calls += "    }\n" if part.condition else ""
    return f"{text}{head}\n{{\n{calls}}}\n", len(handed)


def _argument(declared: str) -> str:
    match = _ARGUMENT.search(declared)
    return match[0] if match else declared


def _locals(pieces: Sequence[Sequence[str]]) -> dict[str, _Local]:
    found = {}
    for number, lines in enumerate(pieces):
        for line in lines:
            if m := _DECLARED.fullmatch(line):
                value = (m["value"] or "").removeprefix(" = ")
                found[m["name"]] = _Local(number, bool(m["const"]), m["type"], bool(m["star"]), m["size"] or "", value)
    return found


def _handed(pieces: Sequence[Sequence[str]], found: dict[str, _Local], conditions: Sequence[str]) -> set[str]:
    """The variables that another piece or a condition reads, and those that they point to."""
    places = [*enumerate(pieces), (-1, conditions)]
    read = ((number, word) for number, lines in places for line in lines for word in _WORD.findall(line))
    handed = {word for number, word in read if word in found and found[word].piece != number}
    ends = [v for v in handed if found[v].star]
    while ends:
        pointed = {word for word in _WORD.findall(found[ends.pop()].value) if word in found} - handed
        handed |= pointed
        ends += [v for v in pointed if found[v].star]
    return handed


def _moved(line: str, piece: int, found: dict[str, _Local], handed: set[str], work: str) -> list[str]:
    """The lines that a line of a piece becomes: what is handed on is read from the struct, and written there."""
    declared = _DECLARED.fullmatch(line)
    name = declared["name"] if declared and declared["name"] in handed else ""

    def place(match: re.Match[str]) -> str:
        word = match[0]
        if word not in handed:
            return word
        # What is pointed to must outlive the piece.
        stays = found[word].stays and found[word].piece == piece and not (name and found[name].star)
        return word if stays else f"{work}{word}"

    if declared is None or not name:
        return [_WORD.sub(place, line)]
    value = _WORD.sub(place, (declared["value"] or "").removeprefix(" = "))
    if found[name].stays:
        copy = f"(void)memcpy({work}{name}, {name}, sizeof {name});" if found[name].size else f"{work}{name} = {name};"
        return [f"{line[: declared.start('value')]} = {value};", f"    {copy}"]
    return [f"    {work}{name} = {value};"] if value else []
