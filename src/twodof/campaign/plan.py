"""Plan of a campaign, runs with seeds and parameters of the rig, and the file that keeps a row for each run.

A row is on the disk before the next one is written. So a campaign that was killed goes on behind its last whole row.
"""

import fcntl
import json
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from twodof.errors import ExperimentError, LogError, finite, is_number
from twodof.flightlog.atomic import refused_places, sync_folder

_TRIES = 1000
"""Draws of one member within its bounds before it is given up: bounds that keep a thousandth are a mistake."""


@dataclass(frozen=True)
class Run:
    """One run of a campaign: its `number` in the plan, the `seed` of its noise, and the `parameters` it changes.

    `case` names what is run, where a campaign has several.
    """

    number: int
    seed: int
    parameters: Mapping[str, float] = field(default_factory=dict)
    case: str = ""


def plan(
    seeds: Iterable[int], members: Sequence[Mapping[str, float]] = ({},), cases: Sequence[str] = ("",)
) -> tuple[Run, ...]:
    """Return the runs of each of the `cases`, one after the other, with the `seeds` and `members`.

    Members are sets of changed parameters. One member is that of all seeds. Otherwise each seed has a member of its
    own. Raises ExperimentError for a seed below 0 and for other numbers of members.
    """
    seeds = list(seeds)
    for seed in seeds:
        if not is_number(seed, 0, whole=True):
            raise ExperimentError(f"{seed!r:.80} is not a seed", "plan", "give whole numbers from 0 on")
    each = list(members) * len(seeds) if len(members) == 1 else list(members)
    if len(each) != len(seeds):
        what = f"{len(members)} sets of parameters for {len(seeds)} seeds"
        raise ExperimentError(what, "plan", "give one set for all seeds, or one for each")
    runs = ((case, int(seed), dict(one)) for case in cases for seed, one in zip(seeds, each, strict=True))
    return tuple(Run(i, seed, one, case) for i, (case, seed, one) in enumerate(runs))


def drawn(
    means: Mapping[str, float],
    covariance: ArrayLike,
    count: int,
    seed: int = 0,
    bounds: Mapping[str, tuple[float, float]] | None = None,
) -> list[dict[str, float]]:
    """Draw `count` members from a normal distribution with these `means` and this `covariance` (n, n).

    A member outside of its `bounds` (lower, upper) is drawn again. Each member has a generator of its own: a longer
    campaign begins with the members of a shorter one. Raises ExperimentError for a covariance that is none, and where
    almost no draw lies within the bounds.
    """
    names, centre = list(means), np.array(list(means.values()), dtype=np.float64)
    matrix = np.asarray(covariance, dtype=np.float64)
    if matrix.shape != (len(names), len(names)) or not np.isfinite(matrix).all() or not np.isfinite(centre).all():
        what = f"a covariance of shape {matrix.shape} for {len(names)} parameters"
        raise ExperimentError(what, "drawn", "give one finite row and column for each parameter")
    sizes, directions = np.linalg.eigh(matrix)
    if not np.allclose(matrix, matrix.T) or sizes.min(initial=0.0) < -1e-9 * sizes.max(initial=0.0):
        raise ExperimentError("the covariance is not symmetric and positive", "drawn", "check its signs")
    spread = directions * np.sqrt(np.maximum(sizes, 0.0))
    within = {**dict.fromkeys(names, (-math.inf, math.inf)), **(bounds or {})}
    low, high = (np.array([within[name][side] for name in names]) for side in (0, 1))
    members = []
    for i in range(count):
        generator = np.random.default_rng([seed, i])
        for _ in range(_TRIES):
            member = centre + spread @ generator.standard_normal(len(names))
            if (member >= low).all() and (member <= high).all():
                break
        else:
            raise ExperimentError(f"none of {_TRIES} draws is within the bounds", "drawn", "widen the bounds")
        members.append(dict(zip(names, member.tolist(), strict=True)))
    return members


Row = dict[str, Any]
"""Number, seed and parameters of a run, with its `figures` or the reason why it `failed`."""

MAX_ROW_BYTES = 1 << 14
"""Longest row. What comes back from a run are figures; signals stay where they were computed."""


def row_line(row: Mapping[str, Any]) -> bytes:
    """Return a row as its line in the file; NaN and infinity are null. Raises ExperimentError for a longer one."""
    try:
        line = json.dumps(finite(row), allow_nan=False).encode() + b"\n"
    except TypeError as reason:
        remedy = "return numbers, text, lists and dicts"
        raise ExperimentError(f"the figures of a run are not JSON: {reason}", "campaign", remedy) from reason
    if len(line) > MAX_ROW_BYTES:
        what = f"a row of {len(line)} bytes is too long"
        raise ExperimentError(what, "campaign", f"return figures, at most {MAX_ROW_BYTES} bytes, and no signals")
    return line


class RowFile:
    """Rows of one campaign in the file `path`, opened by one process at a time. A torn last row is dropped.

    `head` says which campaign it is. `rows` are those that the file has. Raises LogError for a file of another
    campaign, for one that is open elsewhere, and where the file system refuses.
    """

    def __init__(self, path: str | Path, head: Mapping[str, Any]) -> None:
        self.path = Path(path)
        with refused_places(path):
            self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        try:
            self.rows: list[Row] = self._resumed(row_line(head))
        except BaseException:
            os.close(self._descriptor)
            raise

    def _resumed(self, head: bytes) -> list[Row]:
        """Lock the file, cut off a torn row, and return its rows; begin a new file."""
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as refusal:
            what = "another campaign is writing this file"
            raise LogError(what, str(self.path), "wait for its end, or name another file") from refusal
        with open(self._descriptor, "rb", closefd=False) as file:
            data = file.read()
        whole = data[: data.rfind(b"\n") + 1]
        if not whole and head.startswith(data):  # new, or killed while it was begun
            self._cut(0)
            self._write(head)
            sync_folder(self.path.resolve().parent)
            return []
        first, *lines = whole.splitlines() or [b""]
        if first + b"\n" != head:
            what = "is the file of another campaign, or of another version of twodof"
            raise LogError(what, str(self.path), "name another file, or replace it with --force")
        rows = []
        for number, line in enumerate(lines):
            try:
                row = json.loads(line)
            except ValueError:
                row = None
            if not isinstance(row, dict) or row.get("run") != number:
                raise LogError(f"line {number + 2} is not the row of run {number}", str(self.path), "replace the file")
            rows.append(row)
        self._cut(len(whole))
        return rows

    def append(self, line: bytes) -> None:
        """Write one row; on return it is on the disk. Raises LogError where the file system refuses."""
        self._write(line)
        self.rows.append(json.loads(line))

    def _cut(self, size: int) -> None:
        os.ftruncate(self._descriptor, size)
        os.lseek(self._descriptor, size, os.SEEK_SET)

    def _write(self, line: bytes) -> None:
        try:
            while line:
                line = line[os.write(self._descriptor, line) :]
            os.fsync(self._descriptor)
        except OSError as refusal:
            what = f"cannot be written: {refusal.strerror}"
            raise LogError(what, str(self.path), "make room, then start the campaign again: it goes on") from refusal

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._descriptor)
