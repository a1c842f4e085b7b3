"""The screen of `twodof watch`: for each drone how it stands and four small charts, and below what they said."""

from __future__ import annotations

import time
from collections.abc import Sequence
from math import ceil, degrees, isfinite
from typing import NamedTuple

import numpy as np
from rich.text import Text

from twodof.cli.watch.block_chart import FAINT, SET_POINT, bound, chart
from twodof.cli.watch.reading import followed, since
from twodof.cli.watch.watched_drone import WatchedDrone
from twodof.errors import printable
from twodof.fleet.local_drone import controller_in_words


class _Row(NamedTuple):
    """A chart: what it shows, in which unit, and the limits that it may have."""

    name: str
    measured: str
    wanted: str
    scale: float
    unit: str
    digits: int
    ladder: tuple[float, ...]


_DEGREE = degrees(1.0)
_ROWS = (
    _Row("theta", "estimate.theta", "setpoint.theta", _DEGREE, "deg", 1, (5.0, 10.0, 20.0, 30.0, 60.0, 180.0)),
    _Row("q", "estimate.q", "setpoint.q", _DEGREE, "deg/s", 0, (20.0, 50.0, 100.0, 200.0, 500.0, 2000.0)),
    _Row("M", "command.M", "", 1.0, "", 3, (0.02, 0.05, 0.1, 0.2, 0.5, 1.0)),
    _Row("x", "estimate.x", "setpoint.x", 1.0, "m", 3, (0.05, 0.1, 0.2, 0.3, 0.5, 1.0)),
)
_LABEL = 20
_HEIGHTS = (5, 3, 1)
_HEAD = 3
_LEAST_TEXTS = 3
_MOST_TEXTS = 12
_LOUD = ("emergency", "alert", "critical", "error", "warning")


def screen(drones: Sequence[WatchedDrone], width: int, height: int, seconds: float) -> Text:
    """All of it, at most `height` lines of at most `width` letters; the charts show the last `seconds`."""
    room = height - _LEAST_TEXTS
    tall = next((high for high in _HEIGHTS if len(drones) * (_HEAD + len(_ROWS) * high) <= room), 0)
    lines: list[Text] = []
    for watched in drones:
        lines += _drone(watched, width, tall, seconds)
    said = _said(drones, max(_LEAST_TEXTS - 1, min(_MOST_TEXTS, height - len(lines) - 1)))
    lines = [*lines[: max(0, height - len(said) - 1)], Text("─" * width, FAINT), *said]
    for one in lines:
        one.truncate(width)
    return Text("\n", no_wrap=True, overflow="crop").join(lines[:height])


def _drone(watched: WatchedDrone, width: int, tall: int, seconds: float) -> list[Text]:
    lines = [_name(watched), _state(watched)]
    if tall or (watched.drone is not None and watched.drone.state.safety.reason):
        lines.append(_failsafe(watched))
    if tall:
        for row in _ROWS:
            lines += _chart(watched, row, width, tall, seconds)
    else:
        lines.append(_values(watched))
    return lines


def _name(watched: WatchedDrone) -> Text:
    line = Text()
    line.append(f"drone {watched.system}" if watched.system is not None else "drone ?", "bold")
    line.append(f"  {printable(watched.url)}")
    if watched.drone is not None:
        rig = watched.drone.state.rig
        if watched.drone.ours:
            kind = f"virtual, rig {printable(rig.name)}" if rig.virtual else f"rig {printable(rig.name)}"
            line.append(f"  {kind}, {controller_in_words(rig.controller, rig.changed)}")
        else:
            line.append(f"  {watched.drone.state.autopilot}")
    return line


