"""Parameters of a drone: read, listed, set one or several at once, undone."""

import asyncio
import json
from collections import deque
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import count
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from twodof.errors import ParameterError, Rejected, Timeout, is_number, listed, shown
from twodof.gcs.drone_state import StatusTexts, words_of
from twodof.gcs.files import AsyncFiles
from twodof.gcs.session import Deadline, DroneSession
from twodof.link.mavlink.messages import float_of_int, int_of_float, message
from twodof.parameters import PARAMETERS, Parameter

INT32, REAL32 = 6, 9
"""MAV_PARAM_TYPE."""
MOST = 5000
"""Most parameters kept of one drone."""
BY_NAME: Mapping[str, Parameter] = MappingProxyType(
    {name: row for row in PARAMETERS for name in (row.name, row.drone) if name}
)
"""Parameters known to the package, by its own names and the real drone's."""
_TYPES = MappingProxyType({"Int32": "int32", "Float": "float"})
_LARGEST = 3.4028234663852886e38  # of float32, for parameters without bounds


@dataclass(frozen=True)
class ParameterDescription(Parameter):
    """Parameter as the drone describes it; `path` is its place in a user's controller that flies."""

    path: str = ""


class ParameterEntry(NamedTuple):
    """Parameter as the drone sent it: its MAV_PARAM_TYPE, its index, and its description if that was read."""

    name: str
    value: float
    kind: int
    place: int
    described: ParameterDescription | None = None

    @property
    def row(self) -> Parameter | None:
        """Bounds, unit and text: from the drone's description, else from `twodof.parameters`, else None."""
        return self.described or BY_NAME.get(self.name)

    def to_json(self) -> dict[str, Any]:
        """Return name, value, default, bounds, unit, text and path; None or "" where one is unknown."""
        row = self.row
        numbers = {key: None if row is None else getattr(row, key) for key in ("default", "low", "high")}
        texts = {key: "" if row is None else getattr(row, key) for key in ("unit", "text")}
        path = "" if self.described is None else self.described.path
        return {"name": self.name, "value": self.value, **numbers, **texts, "path": path}


def same_as(name: str) -> str:
    """Return the package's name of a parameter if `name` is the real drone's name of it, else ""."""
    row = BY_NAME.get(name)
    return "" if row is None or row.name == name else row.name


def entry_of(got: Any) -> ParameterEntry:
    """Return the entry of a PARAM_VALUE."""
    value = float(int_of_float(got.param_value)) if got.param_type == INT32 else _decimal(got.param_value)
    return ParameterEntry(str(got.param_id), value, int(got.param_type), int(got.param_index))


def read_description(content: bytes) -> list[ParameterDescription]:
    """Return the rows of a drone's parameters.json. Raises ValueError, LookupError, TypeError, ParameterError."""
    return [_described(row) for row in json.loads(content)["parameters"][:MOST]]


def _described(row: Any) -> ParameterDescription:
    kind = _TYPES[row["type"]]
    low, high = (-_LARGEST, _LARGEST) if kind == "float" else (-(2**31), 2**31 - 1)
    return ParameterDescription(
        str(row["name"]),
        row["default"],
        row.get("min", low),
        row.get("max", high),
        str(row.get("units", "")),
        str(row.get("shortDesc", "")),
        kind="float" if kind == "float" else "int32",
        path=str(row.get("path", "")),
        tuning="path" in row,
    )


def checked(entry: ParameterEntry, value: float) -> float:
    """Return `value` if the parameter can have it. Raises ParameterError."""
    row = entry.row
    if not is_number(value):
        raise ParameterError(f"{shown(value)} is not a number", entry.name, "give a finite one; nothing was changed")
    if entry.kind not in (INT32, REAL32):
        what = f"has the MAV_PARAM_TYPE {entry.kind}, which cannot be set from here"
        raise ParameterError(what, entry.name, "set it with another ground station")
    if entry.kind == INT32 and (value != int(value) or not -(2**31) <= value < 2**31):
        raise ParameterError(f"{value:g} is not an int32", entry.name, "give a whole number; nothing was changed")
    if row is not None and not row.low <= value <= row.high:
        what = f"{value:g} is outside {row.low:g} to {row.high:g} {row.unit}"
        raise ParameterError(what, entry.name, "give a value within; nothing was changed")
    return value


