"""Proof that a change alters nothing: hashes of the code that flies, the frames sent and the files written.

python -m tools.same --out FILE        record, in the repository's root (a quarter of an hour)

python -m tools.same --against FILE    record and compare with FILE: each difference is listed, exit status 1

With --quick (two minutes) the outputs are those of the reference and of gcc only.

It records, for the code that is imported:
- outputs: Every signal over 20,000 steps of the flight core, the closed loop on both rigs and the starter diagrams.
  They run on each target that is there, in both precisions. The reference, which is slow, runs the first `SLOW`
  steps. The closed loop with each starter runs on the targets of --quick.
- wire: Every frame of two sessions, both ways: one in lockstep, one through the companion with time running. It also
  has what the drone answers to the frames of FILE's client.
- files: The on-board logs of the first session, and its recording in every format that is written.
- texts: The C of all of these and the PX4 modules of the starters. They may differ where the bits do not.

The clocks and the random numbers of the operating system stand still during the recording. Left out is what they
cannot hold: the payload of ONBOARD_COMPUTER_STATUS (memory in use) and the date at the head of a .mat file. Left out
is also what follows the writing thread: the order of a ULog's messages and its records of `REPEATED`. The chunks of
the MCAP recording follow it too, so their content is compared.
"""

import argparse
import asyncio
import hashlib
import json
import logging
import random
import secrets
import shutil
import sys
import time
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from tests.faults.virtual_time import run_virtual
from tests.faults.whole import Whole
from twodof.blocks import Diagram
from twodof.blocks.reference.interpreter import Reference
from twodof.compile import build
from twodof.compile.px4.export import make_module
from twodof.errors import CompileError, TwodofError
from twodof.excitation import Doublet
from twodof.flight.core import core
from twodof.flight.estimator import POSITION_FILTERS
from twodof.flight.starters import STARTERS, starter
from twodof.flightlog.files import read_log, write_log
from twodof.flightlog.log import FlightLog
from twodof.gcs.async_drone import AsyncDrone
from twodof.link.transport import open_transport
from twodof.link.transport.base import Transport
from twodof.rig.parameters import load_rig
from twodof.rig.rig import BASE_DT
from twodof.signals import MODES, PERIOD
from twodof.sim.closed_loop import closed_loop
from twodof.sim.virtual_drone import VirtualDrone

STEPS = 20_000
SLOW = 250
PRECISIONS = ("float64", "float32")
RIGS = ("paper", "lab")
QUICK = ("reference", "native gcc")
MOST_SHOWN = 20
COMPUTER_STATUS = 390
MAT_HEAD, ULOG_HEAD = 116, 16
REPEATED = (b"vehicle_status", b"actuator_armed")  # said again with each part that goes to the disk
NOW_S = 1_800_000_000
FOLDER = Path("/tmp/twodof-same")  # one name: it stands in the provenance of the logs
FORMATS = (".mat", ".mcap", ".parquet", ".csv")
_note = logging.getLogger("same")

Columns = Mapping[str, NDArray[Any]]


@contextmanager
def standing_clocks() -> Iterator[None]:
    """The clocks and the random numbers of the operating system give the same values in each run."""
    chance = random.Random(1)
    with ExitStack() as stack:
        for name, value in {"time": float(NOW_S), "time_ns": NOW_S * 10**9, "thread_time_ns": 1}.items():
            stack.enter_context(patch.object(time, name, lambda value=value: value))
        stack.enter_context(patch.object(time, "monotonic", lambda: 1.0))
        stack.enter_context(patch.object(secrets, "randbelow", chance.randrange))
        stack.enter_context(patch.object(secrets, "randbits", chance.getrandbits))
        stack.enter_context(patch.object(secrets, "choice", chance.choice))
        yield


def digest(data: bytes | str) -> str:
    """Of a text or of bytes."""
    return hashlib.sha256(data.encode() if isinstance(data, str) else data).hexdigest()[:16]