def _state(watched: WatchedDrone) -> Text:
    line = Text()
    drone = watched.drone
    if not watched.heard or drone is None:
        if watched.lost is None:
            return line.append("looking for it")
        at = time.strftime("%H:%M:%S", time.localtime(watched.lost_at))
        return line.append(f"LINK LOST at {at}: {printable(watched.lost.what)}; looking for it again", "bold red")
    state, rig = drone.state, drone.state.rig
    if state.killed:
        line.append("KILLED", "bold red")
    else:
        line.append("ARMED" if state.armed else "disarmed", "bold green" if state.armed else "")
    line.append(f"  mode {state.mode}")
    if drone.ours:
        line.append("" if rig.safety_off else "  safety switch on: motors stand")
        line.append("  rings locked" if rig.rings_locked else "")
        holder = drone.lease.holder
        line.append(f"  commanded by {holder[0]}/{holder[1]}" if holder else "  nobody commands")
    battery = state.battery
    if isfinite(battery.voltage):
        line.append(f"  {battery.voltage:.1f} V" + (f" {battery.charge:.0%}" if isfinite(battery.charge) else ""))
    line.append(f"  t {watched.time:.1f} s" if isfinite(watched.time) else "")
    return line


def _failsafe(watched: WatchedDrone) -> Text:
    if watched.drone is None:
        return Text()
    words = watched.drone.state.safety.in_words()
    if not words:
        return Text("failsafe silent", FAINT)
    return Text(f"FAILSAFE for {since(watched):.1f} s: {words}", "bold red")


def _chart(watched: WatchedDrone, row: _Row, width: int, tall: int, seconds: float) -> list[Text]:
    columns = 2 * max(1, width - _LABEL)
    # Whole columns, else samples change from one column to the next as time passes, and the picture flickers.
    end = ceil(watched.time / (seconds / columns)) * (seconds / columns) if isfinite(watched.time) else 0.0
    low, high = (row.scale * part for part in watched.history[row.measured].columns(columns, end, seconds))
    wanted = None
    if row.wanted:
        below, above = watched.history[row.wanted].columns(columns, end, seconds)
        wanted = (row.scale * below, row.scale * above)
    limit = bound([low, high, *(wanted or ())], row.ladder)
    labels = [_value(watched, row), _wanted(watched, row), Text(f"±{limit:g} {row.unit}".rstrip(), FAINT)]
    if tall == 1:
        labels = [_beside(labels[0], labels[1])]
    lines = []
    for number, drawn in enumerate(chart((low, high), wanted, tall, limit)):
        label = labels[number].copy() if number < len(labels) else Text()
        label.truncate(_LABEL - 1)
        label.pad_right(_LABEL - len(label))
        lines.append(label.append_text(drawn))
    return lines


def _value(watched: WatchedDrone, row: _Row) -> Text:
    value = watched.history[row.measured].latest
    line = Text(f"{row.name:6}", "bold")
    return line.append(_number(value, row) if value is not None else "-", "")


def _wanted(watched: WatchedDrone, row: _Row) -> Text:
    value = followed(watched, row.wanted) if row.wanted else None
    return Text(f"{'to':6}{_number(value, row)}", SET_POINT) if value is not None else Text()


def _beside(value: Text, wanted: Text) -> Text:
    """Both in one short label."""
    return Text.assemble(value, wanted[5:]) if wanted else value


def _number(value: float, row: _Row) -> str:
    return f"{row.scale * value:+.{row.digits}f} {row.unit}".rstrip()


def _values(watched: WatchedDrone) -> Text:
    """The latest values in a line, where there is no room for charts."""
    line = Text()
    for row in _ROWS:
        value = watched.history[row.measured].latest
        if value is not None:
            line.append(f"{row.name} {_number(value, row)}  ")
    return line


def _said(drones: Sequence[WatchedDrone], count: int) -> list[Text]:
    """The newest lines of all drones, the newest last."""
    rows = sorted((line.heard, number, *line[1:]) for number, one in enumerate(drones) for line in one.texts)
    lines = []
    for heard, number, severity, text in rows[-count:]:
        who = f"drone {drones[number].system}  " if len(drones) > 1 else ""
        at = time.strftime("%H:%M:%S", time.localtime(heard))
        style = "red" if severity in _LOUD else ""
        lines.append(Text(f"{at} {who}{severity}: {printable(text)}", style))
    return lines or [Text("nothing said yet; Ctrl-C ends watching, and changes nothing", FAINT)]


def known(drones: Sequence[WatchedDrone]) -> bool:
    """Whether first values of every drone have come."""
    return all(bool(np.isfinite(one.time)) for one in drones)
