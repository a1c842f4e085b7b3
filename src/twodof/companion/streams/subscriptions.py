"""What clients ask about their streams, answered in the vehicle's name: commands 510, 511, 512, REQUEST_DATA_STREAM."""

from collections.abc import Callable
from math import isfinite
from typing import Any

from twodof.companion import frame_fields
from twodof.companion.client import CompanionClient, Identity, Wish, is_ours
from twodof.companion.reply_routing import ReplyRouting
from twodof.companion.streams.batch_repacking import BatchRepacker
from twodof.companion.streams.interval_requests import IntervalRequests
from twodof.companion.streams.rate_profiles import EVERY, OFF, group
from twodof.companion.streams.stream_thinning import ClientStreams, events, settled
from twodof.link.mavlink.framing import Frame, decode
from twodof.link.mavlink.messages import BATCH_VALUES, message
from twodof.signals import TICK_US

ACCEPTED, TEMPORARILY_REJECTED, DENIED = 0, 1, 2
_ABOUT_MESSAGES = (frame_fields.SET_MESSAGE_INTERVAL, frame_fields.GET_MESSAGE_INTERVAL, frame_fields.REQUEST_MESSAGE)
LONGEST_US = 2**31 - 1
MOST_TOLD = 0xFFFF  # MESSAGE_INTERVAL's field for the message has two bytes


class Subscriptions:
    """Keeps what each client wants, and asks the vehicle for what they want together.

    `ask(message id, wish)` sends to the vehicle, `say(client, message)` to a client in the vehicle's name; with `signs`
    it is signed.
    """

    def __init__(
        self,
        streams: ClientStreams,
        batches: BatchRepacker,
        answers: ReplyRouting,
        ask: Callable[[int, Wish], None],
        say: Callable[[CompanionClient, Any], None],
        clock: Callable[[], float],
        signs: bool,
    ) -> None:
        self.streams = streams
        self.asking = IntervalRequests(ask, streams.granted)
        self._batches = batches
        self._answers = answers
        self._say = say
        self._clock = clock
        self._signs = signs

    def refresh(self) -> None:
        """Ask the vehicle again for what the present clients want together."""
        self.streams.changed()
        now = self._clock()
        kept = {number for client in self.streams.clients for number in client.wishes}.union(settled())
        for number in sorted(kept | set(self.asking.granted)):
            self.asking.want(number, self.streams.wanted(number), now)
        for number in self.asking.known - kept:  # who comes and goes leaves nothing behind
            granted = self.asking.granted.get(number)
            if granted is None or granted.interval in (OFF, EVERY):
                self.asking.forget(number)

    def restart(self) -> None:
        """The vehicle has forgotten what it was asked for."""
        self.asking.restart()
        self.refresh()

    def notice(self, client: CompanionClient, frame: Frame, asked: frame_fields.CommandFields | None) -> None:
        """See whether a client knows twodof's own messages: it sends one, or asks about one."""
        about = asked is not None and asked.command in _ABOUT_MESSAGES and is_ours(_whole(asked.params[0]))
        if about or is_ours(frame.message_id):
            client.knows_ours = True
            self.refresh()

    def take(
        self, client: CompanionClient, frame: Frame, asked: frame_fields.CommandFields, on_board: bool = False
    ) -> bool:
        """A command of a client to the vehicle; whether it was ours to answer, and is not to be passed on.

        `on_board`: it is a program of the drone's own, which must not know the truth.
        """
        if asked.command not in _ABOUT_MESSAGES:
            return False
        number = _whole(asked.params[0])
        if on_board and number == frame_fields.TRUTH:
            self._acknowledge(client, asked.command, (frame.system, frame.component), DENIED)
            return True
        if asked.command == frame_fields.SET_MESSAGE_INTERVAL:
            return self._set(client, frame, number, asked.params)
        if asked.command == frame_fields.GET_MESSAGE_INTERVAL:
            return self._get(client, frame, number, asked.command)
        if number == frame_fields.MESSAGE_INTERVAL:
            return self._get(client, frame, _whole(asked.params[1]), asked.command)
        if number in frame_fields.places():
            client.due_once[number] = 1
        return False

    def take_group(self, client: CompanionClient, frame: Frame) -> None:
        """REQUEST_DATA_STREAM, which ArduPilot's clients send; it has no answer."""
        got: Any = decode(frame)
        rate, start = got.req_message_rate, got.start_stop
        if start and not rate:
            return
        chosen = group(got.req_stream_id)
        for each, default in client.defaults.items():
            if default > EVERY and (chosen is None or each in chosen):
                self.streams.set(client, each, Wish(round(1e6 / rate)) if start else Wish(OFF))
                self.asking.want(each, self.streams.wanted(each), self._clock())

    def _set(self, client: CompanionClient, frame: Frame, number: int, params: tuple[float, ...]) -> bool:
        source = (frame.system, frame.component)
        fits, wish = _wish(number, params)
        if not self._answerable(frame):
            # What the vehicle is told now holds for all. We keep what this client asked for, lest it be thinned out.
            if fits:
                self.streams.set(client, number, wish)
            return False
        if number == frame_fields.BATCH:
            self._batches.flush(client)
        before = client.wishes.get(number)
        if not fits or not self.streams.set(client, number, wish):
            self._acknowledge(
                client, frame_fields.SET_MESSAGE_INTERVAL, source, TEMPORARILY_REJECTED if fits else DENIED
            )
            return True

        def then(result: int) -> None:
            if result and client.wishes.get(number) == wish:
                self.streams.set(client, number, before)
            self._acknowledge(client, frame_fields.SET_MESSAGE_INTERVAL, source, result)

        self.asking.want(number, self.streams.wanted(number), self._clock(), then)
        return True

    def _get(self, client: CompanionClient, frame: Frame, number: int, command: int) -> bool:
        ours = 0 <= number <= MOST_TOLD and self.streams.chosen(number) and client.wish(number) != EVERY
        if not ours or not self._answerable(frame):
            self._answers.interval(client, self._clock())
            return False
        self._acknowledge(client, command, (frame.system, frame.component), ACCEPTED)
        self._say(client, message("MESSAGE_INTERVAL", message_id=number, interval_us=client.wish(number)))
        return True

    def _answerable(self, frame: Frame) -> bool:
        """Whether we can answer in the vehicle's name: where we have the key, or the question is not signed."""
        return self._signs or not frame.signed

    def _acknowledge(self, client: CompanionClient, command: int, to: Identity, result: int) -> None:
        there = {"target_system": to[0], "target_component": to[1]}
        self._say(client, message("COMMAND_ACK", command=command, result=result, **there))


def _wish(number: int, params: tuple[float, ...]) -> tuple[bool, Wish | None]:
    """Whether command 511's numbers make sense, and what they ask for; None is the default again."""
    interval = params[1]
    if not isfinite(interval) or number in events() or not 0 <= number < 1 << 24:
        return False, None
    every = round(min(max(interval, -1.0), LONGEST_US))
    if number == frame_fields.BATCH:
        mask = max(_whole(params[2]), 0) & 0xFFFF | (max(_whole(params[3]), 0) & 0xFFFF) << 16
        if every == OFF:
            return True, Wish(OFF)
        return 1 <= mask.bit_count() <= BATCH_VALUES, Wish(every or TICK_US, mask)
    return True, None if every == 0 else Wish(every)


def _whole(value: float) -> int:
    return round(value) if isfinite(value) and abs(value) < 2**31 else -1