def bits(values: NDArray[Any]) -> str:
    """Of the shape and the values to the last bit, widened without loss; all NaNs are one."""
    plain = np.ascontiguousarray(values)
    plain = plain.astype({"f": np.float64, "i": np.int64, "u": np.int64}.get(plain.dtype.kind, plain.dtype))
    if plain.dtype.kind == "f":
        plain = np.where(np.isnan(plain), np.nan, plain)
    return digest(f"{plain.dtype} {plain.shape} ".encode() + plain.tobytes())


# What flies.


@dataclass(frozen=True)
class Subject:
    """A diagram, its parameters that are not at their defaults, and its inputs: (STEPS,) or (STEPS, width)."""

    make: Callable[[], Diagram]
    dt: float
    inputs: Columns
    parameters: Mapping[str, Any] = field(default_factory=dict)
    quick: bool = False


def random_inputs(diagram: Diagram) -> Columns:
    """By each port's name alone: values like a flight's, and held for a while where they are not reals."""
    made = {}
    for name, port in diagram.inputs.items():
        rng = np.random.default_rng(zlib.crc32(name.encode()))
        shape = (STEPS,) if port.width is None else (STEPS, port.width)
        if port.kind == "real":
            made[name] = 0.3 * rng.standard_normal(shape)
        elif port.kind == "bool":
            made[name] = np.repeat(rng.random(STEPS // 50) < (0.1 if "RESET" in name.upper() else 0.7), 50)
        else:
            made[name] = np.repeat(rng.integers(0, len(MODES), STEPS // 500), 500).astype(port.kind)
    return made


def flown_inputs(diagram: Diagram) -> Columns:
    """Set-points in every mode, a second or two each, from a drone that is armed; nothing fails."""
    plan = [("off", 0.0), ("attitude", 0.0), ("attitude", 0.1), ("rate", -0.1), ("attitude", 0.0), ("open-loop", 0.03)]
    plan += [("velocity", 0.2), ("position", -0.2), ("position", 0.25), ("off", 0.0)]
    length = STEPS // len(plan)
    mode = np.repeat([MODES.index(name) for name, _ in plan], length).astype(np.int32)
    value = np.repeat([value for _, value in plan], length)
    given = {"theta0": value, "q0": value, "v0": value, "x0": value, "M_open": value, "mode": mode}
    given |= {"thrust": np.where(mode == 0, 0.0, 0.4), "use_trim": mode == MODES.index("open-loop")}
    given |= {name: np.ones(STEPS, bool) for name in ("setpoint_new", "link_new", "imu_new")}
    given["arm"] = np.arange(STEPS) >= 200
    zero = {"real": np.zeros(STEPS), "bool": np.zeros(STEPS, bool), "int32": np.zeros(STEPS, np.int32)}
    return {name: given.get(name, zero.get(port.kind)) for name, port in diagram.inputs.items()}


def subjects() -> dict[str, Subject]:
    """All that is compared, by name."""
    made = {}
    for name, options in {"core": {}, "core with failsafe": {"failsafe": True}}.items():
        made[name] = Subject(partial(core, **options), PERIOD, random_inputs(core(**options)))
    for name in POSITION_FILTERS[1:]:
        made[f"core, {name} filter"] = Subject(partial(core, position_filter=name), PERIOD, made["core"].inputs)
    for rig in RIGS:
        parameters = {f"rig.{name}": value for name, value in load_rig(rig).snapshot().items()} | {"rig.seed": 7}
        for failsafe in (False, True):
            make = partial(closed_loop, failsafe=failsafe)
            name = f"closed loop on {rig}{' with failsafe' if failsafe else ''}"
            made[name] = Subject(make, BASE_DT, flown_inputs(make()), parameters)
    for name in STARTERS:
        made[f"starter {name}"] = Subject(partial(starter, name), PERIOD, random_inputs(starter(name)))
        make = partial(closed_loop, controllers=(starter(name),))
        made[f"closed loop with {name}"] = Subject(make, BASE_DT, flown_inputs(make()), parameters, quick=True)
    return made


def targets() -> dict[str, Callable[[Subject, str], tuple[Any, str]]]:
    """Return by target name a function that builds a subject in a precision: its machine and its source."""

    def single(target: str, compiler: str | None, subject: Subject, precision: str) -> tuple[Any, str]:
        program = build(subject.make(), subject.dt, precision, target=target, compiler=compiler)
        return program.machine(), program.source

    def reference(subject: Subject, precision: str) -> tuple[Any, str]:
        return Reference(subject.make(), subject.dt, precision).machine(), ""

    found: dict[str, Callable[[Subject, str], tuple[Any, str]]] = {"reference": reference}
    compiled = {"native gcc": ("native", "gcc"), "native zig": ("native", "zig"), "wasm": ("wasm", None)}
    compiled |= {"cortex-m7 gcc": ("cortex-m7", "gcc"), "cortex-m7 zig": ("cortex-m7", "zig")}
    return found | {name: partial(single, target, compiler) for name, (target, compiler) in compiled.items()}


def signals(machine: Any, target: str, subject: Subject) -> dict[str, dict[str, str]]:
    """Return the hashes of each output: of the first steps, and of all if the target is fast enough."""
    machine.set_many(subject.parameters)
    steps = SLOW if target == "reference" else STEPS
    inputs = {name: values[:steps] for name, values in subject.inputs.items()}
    out = {name: np.asarray(values) for name, values in machine.run(steps, inputs).items()}
    found = {"first": {name: bits(values[:SLOW]) for name, values in out.items()}}
    return found | ({"all": {name: bits(values) for name, values in out.items()}} if steps == STEPS else {})


def outputs(quick: bool) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the hashes of all subjects on all targets, and their generated C."""
    found: dict[str, Any] = {}
    texts: dict[str, str] = {}
    for name, subject in subjects().items():
        for precision in PRECISIONS:
            for target, make in targets().items():
                if (quick or subject.quick) and target not in QUICK:
                    continue
                place = f"{name}, {precision}, {target}"
                began = time.monotonic()
                try:
                    machine, source = make(subject, precision)
                    found[place] = signals(machine, target, subject)
                    if source:
                        texts[f"C of {place}"] = digest(source)
                except CompileError as error:
                    found[place] = {"absent": str(error)}
                _note.info("%6.1f s  %s", time.monotonic() - began, place)
    return found, texts


def disagreements(found: Mapping[str, Any]) -> list[str]:
    """Where the bits of two targets differ in one precision."""
    told = []
    by_subject: dict[str, list[tuple[str, Any]]] = {}
    for place, one in found.items():
        if "absent" not in one:
            by_subject.setdefault(place.rpartition(", ")[0], []).append((place, one))
    for some in by_subject.values():
        for part in ("first", "all"):
            having = [(place, one[part]) for place, one in some if part in one]
            told += [f"{place}: not the bits of {having[0][0]}" for place, one in having[1:] if one != having[0][1]]
    return told


# What is sent.


def masked(packet: bytes) -> bytes:
    """A packet without what no clock holds; each has one frame here."""
    header, number = packet[:10], int.from_bytes(packet[7:10], "little")
    return header if number == COMPUTER_STATUS else packet


class Tap:
    """Notes every packet that passes one end of a link in memory, both ways."""

    def __init__(self, link: Transport) -> None:
        self.frames: list[str] = []
        (other,) = link.peers
        for end, way in ((link, ">"), (other, "<")):
            end._send = partial(self._pass, way, link, end._send)  # type: ignore[attr-defined]

    def _pass(self, way: str, link: Transport, send: Callable[..., bool], data: bytes, peer: Any) -> bool:
        if way == ">" or peer is link:
            self.frames.append(f"{way}{masked(bytes(data)).hex()}")
        return send(data, peer)


async def lockstep_session(folder: Path) -> list[str]:
    """Return the frames of a client that connects, tunes, flies all set-points, records, disarms and repeats."""
    drone = VirtualDrone("lab", {"seed": 5, "rings": False}, lockstep=True, state=folder / "drone")
    async with drone:
        await drone.listen("memin://same")
        link = await open_transport("mem://same")
        tap = Tap(link)
        async with await AsyncDrone.over(link, system=250) as client:
            await client.version()
            await client.parameters.all()
            await client.parameters.describe()
            await client.parameters.set("SDLOG_MODE", 2)
            async with client.record(folder / "flight.mcap"):
                await flight(client)
            await client.reset(seed=3, x=0.1, rings=True)
            await client.run(0.5)
    return tap.frames


async def flight(client: AsyncDrone) -> None:
    """Some seconds of everything."""
    await client.run(0.5)
    await client.parameters.set("RATE_KP", 0.06)
    await client.arm()
    await client.set_pitch(0.1, thrust=0.4)
    await client.run(1.0)
    await client.parameters.set("RATE_KP", 0.07)
    await client.set_pitch_rate(-0.05)
    await client.run(0.2)
    await client.level_hold()
    await client.run(1.0)
    await client.excite(Doublet(0.03, 0.2), thrust=0.4)
    await client.set_velocity(0.1)
    await client.run(0.6)
    await client.set_position(0.1, acceleration=0.1)
    await client.run(1.0)
    await client.set_moment(0.01, thrust=0.4)
    await client.run(0.1)
    await client.disarm()
    await client.kill()
    await client.release()
    await client.run(0.2)
    await client.parameters.undo()


async def companion_session(_: Path) -> list[str]:
    """Through the companion, with time running."""
    async with Whole(seed=3) as whole:
        link = await open_transport(whole.clients)
        tap = Tap(link)
        async with await AsyncDrone.over(link, system=250, timeout=30.0) as client:
            await client.run(0.5)
            await client.arm(timeout=30.0)
            await client.set_pitch(0.1, thrust=0.4, timeout=30.0)
            await client.run(1.0)
            await client.disarm()
    return tap.frames


async def replayed(frames: list[str]) -> list[str]:
    """Return the answers of a fresh drone to a client's frames, sent in order."""
    heard: list[str] = []
    async with VirtualDrone("lab", {"seed": 5, "rings": False}, lockstep=True) as drone:
        await drone.listen("memin://replay")
        link = await open_transport("mem://replay")
        for frame in frames:
            link.send(bytes.fromhex(frame), None)
            await asyncio.sleep(0.001)
            while (packet := link.receive_now()) is not None:
                heard.append("<" + packet.data.hex())
        await link.close()
    return heard


def sent(frames: list[str]) -> list[str]:
    """The client's."""
    return [frame[1:] for frame in frames if frame[0] == ">"]


# What is written.


def content(log: FlightLog) -> dict[str, str]:
    """Of a log of any file format."""
    found = {}
    for name, channel in sorted(log.channels.items()):
        text = f"{channel.unit} {channel.fields} {bits(channel.time)} {bits(channel.value)}"
        found[f"channel {name}"] = digest(text)
    for name, value in log.provenance.items():
        if name not in ("file", "files"):
            found[f"provenance {name}"] = digest(json.dumps(value, sort_keys=True, default=str))
    return found


def ulog_messages(data: bytes) -> str:
    """Of the messages of a ULog in any order, without what follows the writing thread."""
    at, found, repeated = ULOG_HEAD, [], set()
    while at < len(data):
        end = at + 3 + int.from_bytes(data[at : at + 2], "little")
        kind, body = chr(data[at + 2]), data[at + 3 : end]
        if kind == "A" and body[3:] in REPEATED:
            repeated.add(body[1:3])
        if kind != "S" and not (kind == "D" and body[:2] in repeated):
            found.append(data[at:end])
        at = end
    return digest(data[:ULOG_HEAD] + b"".join(sorted(found)))


def written(folder: Path) -> dict[str, Any]:
    """Of the files that the session has left in `folder`, and of what they are converted to."""
    found: dict[str, Any] = {}
    for path in sorted((folder / "drone").rglob("*.ulg")):
        name = str(path.relative_to(folder))
        found[name] = {"messages": ulog_messages(path.read_bytes()), **content(read_log(path))}
    log = read_log(folder / "flight.mcap")
    found["flight.mcap"] = content(log)
    clean = FlightLog(log.channels, provenance={"from": "the session"})
    for suffix in FORMATS:
        path = folder / f"converted{suffix}"
        write_log(clean, path)
        raw = path.read_bytes()[MAT_HEAD if suffix == ".mat" else 0 :]
        found[path.name] = {"bytes": digest(raw), **content(read_log(path))}
    return found


# All of it.


def record(before: Mapping[str, Any] | None, quick: bool) -> dict[str, Any]:
    """Everything; with a recording of before, also what is answered to its client."""
    found, texts = outputs(quick)
    shutil.rmtree(FOLDER, ignore_errors=True)
    FOLDER.mkdir(parents=True)
    with standing_clocks():
        wire = {"lockstep": run_virtual(lockstep_session(FOLDER))}
        files = written(FOLDER)
        wire["companion"] = run_virtual(companion_session(FOLDER))
        theirs = wire if before is None else before["wire"]
        wire["answers"] = run_virtual(replayed(sent(theirs["lockstep"])))
    for name in STARTERS:
        try:
            module = make_module(starter(name))
        except TwodofError as error:
            texts[f"PX4 module of {name}"] = str(error)
            continue
        texts |= {f"PX4 module of {name}: {path}": digest(text) for path, text in module.files.items()}
    return {"outputs": found, "wire": wire, "files": files, "texts": texts}


def _content(frame: str) -> tuple[str, int, str]:
    """Direction, message number and payload of a noted packet with its sender: all but sequence and checksum."""
    packet = bytes.fromhex(frame[1:])
    return frame[0], int.from_bytes(packet[7:10], "little"), packet[5:7].hex() + packet[10 : 10 + packet[1]].hex()


def differences(before: Mapping[str, Any], after: Mapping[str, Any], quick: bool = False) -> list[str]:
    """Each difference, in a line; of a session the packets that went or came, message by message.

    With `quick` what there is only before is left out.
    """
    told = []
    for name, frames in before["wire"].items():
        others = after["wire"].get(name, [])
        if frames == others:
            continue
        told.append(f"wire, {name}: {len(frames)} packets before, {len(others)} after")
        was, now = (Counter(map(_content, each)) for each in (frames, others))
        gone, new = was - now, now - was
        if not gone and not new:
            told.append("    the same packets in another order or with other numbers")
        for message in sorted({one[1] for one in (gone + new)})[:MOST_SHOWN]:
            for word, packets in (("gone", gone), ("new", new)):
                of_it = {one: many for one, many in packets.items() if one[1] == message}
                if of_it:
                    direction, _, payload = next(iter(of_it))
                    told.append(
                        f"    message {message}: {sum(of_it.values())} {word}, such as {direction}{payload:.160}"
                    )
    for part in ("outputs", "files", "texts"):
        wanted = {name: value for name, value in before[part].items() if name in after[part] or not quick}
        told += _unlike(part, wanted, after[part])
    return told


def _unlike(where: str, before: Any, after: Any) -> list[str]:
    if not (isinstance(before, dict) and isinstance(after, dict)):
        return [] if before == after else [f"{where}: {before} before, {after} after"]
    told = []
    for name in [*before, *(name for name in after if name not in before)]:
        if name not in after or name not in before:
            told.append(f"{where}, {name}: only {'before' if name in before else 'after'}")
        else:
            told += _unlike(f"{where}, {name}", before[name], after[name])
    return told


def main() -> int:
    """The exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="the file to write")
    parser.add_argument("--against", type=Path, help="a file of before")
    parser.add_argument("--quick", action="store_true", help="fewer targets")
    asked = parser.parse_args()
    if not (asked.out or asked.against):
        parser.error("give --out FILE before a change, and --against FILE after it")
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr)
    before = json.loads(asked.against.read_text(encoding="utf-8")) if asked.against else None
    after = record(before, asked.quick)
    if asked.out:
        asked.out.write_text(json.dumps(after, indent=1), encoding="utf-8")
    told = [f"targets: {line}" for line in disagreements(after["outputs"])]
    told += differences(before, after, asked.quick) if before else []
    sys.stdout.write("\n".join([*told, f"{len(told)} lines of differences"]) + "\n")
    return 1 if told else 0


if __name__ == "__main__":
    sys.exit(main())