def _decimal(value: float) -> float:
    """Return the shortest decimal of a float32: 0.07 was sent, 0.07 is read."""
    return float(str(np.float32(value)))


HASH = "_HASH_CHECK"
TIMEOUT_S = 5.0
SILENCE_S = 1.0
"""A plain PX4 does not answer for an unknown name: after this time [s] its list is read."""
DESCRIPTION = "/etc/extras/parameters.json"
BEGIN, COMMIT, ROLL_BACK = range(3)
UNDO_STEPS = 50
"""Most changes that can be undone, one after the other."""
_INCOMPLETE = 8  # MAV_PARAM_ERROR_READ_FAIL: some were lost on the way


class SentChange(NamedTuple):
    """Change by this client: the values before and after, by the names given."""

    before: Mapping[str, float]
    after: Mapping[str, float]


class AsyncParameters:
    """Parameters of one drone by its own names or the package's; `known` are the entries heard so far.

    Parameters of a user's controller also have their paths as names: `attitude_control.k_q`. The known entries are
    forgotten when the drone's list changes because of another controller.
    """

    def __init__(self, session: DroneSession, files: AsyncFiles, texts: StatusTexts) -> None:
        self._session, self._files, self._texts = session, files, texts
        self._spoken = 0  # lines of text before the present change
        self.known: dict[str, ParameterEntry] = {}
        self._described: dict[str, ParameterDescription] = {}
        self._paths: dict[str, str] = {}
        self._asked_for_list = False
        self._whole = False  # `known` is the whole list
        self._total = 0
        self._flown: int | None = None
        self._numbers = count(1)
        self._changing = asyncio.Lock()
        self._made: deque[SentChange] = deque(maxlen=UNDO_STEPS)
        self._awaited: tuple[SentChange, dict[str, float]] | None = None  # not confirmed in time, and values on board
        session.on(self._told, "PARAM_VALUE")
        session.on(self._flies, "TWODOF_RIG")

    @property
    def system(self) -> int:
        """The drone's system id."""
        return self._session.system

    async def read(self, name: str, timeout: float = TIMEOUT_S) -> float:
        """Read a value from the drone. Raises ParameterError for an unknown name, LinkLost, Timeout."""
        deadline = self._session.deadline(timeout, f"reading {shown(name)}")
        return (await self._ask(await self._on_board(name, deadline), deadline)).value

    async def set(self, name: str, value: float, timeout: float = TIMEOUT_S) -> None:
        """Set one parameter and wait until the drone confirms it. Raises as `update`."""
        await self.update({name: value}, timeout)

    async def update(self, changes: Mapping[str, float], timeout: float = TIMEOUT_S) -> SentChange:
        """Set several parameters, all or none. Return the values before and after.

        Raises ParameterError for a value out of bounds, Rejected, LinkLost, Timeout. If the drone reports the values
        after a Timeout, a text says so, and `undo` takes them back.

        A twodof drone changes them in one transaction, at one tick. Its number tells the answer from late ones to
        earlier changes. On a plain PX4 earlier ones are set back if a later one is refused. Several calls at once run
        one after the other.
        """
        if not changes:
            return SentChange({}, {})
        deadline = self._session.deadline(timeout, f"setting {listed(changes, 3)}")
        async with self._alone(deadline):
            made = await self._update(changes, deadline)
        if made.before != made.after:
            self._made.append(made)
        return made

    async def _update(self, changes: Mapping[str, float], deadline: Deadline) -> SentChange:
        self._awaited = None
        names = [await self._on_board(name, deadline) for name in changes]
        # Not the known entries: the message of another client's change may be lost, and `undo` sets these values.
        entries = [await self._ask(name, deadline) for name in names]
        if len({entry.name for entry in entries}) < len(entries):
            raise ParameterError("a parameter is given twice", listed(changes), "nothing was changed")
        wanted = [(entry, checked(entry, value)) for entry, value in zip(entries, changes.values(), strict=True)]
        after = [float(value) if entry.kind == INT32 else _decimal(value) for entry, value in wanted]
        before = [entry.value for entry in entries]
        made = SentChange(dict(zip(changes, before, strict=True)), dict(zip(changes, after, strict=True)))
        on_board = dict(zip(names, after, strict=True))
        try:
            await (self._together if self._session.ours else self._one_by_one)(wanted, deadline)
        except Timeout:
            if not self._has(on_board):
                self._awaited = made, on_board
                raise deadline.error("the drone may take it yet: look at the values, then set them again") from None
        for entry, value in zip(entries, after, strict=True):
            if entry.name in self.known:
                self.known[entry.name] = entry._replace(value=value)
        return made

    def _has(self, values: Mapping[str, float]) -> bool:
        """Return True if the drone's last messages have these values."""
        return all(name in self.known and self.known[name].value == value for name, value in values.items())

    @property
    def last(self) -> SentChange:
        """The last change by this client that is not undone. Raises Rejected if there is none."""
        if not self._made:
            where = self._session.where
            raise Rejected("this client has made no change that could be undone", where, "set the values yourself")
        return self._made[-1]

    async def undo(self, timeout: float = TIMEOUT_S) -> SentChange:
        """Undo the last change by this client. Return the values before and after.

        Raises Rejected if there is none, or if another client has changed these parameters since; LinkLost, Timeout.
        """
        self._session.check(self._session.now)
        made = self.last
        deadline = self._session.deadline(timeout, "undoing the last change of parameters")
        async with self._alone(deadline):
            now = {name: (await self._ask(await self._on_board(name, deadline), deadline)).value for name in made.after}
            if since := [name for name, value in made.after.items() if now[name] != value]:
                what = f"{listed(since)} changed since then"
                raise Rejected(what, self._session.where, "set the values yourself")
            undone = await self._update(made.before, deadline)
        if made in self._made:
            self._made.remove(made)
        return undone

    async def all(self, timeout: float = 30.0) -> dict[str, ParameterEntry]:
        """Return every parameter, by the drone's names. Raises LinkLost, Timeout."""
        return await self._list(self._session.deadline(timeout, "listing the parameters"))

    async def describe(self, timeout: float = 30.0) -> dict[str, ParameterDescription]:
        """Read the drone's description of every parameter, by the drone's names: bounds, unit, text.

        Raises Rejected if the drone has no description, as a plain PX4; LinkLost, Timeout.
        """
        await self._describe(self._session.deadline(timeout, "asking for the description of the parameters"))
        return dict(self._described)

    def forget(self) -> None:
        """Forget all entries and descriptions."""
        self.known.clear()
        self._described.clear()
        self._paths.clear()
        self._whole = False

    async def _list(self, deadline: Deadline) -> dict[str, ParameterEntry]:
        self._asked_for_list = True
        try:
            found = await self._ask_for_all(deadline)
        finally:
            self._asked_for_list = False
        if self._described.keys() - found.keys():
            self.forget()
        self.known |= found
        self._whole = True
        return found

    async def _ask_for_all(self, deadline: Deadline) -> dict[str, ParameterEntry]:
        session, place = self._session, self._session.target
        found: dict[int, ParameterEntry] = {}
        total = MOST

        def question(_: int) -> Any:
            """Ask for the list, or for the first missing entries of a list that came in part."""
            missing = [index for index in range(min(total, MOST)) if found and index not in found][:50]
            for index in missing[1:]:
                session.send(message("PARAM_REQUEST_READ", param_index=index, **place))
            if missing:
                return message("PARAM_REQUEST_READ", param_index=missing[0], **place)
            return message("PARAM_REQUEST_LIST", **place)

        def accept(got: Any) -> dict[int, ParameterEntry] | None:
            nonlocal total
            begins = got.param_id == HASH  # the list starts, perhaps again
            fits = not begins and got.param_index < got.param_count <= MOST
            if begins or (fits and got.param_count != total):
                found.clear()
            if fits:
                total = got.param_count
                found[got.param_index] = self._entry(got)
            return found if len(found) >= total else None

        await session.ask(question, ("PARAM_VALUE",), accept, deadline, prolonged=True)
        return {found[index].name: found[index] for index in sorted(found)}

    async def _describe(self, deadline: Deadline) -> None:
        if not self._session.ours:
            what = "this is not a twodof drone and has no description of its parameters"
            raise Rejected(what, deadline.where, "parameters.all() lists them")
        content = await self._files.read(DESCRIPTION, deadline.left)
        try:
            rows = read_description(content)
        except (ValueError, LookupError, TypeError, RecursionError, ParameterError) as damage:
            what = f"the drone's description of its parameters cannot be read: {damage}"
            raise Rejected(what, deadline.where, "parameters.all() lists them") from damage
        self._described = {row.name: row for row in rows}
        self._paths = {row.path: row.name for row in rows if row.path}
        self.known = {name: entry._replace(described=self._described.get(name)) for name, entry in self.known.items()}

    def name_on_board(self, name: str) -> str:
        """Return the drone's name of a parameter: as given if it is known, else the package's or the real drone's."""
        name = self._paths.get(name, name)
        row = BY_NAME.get(name)
        if name in self.known or row is None:
            return name
        other = row.drone if name == row.name else row.name
        return other if other in self.known else name

    async def _one_by_one(self, wanted: list[tuple[ParameterEntry, float]], deadline: Deadline) -> None:
        done: list[tuple[ParameterEntry, float]] = []
        for entry, value in wanted:
            try:
                await self._set(entry, value, deadline)
            except Rejected:
                for before, _ in reversed(done):
                    await self._set(before, before.value, deadline)
                raise
            done.append((entry, value))

    async def _set(self, entry: ParameterEntry, value: float, deadline: Deadline) -> None:
        asked, other = self._set_message(entry, value), None

        def question(_: int) -> Any:
            """Ask again unless another value was the last word: the answer to an earlier request may come first."""
            if other is not None:
                what = f"{entry.name} is {other:g} and not {value:g}"
                raise Rejected(what, self._session.where, "read the drone's messages, then set it again")
            return asked

        def accept(got: Any) -> bool | None:
            nonlocal other
            if got.get_type() == "PARAM_ERROR":
                self._refused(got, entry.name)
            elif got.param_id == entry.name:
                other = entry_of(got).value
                return np.float32(other) == np.float32(value) or None
            return None

        await self._session.ask(question, ("PARAM_VALUE", "PARAM_ERROR"), accept, deadline)

    async def _together(self, wanted: list[tuple[ParameterEntry, float]], deadline: Deadline) -> None:
        """Set several in one transaction, repeated until all have arrived; one number is done once only."""
        while True:
            number = next(self._numbers) & 0xFFFF
            # A PARAM_SET that comes before the transaction begins acts alone.
            await self._transaction(BEGIN, number, deadline)
            if await self._transaction(COMMIT, number, deadline, wanted):
                return

    async def _transaction(
        self, action: int, number: int, deadline: Deadline, wanted: Sequence[tuple[ParameterEntry, float]] = ()
    ) -> bool:
        """Do one step; return False if some of `wanted` did not arrive. Raises Rejected, LinkLost, Timeout."""

        def question(_: int) -> Any:
            for entry, value in wanted:
                self._session.send(self._set_message(entry, value))
            place = self._session.target
            return message("TWODOF_PARAM_TRANSACTION", transaction=number, count=len(wanted), action=action, **place)

        def accept(got: Any) -> bool | None:
            if got.transaction != number or got.action != action:
                return None
            if got.result and not (wanted and got.result == _INCOMPLETE):
                what = self._why(got.param_id or "the change", got.result)
                remedy = "remove this cause and try again; nothing was changed"
                raise Rejected(what, f"{self._session.where}, {deadline.doing}", remedy)
            return not got.result

        return await self._session.ask(question, ("TWODOF_PARAM_TRANSACTION",), accept, deadline)

    @asynccontextmanager
    async def _alone(self, deadline: Deadline) -> AsyncIterator[None]:
        """Allow one change at a time: another one would become part of an open transaction."""
        async with deadline.turn(self._changing, "another call on this drone changes parameters: wait for it"):
            self._spoken = self._texts.count
            yield

    async def _on_board(self, name: str, deadline: Deadline) -> str:
        """Return the drone's name; read the description for an unknown path. Raises ParameterError."""
        if not isinstance(name, str):
            raise ParameterError(f"{shown(name)} is not a name", "parameters", "give a parameter's name as text")
        if "." in name and self._session.ours and name not in self._paths:
            await self._describe(deadline)
            if name not in self._paths:
                raise self._unknown(name)
        return self.name_on_board(name)

    async def _ask(self, name: str, deadline: Deadline) -> ParameterEntry:
        """Read one entry; if a plain PX4 does not answer, look it up in the drone's list."""
        if self._session.ours:
            return await self._ask_for(name, deadline)
        try:
            # Even with its list: PX4 lists the parameters in use, and answers for others by name.
            return await self._ask_for(name, self._session.deadline(min(SILENCE_S, deadline.left), deadline.doing))
        except Timeout:
            pass
        try:
            if not self._whole:
                await self._list(deadline)
        except Timeout:
            raise deadline.error(
                "a plain PX4 does not answer for a name that it lacks: parameters.all() lists its names"
            ) from None
        found = self.known.get(self.name_on_board(name))  # the list tells which of two names it has
        if found is None:
            raise self._unknown(name)
        return found

    async def _ask_for(self, name: str, deadline: Deadline) -> ParameterEntry:
        if not name.isascii() or not 1 <= len(name) <= 16:
            raise ParameterError(
                f"{shown(name)} is not a name of 1 to 16 ASCII characters",
                "parameters",
                "paths in a diagram are names on a twodof drone only" if "." in name else "parameters.all() lists all",
            )

        def accept(got: Any) -> ParameterEntry | None:
            if got.get_type() == "PARAM_ERROR":
                self._refused(got, name)
                return None
            return self._entry(got) if got.param_id == name else None

        asked = message("PARAM_REQUEST_READ", param_id=name, param_index=-1, **self._session.target)
        return await self._session.ask(asked, ("PARAM_VALUE", "PARAM_ERROR"), accept, deadline)

    def _refused(self, got: Any, name: str) -> None:
        if got.param_id != name or not got.error:
            return
        if got.error == 1:
            raise self._unknown(name)
        remedy = "remove this cause and try again; nothing was changed"
        raise Rejected(self._why(name, got.error), self._session.where, remedy)

    def _why(self, name: str, error: int) -> str:
        """Return why a change is refused: the drone's last warning, else the words for the number."""
        said = self._texts.reasons_since(self._spoken)
        return f"{name}: {said[-1].text if said else words_of('MAV_PARAM_ERROR', error)}"

    def _unknown(self, name: str) -> ParameterError:
        """Return the error for an unknown name, with the nearest names that the drone has."""
        ours = [one for one in BY_NAME if not self._whole or self.name_on_board(one) in self.known]
        names = {known.casefold(): known for known in (*ours, *self.known, *self._paths)}
        near = [names[one] for one in get_close_matches(name.casefold(), names, 3, 0.5)]
        remedy = f"the nearest: {', '.join(near)}" if near else "parameters.all() lists them"
        return ParameterError("the drone has no such parameter", name, remedy)

    def _flies(self, got: Any) -> None:
        if self._flown not in (None, got.diagram):
            self.forget()
        self._flown = got.diagram

    def _told(self, got: Any) -> None:
        expected = got.param_id == HASH and self._asked_for_list  # it stands before every list
        if (got.param_id == HASH and not expected) or self._total not in (0, got.param_count):
            self.forget()
        self._asked_for_list &= not expected
        self._total = got.param_count
        if got.param_id != HASH and (got.param_id in self.known or len(self.known) < MOST):
            self.known[got.param_id] = self._entry(got)
        if self._awaited is not None and self._has(self._awaited[1]):
            made, self._awaited = self._awaited[0], None
            self._made.append(made)
            self._texts.note("notice", f"the drone has taken the late change of {listed(made.after, 3)}")

    def _entry(self, got: Any) -> ParameterEntry:
        return entry_of(got)._replace(described=self._described.get(got.param_id))

    def _set_message(self, entry: ParameterEntry, value: float) -> Any:
        carried = float_of_int(int(value)) if entry.kind == INT32 else float(value)
        return message(
            "PARAM_SET", param_id=entry.name, param_value=carried, param_type=entry.kind, **self._session.target
        )
