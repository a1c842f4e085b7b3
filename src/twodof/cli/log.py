"""`twodof log info`, `plot`, `convert`, `recover` and `fetch`."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

from rich.console import RenderableType

from twodof.cli.flown import draw, write_view
from twodof.cli.options import Force, Json, argument, flag, group, option
from twodof.cli.output import exit_unless, one_line, print_json, print_result, table, table_console
from twodof.errors import LogError
from twodof.flightlog.atomic import check_free
from twodof.flightlog.contents import describe
from twodof.flightlog.files import convert as convert_log
from twodof.flightlog.files import read_log
from twodof.flightlog.log import FlightLog
from twodof.flightlog.mcap_file import recover as recover_log
from twodof.flightlog.public_data import FOREIGN_FILES, PUBLIC_LOGS, find
from twodof.report.plots.comparison_view import Align, common_steps, comparison_view, flight_steps, step_rows
from twodof.report.plots.flight_view import SUFFIXES, check_place, failsafe_bands
from twodof.report.step_responses import SETTLED, FlownStep
from twodof.signals import BY_MAT

log = group("Inspect, draw, convert, recover and download flight logs.")
# More rows than this say nothing more to a reader; --json has all.
_ROWS = 20


@log.command()
def info(file: Annotated[Path, argument("A .mat, .mcap, .parquet, .csv or .ulg log.")], json: Json = False) -> None:
    """List a log's channels and rates, gaps, events, likely experiment, failsafe actions and the drone's messages."""
    log = read_log(file)
    found = describe(log)
    found["failsafe"] = [asdict(band) for band in failsafe_bands(log)]
    print_result(json, found, _contents_lines(log, found))


def _contents_lines(log: FlightLog, found: dict[str, Any]) -> Iterator[RenderableType]:
    yield f"{found['source']}: {found['span_s'][0]:.3f} to {found['span_s'][1]:.3f} s, {_experiment(found)}"
    channels = table("channel", "unit", "samples", "rate, Hz", "missing", "longest gap, ms", right=range(2, 6))
    for row in found["channels"]:
        rate = "on events" if row["rate_hz"] is None else f"{row['rate_hz']:.2f}"
        gap = f"{1e3 * row['longest_gap_s']:.1f}" if row["gaps"] else ""
        channels.add_row(row["name"], row["unit"] or "-", str(row["samples"]), rate, str(row["missing"] or ""), gap)
    yield channels
    if found["modes_unclear"]:
        yield f"modes unknown: {found['modes_unclear']}"
    for name, counts in found["provenance"].get("left_out", {}).items():
        yield f"left out of {name}: {', '.join(f'{count} {why}' for why, count in counts.items())}"
    for start, end in found["armed_s"]:
        yield f"thrust on: {start:.3f} to {end:.3f} s"
    yield from _flown(log)
    for band in found["failsafe"][:_ROWS]:
        yield f"failsafe: {band['start']:.3f} to {band['stop']:.3f} s  {band['label']}"
    events = (
        f"{one['time']:10.3f} s  {one['kind']} {one['channel']}: {one['before']:g} to {one['after']:g}"
        for one in found["events"]
    )
    yield from _first(events, " events")
    yield from _first(_status_texts(log), " lines that the drone said")


def _first(lines: Iterable[str], more: str) -> Iterator[str]:
    """Yield the first lines, and how many `more` there are."""
    rows = [*lines]
    yield from rows[:_ROWS]
    if len(rows) > _ROWS:
        yield f"... and {len(rows) - _ROWS} more{more}"


def _flown(log: FlightLog) -> Iterator[str]:
    """Yield the controller and the reason of a broken-off flight, as far as the log has them."""
    flown, drone = (log.provenance.get(name) for name in ("flown", "drone"))
    flown, drone = (found if isinstance(found, dict) else {} for found in (flown, drone))
    controller = flown.get("controller") or drone.get("controller")
    if controller:
        yield f"controller: {one_line(controller)}"
    if flown.get("reason"):
        yield f"broken off: {one_line(flown['reason'])}"


def _status_texts(log: FlightLog) -> Iterator[str]:
    """Yield the drone's status texts; rows of another form are left out."""
    texts = log.provenance.get("texts")
    for row in texts if isinstance(texts, list) else ():
        match row:
            case [int() | float() as time, str() | int() as severity, str() as text]:
                yield f"{time:10.3f} s  {one_line(severity)}: {one_line(text)}"


def _experiment(found: dict[str, Any]) -> str:
    experiment = found["experiment"]
    if experiment is None:
        return "no excitation found"
    start, end = experiment["window"]
    return f"{experiment['name']} between {start:.2f} and {end:.2f} s"


@log.command()
def plot(
    files: Annotated[list[Path], argument("A .mat, .mcap, .parquet, .csv or .ulg log, or several.", "FILE...")],
    out: Annotated[
        Path | None,
        option(f"File to write ({', '.join(SUFFIXES)}); default: FILE with .png, or -compared.png for several."),
    ] = None,
    topics: Annotated[
        list[str] | None, option("Draw only these signals, such as theta,q,imu.gyro; repeatable.", "NAME,...")
    ] = None,
    window: Annotated[
        tuple[float, float] | None,
        option("Draw only this part [s], in the log's time; with several, from where they align.", "T0 T1"),
    ] = None,
    align: Annotated[Align, option("Align several flights at their first steps or at their starts.")] = Align.step,
    force: Force = False,
    json: Json = False,
) -> None:
    """Draw a flight: pitch, rate, position, velocity and motors, set-points, modes, failsafe and excitation.

    Several flights are drawn one over the other, aligned where their set-points first step. A table has rise,
    overshoot, settling and peak of each step of the set-point. Equal steps share the settling of their mean response.
    |M| counts from 0; a promise of design counts it from its mean before the step.
    """
    first = files[0]
    target = out or (first.with_suffix(".png") if len(files) == 1 else first.with_name(f"{first.stem}-compared.png"))
    check_place(target, force)
    names = [name for text in topics or () for name in text.split(",") if name]
    if len(files) > 1:
        _compare(files, target, names, align, window, force, json)
        return
    log = read_log(first)
    notes = draw(log, target, names, window, first.name, force)
    steps = {} if names else common_steps({first.stem: log})[0]
    lines = [*_step_table(steps), *(f"note: {note}" for note in notes), f"written: {target}"]
    print_result(json, {"file": str(target), "notes": list(notes), "steps": _plain_steps(steps)}, lines)


