"""Attacks on the lab's server, each for ever in a process of its own: `python -m tests.lab.attacks.attacker NAME PORT`.

The watcher's token comes in the environment. A line on standard output says that the attack is under way.
"""

import asyncio
import json
import os
import random
import sys
from collections.abc import Awaitable, Callable, Coroutine
from contextlib import suppress
from itertools import chain, repeat
from typing import Any

from websockets.asyncio.client import connect

from twodof.blocks.schema.json_form import to_json
from twodof.flight.starters import starter

WATCH, DRONE = os.environ.get("WATCH", ""), int(os.environ.get("DRONE", "1"))
Attack = Callable[[int], Awaitable[None]]
ATTACKS: dict[str, Attack] = {}
COLUMNS = ("estimate.theta", "estimate.q", "estimate.x", "estimate.v", "imu.gyro_y")


def attack(function: Attack) -> Attack:
    ATTACKS[function.__name__] = function
    return function


async def _all(count: int, one: Callable[[int], Coroutine[Any, Any, None]]) -> None:
    """Run `count` of one kind for ever, each begun again when it ends."""

    async def again(number: int) -> None:
        while True:
            with suppress(OSError, EOFError, asyncio.IncompleteReadError, TimeoutError, Exception):
                await one(number)
            await asyncio.sleep(0.5)

    await asyncio.gather(*(again(number) for number in range(count)))


def head(method: str, path: str, port: int, length: int | None = None, token: str = WATCH) -> bytes:
    rows = [f"{method} {path} HTTP/1.1", f"Host: 127.0.0.1:{port}"]
    rows += [f"Authorization: Bearer {token}"] if token else []
    rows += [] if length is None else ["Content-Type: application/json", f"Content-Length: {length}"]
    return ("\r\n".join(rows) + "\r\n\r\n").encode()


