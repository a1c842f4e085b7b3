"""Clients of the web socket: their requests, subscriptions and events."""

import asyncio
import time
from typing import Annotated, Literal, Self

from fastapi import WebSocket
from pydantic import Field, TypeAdapter, ValidationError
from starlette.websockets import WebSocketDisconnect

from twodof.errors import LogError, TwodofError, listed, nearest
from twodof.lab.access import LabClient
from twodof.lab.answers import RequestBody, dumps, refusal_of
from twodof.lab.drones.telemetry_source import until_one_ends
from twodof.lab.lab import LabServer
from twodof.lab.telemetry_rows import COLUMNS, FeedKey, Outbox, StreamState, header
from twodof.lab.turns import Pace, greediest

LONGEST = 8192
"""Most characters of a client's message."""
MOST_COLUMNS = 64


class SocketRefused(Exception):
    """Error that ends a web socket, with the code of its end."""

    code = 1013  # try again later


class MalformedRequest(SocketRefused):
    """Error for a client's message that is not JSON, too long, or of an unknown form."""

    code = 1007


class Subscribe(RequestBody):
    """Request for rows of a drone's columns, at most `rate` a second; the binary messages with rows have the `id`."""

    do: Literal["subscribe"]
    id: int = Field(ge=0, lt=2**16)
    drone: int = Field(ge=1, le=255)
    columns: list[Annotated[str, Field(max_length=64)]] = Field(min_length=1, max_length=MOST_COLUMNS)
    rate: float = Field(default=250.0, ge=0.1, le=250.0)

    def known_columns(self) -> tuple[str, ...]:
        """Return the columns. Raises LogError for an unknown one."""
        unknown = [name for name in self.columns if name not in COLUMNS]
        if unknown:
            raise LogError("no such column", listed(unknown, 3), f"choose of {nearest(unknown[0], COLUMNS)}")
        return tuple(self.columns)


class Unsubscribe(RequestBody):
    """Request to end the subscription `id`."""

    do: Literal["unsubscribe"]
    id: int = Field(ge=0, lt=2**16)


class Here(RequestBody):
    """Answer to `alive`, which shows that the page runs."""

    do: Literal["here"]


ClientRequest = Subscribe | Unsubscribe | Here
_ADAPTER: TypeAdapter[ClientRequest] = TypeAdapter(Annotated[ClientRequest, Field(discriminator="do")])


def read_request(text: str) -> ClientRequest:
    """Return the request in a client's message. Raises MalformedRequest."""
    if len(text) > LONGEST:
        raise MalformedRequest(f"longer than {LONGEST} characters")
    try:
        return _ADAPTER.validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        place = ".".join(str(part)[:40] for part in first["loc"])
        raise MalformedRequest(f"{place or 'message'}: {first['msg']}"[:200]) from None


MOST_CLIENTS = 100
"""Most clients of one role."""
MOST_STREAMS = 32
FREE_S = 0.5
"""A watching client's messages wait for turns, but for one in this time [s]."""
ALIVE_S = 1.0
SEND_S = 30.0
"""Longest time to send one message [s]; after that the client is disconnected."""


class TelemetryClient:
    """Connected client; `async with` joins the audience, and ends the subscriptions afterwards.

    Each role has its places. When they are full, the person with the most of them loses one.
    """

    def __init__(self, websocket: WebSocket, client: LabClient, lab: LabServer) -> None:
        self._websocket, self._lab, self._person = websocket, lab, client.address
        self._outbox = Outbox(client.role, client.address)
        self._streams: dict[int, tuple[StreamState, int]] = {}

    async def __aenter__(self) -> Self:
        connection = self._websocket.state.connection
        same = [one for one in self._lab.audience if one.role is self._outbox.role]
        if len(same) >= min(MOST_CLIENTS, connection.places.most):
            person = greediest([*(one.person for one in same), self._person])
            if person == self._person:
                raise SocketRefused(f"{len(same)} clients are connected already")
            next(one for one in same if one.person == person).end()
        self._lab.audience.add(self._outbox)
        connection.keep()
        return self

    async def __aexit__(self, *_: object) -> None:
        self._websocket.state.connection.leave()
        self._lab.audience.discard(self._outbox)
        for number in [*self._streams]:
            self._end(number)

    async def serve(self) -> None:
        """Send all states, then serve until the client leaves.

        Raises WebSocketDisconnect, MalformedRequest, and TimeoutError for a client that receives nothing.
        """
        self._say({"event": "session", "role": self._outbox.role})
        for state in self._lab.drones.states:
            self._say({"event": "drone", "drone": state["system"], "state": state})
        for job in self._lab.jobs.all:
            if not job.over:
                self._say({"event": "job", "job": job.to_json(with_result=False)})
        await until_one_ends((self._send(), self._receive(), self._beat()))

    async def _beat(self) -> None:
        """Send `alive` regularly, and count missing answers.

        A page cannot see a socket's own pings, and a browser answers them for a frozen page.
        """
        while True:
            await asyncio.sleep(ALIVE_S)
            self._outbox.unanswered += self._outbox.answers
            self._say({"event": "alive"})

    async def _send(self) -> None:
        while True:
            what = await self._outbox.next()
            if what is None:
                raise SocketRefused("another person needs the place")
            async with asyncio.timeout(SEND_S):
                if isinstance(what, str):
                    await self._websocket.send_text(what)
                else:
                    head = header(what.stream.number, what.count, what.stream.dropped)
                    await self._websocket.send_bytes(head + what.body)

    async def _receive(self) -> None:
        pace: Pace | None = self._websocket.state.pace
        free = 0.0
        while True:
            message = await self._websocket.receive()
            if message["type"] == "websocket.disconnect":
                raise WebSocketDisconnect(message.get("code") or 1000)
            if pace is not None and time.monotonic() < free:
                await pace.turn(self._person)
            free = time.monotonic() + FREE_S
            text = message.get("text")
            if text is None:
                raise MalformedRequest("is binary; send JSON text")
            asked = read_request(text)
            if isinstance(asked, Here):
                self._outbox.answers, self._outbox.unanswered = True, 0
                continue
            try:
                self._do(asked)
            except TwodofError as error:
                self._say({"event": "refused", "id": asked.id, **refusal_of(error)})

    def _do(self, asked: Subscribe | Unsubscribe) -> None:
        self._end(asked.id)
        if not isinstance(asked, Subscribe):
            return
        if len(self._streams) >= MOST_STREAMS:
            raise TwodofError(f"there are {MOST_STREAMS} subscriptions already", "telemetry", "end one first")
        key = FeedKey(asked.known_columns(), asked.rate, self._outbox.role)
        feeds = self._lab.drones[asked.drone].feeds
        stream = StreamState(asked.id)
        feeds.add(key, stream, self._outbox)
        self._streams[asked.id] = (stream, asked.drone)

    def _end(self, number: int) -> None:
        stream, drone = self._streams.pop(number, (None, 0))
        if stream is not None:
            stream.ended = True
            self._lab.drones[drone].feeds.remove(stream)

    def _say(self, event: dict[str, object]) -> None:
        self._outbox.tell(dumps(event))
