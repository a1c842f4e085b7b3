"""What the processor says of a fault: the registers that the exception stored, and the bits of its status registers."""

from __future__ import annotations

import struct
from dataclasses import dataclass

WORDS = 14
# Armv7-M Architecture Reference Manual (DDI 0403E), B3.2.15: Configurable Fault Status Register.
_CAUSES = {
    0: "instruction fetched where none may be",
    1: "access to where nothing is, or write into code",
    4: "stack without memory on entry to the exception",
    8: "instruction fetched from where no memory is",
    9: "access to where no memory is",
    10: "access to where no memory is",
    12: "stack without memory on entry to the exception",
    16: "undefined instruction",
    17: "state that instructions cannot have (a jump to an even address)",
    18: "wrong return from an exception",
    19: "floating-point unit that is off",
    24: "unaligned access",
    25: "division of integers by zero",
}
_MMFAR_VALID, _BFAR_VALID = 7, 15


@dataclass(frozen=True)
class ProcessorFault:
    """Registers of the instruction that faulted (0 where the stack was lost), and what the processor says of it."""

    r0: int
    r1: int
    r2: int
    r3: int
    r12: int
    lr: int
    pc: int
    xpsr: int
    sp: int
    exc_return: int
    cfsr: int
    hfsr: int
    mmfar: int
    bfar: int

    @classmethod
    def from_bytes(cls, data: bytes) -> ProcessorFault:
        """From the words that `report_fault` of boot.c sends. Raises struct.error for another number of them."""
        return cls(*struct.unpack(f"<{WORDS}I", data))

    @property
    def cause(self) -> str:
        """In words, with the address that was accessed if the processor knows it."""
        causes = [text for bit, text in _CAUSES.items() if self.cfsr >> bit & 1]
        address = self.mmfar if self.cfsr >> _MMFAR_VALID & 1 else self.bfar if self.cfsr >> _BFAR_VALID & 1 else None
        at = "" if address is None else f" at 0x{address:08x}"
        return (" and ".join(dict.fromkeys(causes)) or "fault of unknown cause") + at

    def registers(self) -> str:
        """All of them, in hexadecimal."""
        return " ".join(f"{name}={value:08x}" for name, value in vars(self).items())