async def _ask(port: int, sent: bytes, count: int = 1_000_000) -> None:
    """Send one request again and again over one connection, each when the one before is answered."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=1 << 26)
    try:
        for _ in range(count):
            writer.write(sent)
            await writer.drain()
            got = await reader.readuntil(b"\r\n\r\n")
            lengths = [row for row in got.lower().split(b"\r\n") if row.startswith(b"content-length:")]
            await reader.readexactly(int(lengths[0].split(b":")[1]) if lengths else 0)
    finally:
        writer.close()


def flood(count: int, method: str, path: str, body: bytes | None = None, token: str = WATCH) -> Attack:
    async def run(port: int) -> None:
        sent = head(method, path, port, None if body is None else len(body), token) + (body or b"")
        await _all(count, lambda _: _ask(port, sent))

    return run


async def _dribble(port: int, first: bytes, piece: bytes, pause: float) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    try:
        writer.write(first)
        while not reader.at_eof():
            await asyncio.sleep(pause)
            writer.write(piece)
            await writer.drain()
    finally:
        writer.close()


def _preview(**excitation: object) -> bytes:
    return json.dumps({"excitation": excitation, "points": 5000, "drone": DRONE, "loop": "theta"}).encode()


def _changes(count: int) -> bytes:
    return ("{" + ",".join(f'"k{number}":1' for number in range(count)) + "}").encode()


def sockets(count: int, streams: int, *, fast: bool = False, reads: bool = True, columns: int = 1) -> Attack:
    """Web sockets with `streams` subscriptions each; `fast`: subscribing without a pause."""

    async def one(port: int, number: int) -> None:
        url = f"ws://127.0.0.1:{port}/api/telemetry?token={WATCH}"
        async with connect(url, max_queue=None if reads else 1, ping_interval=None) as client:

            async def read() -> None:
                while reads:
                    await client.recv()
                await asyncio.sleep(1e6)

            async def ask() -> None:
                for k in range(65_000 if fast else streams):
                    wanted = list(COLUMNS[: 1 + (k + number) % 5]) * columns
                    asked = {
                        "do": "subscribe",
                        "id": k % 65_536,
                        "drone": DRONE,
                        "columns": wanted[:64],
                        "rate": 250.0 - k % 32,
                    }
                    await client.send(json.dumps(asked))

            await asyncio.gather(read(), ask())

    async def run(port: int) -> None:
        await _all(count, lambda number: one(port, number))

    return run


# -- those of the issue ------------------------------------------------------------------------------------------------


def idle(count: int) -> Attack:
    async def run(port: int) -> None:
        await _all(count, lambda _: _dribble(port, b"", b"", 1.0))

    return run


ATTACKS["idle_connections"] = idle(420)
ATTACKS["more_idle_connections"] = idle(1200)
HEAD = b"GET / HTTP/1.1\r\nX-A: "


@attack
async def slow_heads(port: int) -> None:
    await _all(600, lambda _: _dribble(port, HEAD, b"a", 0.5))


@attack
async def slow_bodies(port: int) -> None:
    first = head("POST", "/api/excitations/preview", port, 1000)
    await _all(600, lambda _: _dribble(port, first, b" ", 0.5))


LINES = [*range(9_500, 10_000)]
ATTACKS["many_harmonics"] = flood(
    4,
    "POST",
    "/api/excitations/preview",
    _preview(kind="multisine", peak=0.1, period=100.0, harmonics=LINES, unit="rad"),
)
ATTACKS["many_levels"] = flood(
    8, "POST", "/api/excitations/preview", _preview(kind="steps", levels=[0.1, -0.1] * 5000, hold=0.1, unit="rad")
)
ATTACKS["many_keys"] = flood(4, "POST", f"/api/tuning/{DRONE}/preview", _changes(80_000))
ATTACKS["many_subscriptions"] = sockets(2, 0, fast=True)
ATTACKS["many_streams"] = sockets(60, 32)
ROWS = b"\0" * (60 << 20)


@attack
async def mat_exports(port: int) -> None:
    columns = ",".join(COLUMNS[:3])
    first = head("POST", f"/api/export/mat?columns={columns}", port, len(ROWS) // 20 * 20)

    async def one(_: int) -> None:
        reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=1 << 28)
        writer.write(first)
        for k in range(0, len(ROWS) // 20 * 20, 1 << 20):
            writer.write(ROWS[k : min(k + (1 << 20), len(ROWS) // 20 * 20)])
            await writer.drain()
        await reader.read(1 << 16)
        writer.close()

    await _all(8, one)


@attack
async def compilations(port: int) -> None:
    text = to_json(starter("pid-attitude"))

    async def one(number: int) -> None:
        body = json.dumps({"text": text.replace("pid", f"p{number}", 1), "rig": "lab"}).encode()
        await _ask(port, head("POST", "/api/diagrams/compile", port, len(body)) + body)

    await _all(24, one)


ATTACKS["many_sockets"] = sockets(130, 0)

# -- further ones ------------------------------------------------------------------------------------------------------

ATTACKS["unknown_tokens"] = flood(64, "GET", "/api/drones", token="wrong")
ATTACKS["page_loads"] = flood(64, "GET", "/", token="")
ATTACKS["watchers_reads"] = flood(64, "GET", f"/api/drones/{DRONE}/parameters")
ATTACKS["files_of_parameters"] = flood(24, "GET", f"/api/drones/{DRONE}/parameters/file")
ATTACKS["nested_lists"] = flood(8, "POST", "/api/diagrams/check", b"[" * 1_000_000 + b"]" * 1_000_000)
ATTACKS["wrong_blocks"] = flood(8, "POST", "/api/diagrams/shapes", json.dumps({"blocks": [1] * 300_000}).encode())
ATTACKS["long_sequences"] = flood(
    8, "POST", "/api/excitations/preview", _preview(kind="prbs", amplitude=0.1, clock=0.004, order=16, unit="rad")
)
ATTACKS["plans"] = flood(
    12, "POST", "/api/identification/plan", json.dumps({"experiment": {"name": "doublet"}, "rehearse": True}).encode()
)
ATTACKS["sockets_that_do_not_read"] = sockets(90, 32, reads=False, columns=13)
ATTACKS["lists_of_logs"] = flood(24, "GET", "/api/logs")
ATTACKS["lists_of_models"] = flood(24, "GET", "/api/models")


@attack
async def short_connections(port: int) -> None:
    async def one(_: int) -> None:
        _, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.transport.abort()

    async def again(number: int) -> None:
        while True:
            with suppress(OSError):
                await one(number)
            await asyncio.sleep(0)

    await asyncio.gather(*(again(number) for number in range(16)))


@attack
async def pipelined_requests(port: int) -> None:
    async def one(_: int) -> None:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(head("GET", "/api/drones", port) * 1000)
        while await reader.read(1 << 16):
            pass
        writer.close()

    await _all(16, one)


@attack
async def answers_that_nobody_reads(port: int) -> None:
    async def one(_: int) -> None:
        _, writer = await asyncio.open_connection("127.0.0.1", port, limit=1)
        writer.transport.pause_reading()
        writer.write(head("GET", "/api/openapi.json", port) * 200)
        await asyncio.sleep(60)

    await _all(200, one)


@attack
async def messages_in_pieces(port: int) -> None:
    async def one(_: int) -> None:
        async with connect(f"ws://127.0.0.1:{port}/api/telemetry?token={WATCH}", ping_interval=None) as client:
            while True:
                await client.send([*['{"do":'], *[" "] * 2000, '"here"}'])

    await _all(16, one)


def bytes_sent(count: int, made: Callable[[int], bytes], half_closed: bool = False) -> Attack:
    """Connections that send these bytes for a port, and read until the server closes them."""

    async def one(port: int) -> None:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        try:
            writer.write(made(port))
            if half_closed:
                writer.write_eof()
            while await reader.read(1 << 16):
                pass
        finally:
            writer.close()

    async def run(port: int) -> None:
        await _all(count, lambda _: one(port))

    return run


def frames(count: int, *pieces: bytes, then: float = 1e6) -> Attack:
    """Web sockets that send these bytes; the last of them again and again, `then` apart [s]."""
    key = "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
    key += "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"

    async def one(port: int) -> None:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)

        async def write() -> None:
            for piece in chain(pieces, repeat(pieces[-1])):
                writer.write(piece)
                await writer.drain()
                await asyncio.sleep(then)

        writer.write(head("GET", "/api/telemetry", port)[:-2] + key.encode())
        writing = asyncio.create_task(write())
        try:
            while await reader.read(1 << 16):
                pass
        finally:
            writing.cancel()
            writer.transport.abort()

    async def run(port: int) -> None:
        await _all(count, lambda _: one(port))

    return run


def headed(rows: str, path: str = "/api/drones", method: str = "GET") -> Callable[[int], bytes]:
    return lambda port: head(method, path, port)[:-2] + rows.encode() + b"\r\n"


MASKED = b"\0\0\0\0"
ATTACKS["paths_that_end_as_a_kill"] = flood(64, "GET", f"/{'a/' * 3000}kill", token="")
ATTACKS["kills_of_no_drone"] = flood(32, "POST", "/api/drones/99/kill")
ATTACKS["pipelined_kills"] = bytes_sent(16, lambda port: head("POST", "/api/drones/99/kill", port) * 500)
ATTACKS["descriptions"] = flood(32, "GET", "/api/openapi.json")
ATTACKS["many_headers"] = bytes_sent(64, headed("".join(f"X-{k}: {k}\r\n" for k in range(1200))))
ATTACKS["many_cookies"] = bytes_sent(64, headed("".join(f"Cookie: a{k}=b\r\n" for k in range(900))))
ATTACKS["many_ranges"] = bytes_sent(
    64, headed(f"Range: bytes={','.join(f'{k}-{k}' for k in range(0, 2400, 2))}\r\n", "/")
)
ATTACKS["http_2"] = bytes_sent(200, lambda _: b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes(9000))
ATTACKS["half_closed_connections"] = bytes_sent(200, headed(""), half_closed=True)
ATTACKS["encoded_dots"] = bytes_sent(64, headed("", "/" + "%2e%2e%2f" * 1500))
ATTACKS["frames_never_ended"] = frames(16, b"\x01\x81" + MASKED + b"{", b"\0\x81" + MASKED + b" ", then=0.0)
ATTACKS["chunks_of_a_byte"] = bytes_sent(
    16, lambda port: headed("Transfer-Encoding: chunked\r\n", "/", "POST")(port) + b"1\r\na\r\n" * 200_000
)
ATTACKS["fragmented_pings"] = frames(32, b"\x09\x81" + MASKED + b"p", then=0.01)
ATTACKS["pings_between_fragments"] = frames(
    16, b"\x01\x81" + MASKED + b"{", (b"\x89\x81" + MASKED + b"p") * 500, then=0.0
)
ATTACKS["sockets_that_close_and_stay"] = frames(200, b"\x88\x82" + MASKED + b"\x03\xe8")


@attack
async def compilations_cut_off(port: int) -> None:
    text, chance = to_json(starter("pid-attitude")), random.Random(1)

    async def one(number: int) -> None:
        body = json.dumps({"text": text.replace("pid", f"c{number}", 1), "rig": "lab"}).encode()
        _, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(head("POST", "/api/diagrams/compile", port, len(body)) + body)
        await asyncio.sleep(chance.uniform(0.01, 1.0))
        writer.transport.abort()

    await _all(24, one)


async def main(name: str, port: int) -> None:
    task = asyncio.ensure_future(ATTACKS[name](port))
    await asyncio.sleep(1.0)
    sys.stdout.write("under way\n")
    sys.stdout.flush()
    await task


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], int(sys.argv[2])))
