"""Object files and images in the Executable and Linkable Format: sections, symbols and what refers to what."""

import struct
from dataclasses import dataclass, field

from twodof.errors import CompileError

# System V ABI, chapter 4, "Object Files"; 32 bits, little-endian.
_HEADER = struct.Struct("<16sHHIIIIIHHHHHH")
_SECTION = struct.Struct("<10I")
_SYMBOL = struct.Struct("<IIIBBH")
_RELOCATION = struct.Struct("<II")
SYMTAB, RELA, NOBITS, REL = 2, 4, 8, 9
WRITE, ALLOC, EXECUTE = 1, 2, 4
FUNCTION = 2
CALL = 10  # R_ARM_THM_CALL
_FIRST_RESERVED = 0xFF00
_ARM = 40


@dataclass
class ElfSection:
    """`refers` has the indices of the symbols that its relocations name, `calls` those of them that it calls."""

    name: str
    kind: int
    flags: int
    data: bytes
    size: int
    link: int
    refers: set[int] = field(default_factory=set)
    calls: set[int] = field(default_factory=set)

    @property
    def loaded(self) -> bool:
        """Whether it takes memory of the target."""
        return bool(self.flags & ALLOC) and self.size > 0

    @property
    def use(self) -> str:
        """Which memory: "text", "rodata", "data" (in flash and RAM) or "bss" (in RAM)."""
        if self.kind == NOBITS:
            return "bss"
        if self.flags & EXECUTE:
            return "text"
        return "data" if self.flags & WRITE else "rodata"


@dataclass(frozen=True)
class ElfSymbol:
    """`section` is the index of the section that has it, 0 if another file has it, or 0xff00 and more."""

    name: str
    value: int
    kind: int
    local: bool
    section: int


@dataclass(frozen=True)
class Elf:
    """The sections and symbols of a file, by index."""

    sections: list[ElfSection]
    symbols: list[ElfSymbol]

    def globals(self) -> dict[str, int]:
        """The sections of the symbols that other files can name."""
        return {s.name: s.section for s in self.symbols if not s.local and 0 < s.section < _FIRST_RESERVED}


def read_elf(data: bytes, where: str = "object file") -> Elf:
    """The file with the bytes `data`. Raises CompileError if they are no ELF file for Arm, or broken."""
    try:
        return _read(data)
    except (struct.error, IndexError, ValueError) as error:
        raise CompileError(f"no readable ELF file: {error}", where, "check that the compiler works") from error


def _read(data: bytes) -> Elf:
    ident, _, machine, _, _, _, start, _, _, _, _, entry, count, names = _HEADER.unpack_from(data)
    if ident[:6] != b"\x7fELF\x01\x01" or machine != _ARM or entry != _SECTION.size:
        raise ValueError("another kind of file")
    rows = [_SECTION.unpack_from(data, start + entry * i) for i in range(count)]

    def content(row: tuple[int, ...]) -> bytes:
        return b"" if row[1] == NOBITS else data[row[4] : row[4] + row[5]]

    titles = content(rows[names])
    sections = [ElfSection(_text(titles, r[0]), r[1], r[2], content(r), r[5], r[6]) for r in rows]
    symbols: list[ElfSymbol] = []
    for section in sections:
        if section.kind == SYMTAB:
            strings = sections[section.link].data
            for name, value, _, info, _, index in _SYMBOL.iter_unpack(section.data):
                symbols.append(ElfSymbol(_text(strings, name), value, info & 15, info >> 4 == 0, index))
    for row, section in zip(rows, sections, strict=True):
        if section.kind == REL:
            named = [(info >> 8, info & 255) for _, info in _RELOCATION.iter_unpack(section.data)]
            sections[row[7]].refers |= {symbol for symbol, _ in named}
            sections[row[7]].calls |= {symbol for symbol, kind in named if kind == CALL}
        elif section.kind == RELA:
            raise ValueError("relocations with addends")
    return Elf(sections, symbols)


def _text(strings: bytes, at: int) -> str:
    return strings[at : strings.index(b"\0", at)].decode("utf-8", "replace")
