"""SourceMap: from the lines of generated C to the blocks that they belong to."""

from dataclasses import dataclass, field

from twodof.compile.program.check import compiled
from twodof.compile.target import EmittedProgram


@dataclass(frozen=True)
class SourceLine:
    """A line of C: its number (from 1), the function or struct it stands in, and its block.

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
        return bool(self.text.strip(" {}")) and not self.text.lstrip().startswith("/*")


@dataclass
class SourceMap:
    """The C of one program, line by line, and its blocks."""

    lines: list[SourceLine]
    blocks: dict[str, str]  # path -> type
    left_out: tuple[str, ...] = ()  # blocks of which nothing runs
    _by_block: dict[str, list[SourceLine]] = field(default_factory=dict)

    def of(self, path: str) -> dict[str, list[tuple[int, int]]]:
        """Return the ranges of line numbers (first, last) that a block became, by function or struct."""
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


def source_map(emitted: EmittedProgram) -> SourceMap:
    """Return the map of the C file of `emitted`."""
    text = emitted.source.splitlines()
    lines = [
        SourceLine(number, line, mark.part, mark.block, mark.role)
        for number, (line, mark) in enumerate(zip(text, emitted.marks, strict=True), 1)
    ]
    nodes = emitted.flat.nodes
    needed = compiled(emitted.flat)
    kinds = {n.path: n.block.type_name or type(n.block).__name__ for n in nodes}
    return SourceMap(lines, kinds, tuple(path for path in kinds if path not in needed))
