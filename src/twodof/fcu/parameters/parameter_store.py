"""Store of the vehicle's parameters: bounded and typed, changed all or none, kept in a file that survives a crash."""

import json
import threading
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Self

from twodof.errors import ParameterError, TwodofError, listed
from twodof.fcu.control.loop import OnboardEventBus
from twodof.fcu.parameters.table import UserParameters, VehicleParameter, vehicle_rows, wire_rows
from twodof.flightlog.atomic import atomic_write, make_folder
from twodof.parameters import TUNABLES, ParameterSet, float32_decimal

VERSION = 1
MAX_BYTES = 1 << 20
GATHER_S = 0.25
"""Time from a first change of the values until the file is written [s], with the changes that come meanwhile."""
RETRY_S = 5.0


@dataclass(frozen=True)
class TunedController:
    """Values that differ from the defaults in a controller, by path; `identity` is its diagram's SHA-256."""

    kind: str
    name: str
    identity: str
    values: Mapping[str, float]


@dataclass(frozen=True)
class StoredParameters:
    """Content of the file: values by name, and the tuned controllers, the latest last."""

    values: Mapping[str, float] = field(default_factory=dict)
    controllers: tuple[TunedController, ...] = ()


class StoreFile:
    """Reader and writer of the file; `failure` is the reason why the last writing failed, None if it succeeded."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.failure: TwodofError | None = None
        self._changed = threading.Condition()
        self._wanted: StoredParameters | None = None
        self._at_once = self._closing = False
        self._begun = self._tries = 0  # how often writing was begun, and ended
        self._thread: threading.Thread | None = None

    def read(self) -> tuple[StoredParameters, str]:
        """Read the file; return its content and its fault, "" if there is none. A damaged file becomes NAME.damaged."""
        try:
            if self.path.stat().st_size > MAX_BYTES:
                raise ValueError(f"is larger than {MAX_BYTES} bytes")
            return _kept(json.loads(self.path.read_text(encoding="utf-8"))), ""
        except FileNotFoundError:
            return StoredParameters(), ""
        except (OSError, ValueError, RecursionError, TypeError) as reason:
            return StoredParameters(), self._set_aside(str(reason))

    def write(self, kept: StoredParameters) -> None:
        """Write `kept` soon; returns at once."""
        with self._changed:
            self._wanted = kept
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name=f"store {self.path.name}", daemon=True)
                self._thread.start()
            self._changed.notify_all()

    def flush(self, deadline_s: float) -> None:
        """Write the waiting content now, and wait until it is on the disk.

        Raises ParameterError if the disk refuses, or does not answer within `deadline_s` [s].
        """
        with self._changed:
            self._at_once = self._wanted is not None
            number = self._begun + 1  # one that is under way may be writing what was given before
            self._changed.notify_all()
            done = self._changed.wait_for(lambda: self._wanted is None or self._tries >= number, deadline_s)
            if done and self._wanted is not None and self.failure is not None:
                remedy = "store them on another disk: the values fly, but are not stored"
                raise ParameterError(self.failure.what, self.failure.where, remedy)
            if not done:
                silent = f"the disk did not answer within {deadline_s:g} s"
                raise ParameterError(silent, str(self.path), "store them on another disk")

    def close(self, deadline_s: float) -> None:
        """Write the waiting content and end the thread. Raises ParameterError as `flush`."""
        thread = self._thread
        if thread is None or self._closing:
            return
        try:
            self.flush(deadline_s)
        finally:
            with self._changed:
                self._closing = True
                self._changed.notify_all()
            thread.join(deadline_s)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._wanted is not None or self._closing)
                wait_s = RETRY_S if self.failure is not None else GATHER_S
                self._changed.wait_for(lambda: self._at_once or self._closing, wait_s)
                kept = self._wanted
                if kept is None or self._closing:
                    return
                self._at_once = False
                self._begun += 1
            failure = self._store(kept)
            with self._changed:
                self.failure = failure
                self._tries += 1
                if failure is None and self._wanted is kept:
                    self._wanted = None
                self._changed.notify_all()

    def _store(self, kept: StoredParameters) -> TwodofError | None:
        try:
            make_folder(self.path.parent)
            with atomic_write(self.path, "w") as file:
                file.write(text_of(kept))
        except TwodofError as refusal:
            return refusal
        except OSError as refusal:
            return ParameterError(f"cannot be written: {refusal.strerror}", str(self.path), "choose another folder")
        return None

    def _set_aside(self, what: str) -> str:
        """Rename an unusable file, so that it is not overwritten; return the fault."""
        aside = self.path.with_name(f"{self.path.name}.damaged")
        try:
            self.path.replace(aside)
        except OSError as refusal:
            return f"{self.path}: {what}; the defaults fly ({refusal.strerror})"
        return f"{self.path}: {what}; the defaults fly, the file is kept as {aside.name}"


def text_of(kept: StoredParameters) -> str:
    """Return the content of the file as text."""
    values = dict(sorted(kept.values.items()))
    tuned = [{**vars(one), "values": dict(sorted(one.values.items()))} for one in kept.controllers]
    content = {"version": VERSION, "crc": _crc(values, tuned), "parameters": values}
    return json.dumps(content | ({"controllers": tuned} if tuned else {}), indent=2)


def _crc(values: Mapping[str, Any], tuned: object) -> int:
    return zlib.crc32(json.dumps([values, tuned] if tuned else values, sort_keys=True).encode())


def _kept(content: object) -> StoredParameters:
    """Read a file's content. Raises ValueError or TypeError for damage."""
    if not isinstance(content, dict) or content.get("version") != VERSION:
        raise ValueError(f"is not of version {VERSION}")
    values, tuned = content.get("parameters"), content.get("controllers", [])
    if not isinstance(values, dict) or not isinstance(tuned, list) or content.get("crc") != _crc(values, tuned):
        raise ValueError("its checksum is wrong")
    found = tuple(TunedController(**one) for one in tuned)
    if not all(isinstance(one.values, dict) for one in found):
        raise ValueError("the values of a controller must be a table")
    return StoredParameters(values, found)


