"""Errors that twodof raises: each names the mistake, its place and the remedy."""

from __future__ import annotations

import reprlib
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from enum import IntEnum
from itertools import islice
from math import isfinite
from numbers import Integral, Real
from sys import float_info
from typing import Any

_SHORT = reprlib.Repr()
_COMPARED = 1000  # names, in a third of a second; of more, those that begin alike
_SHORT.maxlevel, _SHORT.maxstring, _SHORT.maxother, _SHORT.maxlong = 3, 80, 80, 40


def shown(value: object) -> str:
    """Return `value` as short text for a message, however large, deep or hostile it is."""
    return _SHORT.repr(value)[:120]


def listed(names: Iterable[str], most: int = 20) -> str:
    """Join the first of `names` by commas and add the number of the others; "none" without any."""
    rest = iter(names)
    rows = list(islice(rest, most))
    more = sum(1 for _ in rest)
    return ", ".join(rows) + (f" and {more} more" if more else "") if rows else "none"


def nearest(name: object, known: Iterable[str], most: int = 20) -> str:
    """List the `known` names for an error about an unknown `name`, the most similar ones first."""
    names, given = list(known), str(name)[:200].casefold()
    compared = names if len(names) <= _COMPARED else [one for one in names if one[:2].casefold() == given[:2]]
    folded: dict[str, list[str]] = {}
    for one in compared[:_COMPARED]:
        folded.setdefault(one.casefold(), []).append(one)
    like = get_close_matches(given, folded, n=5)
    return listed(dict.fromkeys([*(one for key in like for one in folded[key]), *names]), most)


def outside(value: float, low: float, high: float, unit: str = "") -> str:
    """Describe a value outside its bounds. Integers are written with all digits."""
    given, least, most = (str(n) if isinstance(n, int) else f"{n:g}" for n in (value, low, high))
    return f"{given} is outside {least} to {most} {unit}".rstrip()


def is_number(value: Any, low: float = -float_info.max, high: float = float_info.max, whole: bool = False) -> bool:
    """Return True for a real number, or with `whole` an integer, from `low` to `high`: by default a finite one.

    A flag is not a number.
    """
    is_of_kind = isinstance(value, Integral if whole else Real) and not isinstance(value, bool)
    return is_of_kind and bool(low <= value <= high)


def finite(value: Any) -> Any:
    """Return a value as JSON holds it: None for NaN and infinity, lists for numpy's arrays, text for keys."""
    if isinstance(value, Mapping):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if hasattr(value, "tolist"):
        return finite(value.tolist())
    return None if isinstance(value, float) and not isfinite(value) else value


def printable(text: object) -> str:
    """Replace control characters in text from a file or the wire; keep line breaks."""
    return "".join(c if c.isprintable() or c == "\n" else " " for c in str(text))


class TwodofError(Exception):
    """Base of every error that a caller of twodof can meet.

    `what` is the fact, `where` the place: a file, channel, block path or parameter. `remedy` says what to do about it.
    """

    def __init__(self, what: str, where: str = "", remedy: str = "") -> None:
        self.what = what
        self.where = where
        self.remedy = remedy
        super().__init__(what, where, remedy)

    def __str__(self) -> str:
        text = f"{self.where}: {self.what}" if self.where else self.what
        # Names in it may come from a file, and a traceback goes to a terminal too.
        return printable(f"{text} ({self.remedy})" if self.remedy else text)


class DiagramError(TwodofError):
    """A diagram or block cannot be built, checked, traced or loaded; `where` is the whole block path."""


class CompileError(TwodofError):
    """A tool chain is missing or refused what was generated."""


class ControllerFault(TwodofError):
    """A compiled program was stopped while it ran: out of fuel or memory, or a fault of the processor."""


class LogError(TwodofError):
    """A flight log cannot be read, lacks what was asked for, or would be written wrongly."""


class RecordingError(LogError):
    """A recording cannot go on because its disk is full or does not answer; all acknowledged data is in its file."""


class DownloadError(LogError):
    """A public log is not stored on this computer and cannot be downloaded now."""


class IdentificationError(TwodofError):
    """The data or the model structure do not allow the estimate that was asked for."""


class ParameterError(TwodofError):
    """A parameter is unknown or its value is outside its bounds or of the wrong type."""


class ExperimentError(TwodofError):
    """An experiment cannot be flown as asked: it does not fit the rig or is malformed."""


class LinkError(TwodofError):
    """A link cannot be opened or used as asked: a malformed URL, a message that does not encode, an unsafe key."""


class LinkLost(LinkError):
    """The other side of a link is gone, or the link was closed."""


class RefusalReason(IntEnum):
    """Reason code of a refusal, as the drone sends it (TWODOF_REFUSAL in the dialect): programs decide by it."""

    OTHER = 0
    LEASE = 1
    ARMED = 2
    RINGS = 3
    INVALID = 4
    QUEUE = 5
    NOTHING = 6

    @classmethod
    def of(cls, number: int) -> RefusalReason:
        """Return the code with this number; OTHER for one that a newer drone sends."""
        return next((code for code in cls if code == number), cls.OTHER)


class Rejected(TwodofError):
    """The drone received a command and refused it. `reason` is its text for people, `code` its reason for programs."""

    def __init__(self, what: str, where: str = "", remedy: str = "", code: RefusalReason = RefusalReason.OTHER) -> None:
        super().__init__(what, where, remedy)
        self.code = code

    @property
    def reason(self) -> str:
        """Reason for the refusal, in the drone's words where it gave any."""
        return self.what


class Timeout(TwodofError, TimeoutError):
    """A call's deadline passed before the drone answered or the awaited state was reached."""