def _compare(
    files: Sequence[Path],
    target: Path,
    topics: Sequence[str],
    align: Align,
    window: tuple[float, float] | None,
    force: bool,
    json: bool,
) -> None:
    if topics:
        raise LogError("topics are for one flight", ", ".join(map(str, files)), "leave --topics out, or give one log")
    names = _names(files)
    if len(set(names)) < len(names):
        raise LogError("a log is given twice", ", ".join(names), "name each once")
    logs = {name: read_log(file) for name, file in zip(names, files, strict=True)}
    view = comparison_view(logs, align, window)
    steps = flight_steps(logs) if align is Align.step else {}
    write_view(view, target, force)
    print_result(json, {"file": str(target), "steps": _plain_steps(steps)}, [*_step_table(steps), f"written: {target}"])


def _step_table(steps: Mapping[str, Sequence[FlownStep]]) -> list[Any]:
    """Return a table of the steps; nothing without steps."""
    heads = ("at, s", "step", "rise, s", "overshoot, %", f"settling ({SETTLED:.0%}), s", "peak", "peak |M|")
    made = table("flight", *heads, right=(1, *range(3, 8)))
    for row in step_rows(steps):
        made.add_row(*row)
    return [made] * bool(steps)


def _plain_steps(steps: Mapping[str, Sequence[FlownStep]]) -> dict[str, Any]:
    return {name: [step.to_json() for step in found] for name, found in steps.items()}


def _names(files: Sequence[Path]) -> list[str]:
    """Return distinct names of the files: stems, or paths if two stems are equal."""
    stems = [file.stem for file in files]
    return stems if len(set(stems)) == len(files) else [str(file) for file in files]


@log.command()
def convert(
    source: Annotated[Path, argument("The log to read.")],
    target: Annotated[Path, argument("The file to write; its suffix says the format.")],
    wide: Annotated[
        bool, flag("Write a table (.csv, .parquet) with one row per time stamp and one column per signal.", "--wide")
    ] = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write a log in another format (.mat, .mcap, .parquet, .csv, .ulg).

    A .ulg, for PX4's tools, holds the drone's own signals, and the parameters that were not at their defaults. All
    other contents of the log are left out, and listed.
    """
    log = convert_log(source, target, wide, force)
    left_out = [name for name in log.channels if name not in BY_MAT] if target.suffix.lower() == ".ulg" else []
    kept = [name for name in log.channels if name not in left_out]
    lacks = f"left out, which ULog has no topic for: {', '.join(left_out)}"
    document = {"file": str(target), "channels": kept, "left_out": left_out}
    print_result(json, document, [f"{target}: {len(kept)} channels", *[lacks] * bool(left_out)])


@log.command()
def recover(
    file: Annotated[Path, argument("An .mcap recording or .ulg log that was cut off or damaged.")],
    out: Annotated[Path | None, argument("The .mcap file to write; default: FILE with .recovered.mcap.")] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write the sound parts of a recording as a complete .mcap file; FILE stays as it is.

    Exit status 1: the file is written, but parts of it have no checksum. They are named here and in the file.
    """
    target = out if out is not None else file.with_name(f"{file.stem}.recovered.mcap")
    if target.suffix.lower() != ".mcap":
        raise LogError(f"{target.suffix!r} is not what is written", str(target), "name an .mcap file")
    check_free(target, force)
    found = recover_log(file)
    found.write(target, force)
    # What was written is what is reported: it has to read back whole.
    samples = sum(len(channel) for channel in read_log(target).channels.values())
    start, end = found.log.span
    kept = {"file": str(target), "samples": samples, "span_s": [start, end]}
    told = {"lost_bytes": found.lost_bytes, "what": list(found.what), "unverified": list(found.unverified)}
    lines = [
        f"{target}: {samples} samples from {start:.3f} to {end:.3f} s",
        *_first(found.what or ["nothing was wrong with it"], ""),
        f"{found.lost_bytes} bytes could not be used",
    ]
    print_result(json, kept | told, lines)
    exit_unless(not found.unverified)


@log.command()
def fetch(
    names: Annotated[list[str] | None, argument("Names of public logs; all of them if none is named.")] = None,
    deadline: Annotated[float, option("Seconds to wait for each download.", min=1.0)] = 60.0,
    foreign: Annotated[
        bool, flag("Fetch instead the test files of other programs, which `make thorough` reads.", "--foreign")
    ] = False,
    json: Json = False,
) -> None:
    """Download the public logs of the real drone that are missing here, and verify their checksums."""
    found = {}
    for name in names or (FOREIGN_FILES if foreign else PUBLIC_LOGS):
        found[name] = find(name, deadline)
        if not json:
            table_console().print(f"{name}: {found[name]}")
    if json:
        print_json({name: str(path) for name, path in found.items()})
