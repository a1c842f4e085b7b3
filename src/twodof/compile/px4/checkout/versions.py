"""The PX4 versions that a module is for, and what is known of each."""

import re
from dataclasses import dataclass

# With what the starters' modules were built, some of them flown, and with what they were compiled only.
TESTED = "v1.16.1"
COMPILED = ("v1.14.4", "v1.15.4", "v1.17.0-beta1", "main of 2026-06-06 (8ae02ec4)")
FIRST, LAST = (1, 14), (1, 17)

_SINCE = re.compile(r"(?:^|-)(\d{1,7})-g[0-9a-f]+$")
_TAG = re.compile(r"v?(\d{1,3})\.(\d{1,3})(?:\.(\d{1,3}))?(?:-([0-9A-Za-z.-]+))?")


@dataclass(frozen=True)
class Px4Version:
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
        return (self.major, self.minor) == (1, 16)

    @property
    def commits(self) -> int:
        """How many commits `git describe` counts since the tag."""
        found = _SINCE.search(self.rest)
        return int(found[1]) if found else 0


def parse_version(text: str) -> Px4Version | None:
    """The version that a tag, `git describe` or a version file says, or None."""
    found = _TAG.fullmatch(text.strip())
    if not found:
        return None
    major, minor, patch, rest = found.groups()
    return Px4Version(int(major), int(minor), int(patch or 0), rest or "")
