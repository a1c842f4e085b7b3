"""Answers without an address: PARAM_VALUE, the log messages and MESSAGE_INTERVAL name nobody: it counts who asked."""

from twodof.companion import frame_fields
from twodof.companion.client import CompanionClient
from twodof.link.mavlink.framing import Frame

# A list of parameters goes on without a word from the client; each value that comes shows that it still does.
OPEN_S = 5.0
_ASK_PARAMETERS = frozenset({frame_fields.PARAM_REQUEST_READ, frame_fields.PARAM_REQUEST_LIST})
_ASK_LOGS = frozenset({frame_fields.LOG_REQUEST_LIST, frame_fields.LOG_REQUEST_DATA})
_CHANGE = frozenset({frame_fields.PARAM_SET, frame_fields.PARAM_TRANSACTION})
_INTERVALS = "intervals"
_ANSWERS = {
    frame_fields.MESSAGE_INTERVAL: _INTERVALS,
    frame_fields.PARAM_VALUE: "parameters",
    frame_fields.LOG_ENTRY: "logs",
    frame_fields.LOG_DATA: "logs",
}


class ReplyRouting:
    """Who has asked for parameters or logs, and until when what comes is for them."""

    def __init__(self) -> None:
        self._open: dict[str, dict[CompanionClient, float]] = {"parameters": {}, "logs": {}, _INTERVALS: {}}
        self._changing = 0.0

    def asked(self, client: CompanionClient, frame: Frame, now: float) -> None:
        """A frame of a client is on its way to the vehicle."""
        number = frame.message_id
        if number in _ASK_PARAMETERS:
            self._open["parameters"][client] = now + OPEN_S
        elif number in _ASK_LOGS:
            self._open["logs"][client] = now + OPEN_S
        elif number in _CHANGE:
            self._changing = now + OPEN_S

    def interval(self, client: CompanionClient, now: float) -> None:
        """A client's question about an interval is on its way to the vehicle."""
        self._open[_INTERVALS][client] = now + OPEN_S

    def forget(self, client: CompanionClient) -> None:
        """A client has gone."""
        for waiting in self._open.values():
            waiting.pop(client, None)

    def receivers(self, frame: Frame, now: float) -> list[CompanionClient] | None:
        """Who gets a message of the vehicle; None: it is not such an answer, or it concerns everybody.

        While a client changes parameters, what comes of it concerns everybody.
        """
        kind = _ANSWERS.get(frame.message_id)
        if kind is None or (kind == "parameters" and now < self._changing):
            return None
        waiting = self._open[kind]
        for client in [client for client, until in waiting.items() if until < now]:
            del waiting[client]
        for client in waiting:
            waiting[client] = now + OPEN_S
        return [*waiting] or None
