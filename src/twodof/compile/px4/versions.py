"""The PX4 versions that a module is for, and what is known of each."""

from __future__ import annotations

import re
from dataclasses import dataclass

# The release a module was built and flown with, and those whose sources it was compared with only.
TESTED = "v1.16.1"
READ = ("v1.14.4", "v1.15.4", "v1.17.0-alpha1")
FIRST, LAST = (1, 14), (1, 17)

_TAG = re.compile(r"v?(\d{1,3})\.(\d{1,3})(?:\.(\d{1,3}))?(?:-([0-9A-Za-z.-]+))?")


@dataclass(frozen=True)
class Version:
    """A PX4 version: its numbers, and what stands behind them ("rc2", "123-gabcdef", "")."""

    major: int
    minor: int
    patch: int
    rest: str = ""

    def __str__(self) -> str:
        return f"v{self.major}.{self.minor}.{self.patch}{'-' + self.rest if self.rest else ''}"

    @property
    def supported(self) -> bool:
        """Whether modules are made for it."""
        return FIRST <= (self.major, self.minor) <= LAST

    @property
    def tested(self) -> bool:
        """Whether modules were built and flown with its minor release."""
        return str(self).startswith(TESTED.rpartition(".")[0] + ".")


def parse_version(text: str) -> Version | None:
    """The version that a tag, `git describe` or a version file says, or None."""
    found = _TAG.fullmatch(text.strip())
    if not found:
        return None
    major, minor, patch, rest = found.groups()
    return Version(int(major), int(minor), int(patch or 0), rest or "")
