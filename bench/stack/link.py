"""The wire: encoding and decoding beside pymavlink's, loading the dialect, round trips in memory and on loopback."""

import asyncio
import statistics
import subprocess
import sys
import time

from bench.measure import Figure, one_core, timed
from twodof.link.connection import Connection
from twodof.link.mavlink import dialect
from twodof.link.mavlink.framing import Parser, decode, encode
from twodof.link.mavlink.messages import message
from twodof.link.signing import Key, Signing, Stamps
from twodof.link.transport import open_transport
from twodof.link.transport.base import memory_pair

# DESIGN section 6.
LOAD_SECONDS = 0.1
# Eight drones that stream everything at 250 Hz (some 400 messages a second each) on a tenth of a core.
MESSAGES_PER_SECOND = 32_000
ANSWER_S = 60.0
"""What has not come by then is lost."""
LOAD = """
import time
from {module}
start = time.perf_counter()
{load}
print(time.perf_counter() - start)
"""


def load_seconds(module: str, load: str, repeats: int) -> float:
    """The best time [s] of `load` in a process of its own."""
    command = [sys.executable, "-c", LOAD.format(module=module, load=load)]
    runs = [subprocess.run(command, capture_output=True, text=True, timeout=60, check=True) for _ in range(repeats)]
    return min(float(run.stdout) for run in runs)


async def lockstep_seconds(count: int) -> float:
    """CPU time [s] of a grant and its answer, in memory."""
    ours, theirs = memory_pair()
    async with Connection(ours, 1, 1) as drone, Connection(theirs, 255, 190) as ground:
        start = time.thread_time()
        for tick in range(count):
            ground.send(message("TWODOF_GRANT", until=tick))
            drone.receive_now()
            drone.send(message("TWODOF_TICK", tick=tick))
            ground.receive_now()
        return (time.thread_time() - start) / count


async def round_trips(count: int, signed: bool) -> list[float]:
    """Times on the wall [s] of a message and its answer over UDP on loopback, by rising length."""
    key = Key.fresh()

    def signing() -> Signing | None:
        return Signing(key, Stamps(None)) if signed else None

    listening = await open_transport("udpin://:0")
    calling = await open_transport(listening.url.replace("in:", ":"))
    async with Connection(listening, 1, 1, signing()) as drone, Connection(calling, 255, 190, signing()) as ground:

        async def serve() -> None:
            while (got := await drone.receive(ANSWER_S)) is not None:
                drone.send(message("TWODOF_TICK", tick=got.message.until), to=got.peer)

        serving = asyncio.create_task(serve())
        taken = []
        for tick in range(count):
            start = time.perf_counter()
            ground.send(message("TWODOF_GRANT", until=tick))
            if await ground.receive(ANSWER_S) is not None:
                taken.append(time.perf_counter() - start)
        serving.cancel()
    return sorted(taken)


def run(quick: bool) -> list[Figure]:
    """All figures of the link; `quick` takes fewer repeats."""
    count, repeats = (2_000, 3) if quick else (10_000, 9)
    attitude = message("ATTITUDE", time_boot_ms=4, pitch=0.1, pitchspeed=0.2)
    raw, parser = encode(attitude, 1, 1, 0), Parser()
    theirs = dialect.load().MAVLink(None, 1, 1)

    def both_ways() -> None:
        for _ in range(count):
            for frame in parser.feed(encode(attitude, 1, 1, 0), whole=True):
                decode(frame)

    def pymavlink_both_ways() -> None:
        for _ in range(count):
            theirs.parse_char(attitude.pack(theirs))

    def frames_only() -> None:
        for _ in range(count):
            parser.feed(raw, whole=True)

    with one_core():
        ours, peers, cut = (one.median / count for one in timed([both_ways, pymavlink_both_ways, frames_only], repeats))
        lockstep = statistics.median(asyncio.run(lockstep_seconds(count)) for _ in range(repeats))
        plain = asyncio.run(round_trips(count // 5, signed=False))
        signed = asyncio.run(round_trips(count // 5, signed=True))
    load = load_seconds("twodof.link.mavlink import dialect", "dialect.load()", repeats)
    common = load_seconds("importlib import import_module", 'import_module("pymavlink.dialects.v20.common")', repeats)
    return [
        Figure("encode and decode", 1.0 / ours, "messages/s", MESSAGES_PER_SECOND),
        Figure("the same, pymavlink", 1.0 / peers, "messages/s"),
        Figure("cut into frames only", 1.0 / cut, "frames/s"),
        Figure("grant and answer in memory", lockstep * 1e6, "us"),
        Figure("round trip over UDP, median", plain[len(plain) // 2] * 1e6, "us"),
        Figure("round trip over UDP, p99", plain[len(plain) * 99 // 100] * 1e6, "us"),
        Figure("the same signed, median", signed[len(signed) // 2] * 1e6, "us"),
        Figure("load the dialect", load, "s", LOAD_SECONDS, at_most=True),
        Figure("the same, pymavlink's `common`", common, "s"),
    ]
