"""Content of a report, as plain data: `characterisation` fills it in, `report_page` lays it out."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from twodof.identify.estimate import Estimate

Array = NDArray[np.float64]
# Each role of a line has its own colour and stroke, the same in every figure.
LineRole = Literal["measured", "input", "set-point", "simple", "grey-box"]


@dataclass(frozen=True)
class Uncertain:
    """A value with its standard deviation; `sigma` is NaN where the method gives none."""

    value: float
    sigma: float = math.nan


@dataclass(frozen=True)
class ParameterRow:
    """One line of Table 1: the paper's values, the truth (of a virtual rig), and the estimates.

    `symbol` may hold HTML (a subscript); `paper` is the paper's method by hand, `paper_greybox` its "greyest".
    `greybox_spread` is the standard deviation of the grey-box estimate among repeated flights.
    """

    key: str
    symbol: str
    text: str
    unit: str
    paper: float | None = None
    paper_greybox: float | None = None
    truth: float | None = None
    simple: Uncertain | None = None
    greybox: Uncertain | None = None
    greybox_spread: float | None = None

    @property
    def greybox_sigma(self) -> float:
        """Return the larger of the grey-box estimate's sigma and the spread; NaN without an estimate."""
        own = math.nan if self.greybox is None else self.greybox.sigma
        return own if self.greybox_spread is None else max(own, self.greybox_spread)

    @property
    def greybox_error(self) -> float:
        """Return the relative error of the grey-box estimate; NaN if one is missing or the truth is 0."""
        return abs(self.greybox.value / self.truth - 1.0) if self.greybox and self.truth else math.nan

    @property
    def greybox_sigmas(self) -> float:
        """Return the error of the grey-box estimate in `greybox_sigma`; NaN if one is missing."""
        if self.greybox is None or self.truth is None:
            return math.nan
        return abs(self.greybox.value - self.truth) / self.greybox_sigma


@dataclass(frozen=True, eq=False)
class FigureLine:
    """A curve: `time` [s] and `value`, both of shape (n,)."""

    role: LineRole
    time: Array
    value: Array


@dataclass(frozen=True)
class Span:
    """A labelled stretch of time [s]."""

    start: float
    stop: float
    label: str


@dataclass(frozen=True)
class FigureBand:
    """A horizontal band from `low` to `high` in the panel's unit (equal: a line)."""

    low: float
    high: float
    label: str


@dataclass(frozen=True)
class FigurePoint:
    """A labelled point of a curve."""

    time: float
    value: float
    label: str


@dataclass(frozen=True, eq=False)
class Panel:
    """One pair of axes; `label` names the quantity and its unit. `limits` are those of the vertical axis, if given."""

    label: str
    lines: Sequence[FigureLine]
    marks: Sequence[Span | FigureBand | FigurePoint] = ()
    height: float = 1.0
    limits: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class Figure:
    """One of the paper's figures, redrawn: panels above one another over one time axis [s], or a `picture` (SVG)."""

    number: int
    title: str
    caption: str
    panels: Sequence[Panel] = ()
    picture: str = ""


@dataclass(frozen=True, eq=False)
class Subject:
    """One machine, virtual or real, and all results about it; `fits` are its grey-box fits by experiment."""

    name: str
    text: str
    rows: Sequence[ParameterRow]
    figures: Sequence[Figure] = ()
    fits: Mapping[str, "Estimate"] = field(default_factory=dict)
    doubts: Sequence[str] = ()


@dataclass(frozen=True)
class ReportTable:
    """A table of its own section: `anchor` for links, a paragraph (HTML), heads and rows of text.

    The first column of a row is its name.
    """

    anchor: str
    title: str
    text: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True, eq=False)
class Content:
    """The whole report.

    `errata` are the paper's: place, printed text and finding of each. `provenance` lists versions, seeds and files, so
    that the run can be repeated.
    """

    title: str
    lead: str
    findings: Sequence[str]
    subjects: Sequence[Subject]
    errata: Sequence[tuple[str, str, str]] = ()
    tables: Sequence[ReportTable] = ()
    provenance: Mapping[str, str] = field(default_factory=dict)