HASH_NAME = "_HASH_CHECK"
MOST_TUNED = 8
"""Most controllers whose tuning is kept, with those that fly now."""
SAVE_S = 5.0
"""Deadline for the disk to store the values [s]."""


class ParametersChanged(NamedTuple):
    """Event: values have changed. `values` has the new ones, under every name of each parameter."""

    values: Mapping[str, float]


class ParametersRelisted(NamedTuple):
    """Event: the list has other parameters than before."""


class ParameterStore(Mapping[str, float]):
    """The parameters of the vehicle `system`, with the values of the file `path`; `store.rows` describes them.

    A value is read by any of its names; an int32 is an int. A float is kept as the shortest decimal that rounds to the
    same float32. So 0.07 sent is 0.07 here, and flies as in a simulation with 0.07.

    `carry` adds the parameters of a user's controllers to the list. `defaults` are this vehicle's own, by path.

    It publishes ParametersChanged and ParametersRelisted on `bus` (None: a new one).

    Call everything from one thread; only reading values is safe from any. A thread of its own writes the file after
    changes; an error of the disk shows in `failure` and stops nothing. `remarks` says which values of the file could
    not be used. Close it by `close` or at the end of `with`.
    """

    def __init__(
        self,
        path: str | Path | None = None,
        system: int = 1,
        values: Mapping[str, float] | None = None,
        bus: OnboardEventBus | None = None,
        defaults: Mapping[str, float] | None = None,
    ) -> None:
        """Read the file; `values` take precedence over it. Raises ParameterError as `update` does."""
        self._vehicle = system, tuple((defaults or {}).items())
        self.carried: tuple[UserParameters, ...] = ()
        """The users' controllers that fly, with their parameters."""
        self._tuned: dict[str, TunedController] = {}  # by identity, those that fly last
        self._list()
        self._set = ParameterSet(table=vehicle_rows(*self._vehicle))
        self.bus = bus or OnboardEventBus()
        self._file = StoreFile(path) if path is not None else None
        self.remarks: tuple[str, ...] = ()
        if self._file is not None:
            self.remarks = self._take_over(self._file.read())
        if values:
            self.update(values)

    def __getitem__(self, name: str) -> float:
        """Return a value, by any of its names. Raises ParameterError for an unknown one."""
        return self._set[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._index)

    def __len__(self) -> int:
        return len(self.rows)

    def __contains__(self, name: object) -> bool:
        return name in self._index

    @property
    def revision(self) -> int:
        """Return the number of changes so far."""
        return self._set.revision

    @property
    def failure(self) -> TwodofError | None:
        """Return why the file could not be written the last time; None while all is well."""
        return self._file.failure if self._file is not None else None

    def row(self, name: str) -> VehicleParameter:
        """Return type, bounds, unit and text of the parameter `name`. Raises ParameterError for an unknown one."""
        return self.rows[self.index(name)]

    def index(self, name: str) -> int:
        """Return the index of `name` in `rows`, which is PARAM_VALUE.param_index. Raises ParameterError if unknown."""
        index = self._index.get(name)
        if index is None:
            raise ParameterError("no such parameter", str(name)[:40], f"there are {len(self.rows)}: list them")
        return index

    def flying(self) -> dict[str, float]:
        """Return the flight code's values by their paths in it; a flag is a bool."""
        return {
            row.path: bool(self._set[row.name]) if isinstance(TUNABLES[row.path].default, bool) else self._set[row.name]
            for row in self.rows
            if row.path and not row.of
        }

    def values_by_path(self) -> dict[str, Any]:
        """Return all values that fly by path: those of the flight code and of the users' controllers."""
        return self.flying() | self.user_values()

    def user_values(self) -> dict[str, Any]:
        """Return the values of the users' controllers by path (`attitude_control.k_q`): numbers, lists for arrays."""
        return {path: value for one in self.carried for path, value in one.flying(self._set).items()}

    def carry(self, users: Sequence[UserParameters]) -> tuple[str, ...]:
        """List the parameters of the controllers `users`, which fly from now on, in place of the earlier ones.

        A controller gets the values that were stored for exactly the same diagram, else its defaults. Return remarks on
        that, for the clients. All other parameters keep their values.
        """
        if [one.identity for one in users] == [one.identity for one in self.carried]:
            return ()
        self._keep_tuned()
        values = {row.name: self._set[row.name] for row in vehicle_rows(*self._vehicle)}
        self.carried = tuple(users)
        self._list()
        table = (*vehicle_rows(*self._vehicle), *(row for one in users for row in one.rows))
        fresh = ParameterSet(values, table)
        remarks: list[str] = []
        for one in users:
            remarks += self._restore(fresh, one)
        fresh.revision = self._set.revision + 1
        self._set = fresh
        self.bus.publish(ParametersRelisted())
        return tuple(remarks)

    def changed(self) -> dict[str, float]:
        """Return the values that differ from the defaults, by main name."""
        return {row.name: self._set[row.name] for row in self.rows if not row.of and self._set[row.name] != row.default}

    def set(self, name: str, value: float, armed: bool = False) -> None:
        """Change one value. Raises ParameterError as `update` does."""
        self.update({name: value}, armed)

    def update(self, changes: Mapping[str, float], armed: bool = False) -> None:
        """Change several values together, or none of them.

        Raises ParameterError, naming every fault: an unknown name, one parameter twice, a value of the wrong kind or
        outside its bounds. While `armed`, a parameter that only changes disarmed is a fault too.
        """
        good, faults = self._set.check(self._as_carried(changes))
        locked = [name for name, value in good.items() if self.row(name).disarmed and value != self._set[name]]
        faults += [f"{name}: is changed only while disarmed" for name in locked if armed]
        if faults:
            only_armed = armed and len(faults) == len(locked)
            remedy = "disarm first" if only_armed else "correct these values"
            raise ParameterError("; ".join(faults), "parameters", f"{remedy}; nothing was changed")
        before = self._set.snapshot()
        self._set.update(good)
        main = {row.name: row.of or row.name for row in self.rows}
        changed = {name: self._set[key] for name, key in main.items() if self._set[key] != before[key]}
        if changed:
            if self._file is not None:
                self._file.write(self._kept())
            self.bus.publish(ParametersChanged(changed))

    def reset(self, armed: bool = False) -> None:
        """Set all to their defaults. Raises ParameterError as `update` does."""
        self.update({row.name: row.default for row in self.rows if not row.of}, armed)

    def hash_check(self) -> int:
        """Return PX4's _HASH_CHECK: CRC-32 over names and values by index, begun with 0, not inverted."""
        crc = 0xFFFFFFFF  # zlib inverts what it is given and what it gives
        for row in self.rows:
            crc = zlib.crc32(row.bits(self._set[row.name]), zlib.crc32(row.name.encode("ascii"), crc))
        return crc ^ 0xFFFFFFFF

    @property
    def kept(self) -> bool:
        """Return whether the values are kept in a file."""
        return self._file is not None

    def save(self) -> None:
        """Write all values now. Raises ParameterError if the disk refuses, or does not answer for `SAVE_S`."""
        self.flush(SAVE_S)

    def flush(self, deadline_s: float = 10.0) -> None:
        """Wait until the file holds all values. Raises ParameterError if the disk refuses or does not answer."""
        if self._file is not None:
            self._file.flush(deadline_s)

    def close(self, deadline_s: float = 10.0) -> None:
        """Write the values and end. Raises ParameterError as `flush`; a second call only returns."""
        if self._file is not None:
            self._file.close(deadline_s)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _as_carried(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return values as wire and file carry them: a float as the shortest decimal with the same float32."""
        floats = {name for name in values if name in self._index and self.row(name).kind == "float"}
        return {name: float32_decimal(value) if name in floats else value for name, value in values.items()}

    def _list(self) -> None:
        """Sort all rows as PX4 does, by name."""
        users = (row for one in self.carried for row in one.rows)
        self.rows: tuple[VehicleParameter, ...] = tuple(
            sorted((*wire_rows(*self._vehicle), *users), key=lambda row: row.name)
        )
        self._index = {row.name: index for index, row in enumerate(self.rows)}

    def _keep_tuned(self) -> None:
        """Remember the tuning of the flying controllers, and forget the oldest."""
        for one in self.carried:
            self._tuned.pop(one.identity, None)
            values = {row.user_path: self._set[row.name] for row in one.rows if self._set[row.name] != row.default}
            if values:
                self._tuned[one.identity] = TunedController(one.kind, one.name, one.identity, values)
        while len(self._tuned) > MOST_TUNED:
            del self._tuned[next(iter(self._tuned))]

    def _kept(self) -> StoredParameters:
        self._keep_tuned()
        values = ((row, self._set[row.name]) for row in vehicle_rows(*self._vehicle))
        changed = {row.name: value for row, value in values if value != row.default}
        return StoredParameters(changed, tuple(self._tuned.values()))

    def _restore(self, fresh: ParameterSet, own: UserParameters) -> list[str]:
        """Give a controller the values that were stored for it. Return remarks on that."""
        tuned = self._tuned.get(own.identity)
        if tuned is None:
            other = [one for one in self._tuned.values() if one.kind == own.kind and one.name == own.name]
            if not other:
                return []
            left = f"another diagram: {len(other[-1].values)} stored values of an earlier one are left out"
            return [f"{own.kind}: {own.name} is {left}"]
        names = {row.user_path: row for row in own.rows}
        known = {names[path].name: value for path, value in tuned.values.items() if path in names}
        good, faults = fresh.check(self._as_carried(known))
        fresh.update(good)
        said = f"{own.kind}: flies as it was tuned before: {listed(good, 3)}"
        return [*([said] if good else []), *(f"{own.kind}: left out: {fault}" for fault in faults)]

    def _take_over(self, found: tuple[StoredParameters, str]) -> tuple[str, ...]:
        """Use each valid value of the file; return remarks on the others."""
        kept, remark = found
        good, faults = self._set.check(self._as_carried(kept.values))
        self._set = ParameterSet(good, vehicle_rows(*self._vehicle))
        self._tuned = {one.identity: one for one in kept.controllers[-MOST_TUNED:]}
        return (*((remark,) if remark else ()), *faults)
