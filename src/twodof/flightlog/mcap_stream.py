"""Topic of a recording in MCAP: its name, its schema, and the layout of its messages.

Messages are ROS 2's (schema `ros2msg`, encoding `cdr`), because Foxglove Studio and rosbags read them as they are. A
message is a CDR head of four bytes and then float64 values. All are aligned, so a run of messages is one table of fixed
rows. Units and the names of the drone's channels have no place in ROS: they are JSON in the channel's metadata.

Time is a whole number of nanoseconds; in a FlightLog it is that number / 1e9, rounded once, exact to the bit up to
104 days. Not every stamp survives this: the drone's own are microseconds * 1e-6, often one bit beside. A channel with
such a stamp is `stamped`: each of its messages also carries the stamp itself, as a field `time` [s].
"""

import json
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from mcap.records import Channel as ChannelRecord
from numpy.typing import NDArray

from twodof.errors import LogError, listed, shown
from twodof.flightlog.log import MAX_NAME, Channel, FlightLog
from twodof.signals import BY_MAT, Topic, topic

PACKAGE = "twodof_msgs/msg"
KEY = "twodof"
CDR_LITTLE_ENDIAN = 0x0100  # bytes 00 01 00 00: representation CDR_LE, no options
RECORD_HEAD_BYTES = 9
"""Opcode and length, with which each record begins."""
MAX_WIDTH = 1000
MAX_CHANNELS = 1000


@dataclass(frozen=True)
class McapStream:
    """A topic of a recording: `topic` is its name in MCAP, `mat` that of the FlightLog's channel.

    `fields` is empty for a scalar and for columns without names; `width` numbers make one sample.
    """

    topic: str
    schema: str
    mat: str
    unit: str
    fields: tuple[str, ...] = ()
    width: int = 1
    stamped: bool = False
    about: str = ""

    @property
    def fits(self) -> bool:
        """Return True if its messages can be read again."""
        return 1 <= self.width <= MAX_WIDTH and len(self.fields) in (0, self.width) and 0 < len(self.mat) <= MAX_NAME

    @cached_property
    def row(self) -> np.dtype[np.void]:
        """Return the layout of a message record: its head, the CDR head, the stamp if there is one, the values."""
        stamp = [("stamp", "<f8")] if self.stamped else []
        head = [("op", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4")]
        times = [("log_time", "<u8"), ("publish_time", "<u8")]
        return np.dtype([*head, *times, ("cdr", "<u4"), *stamp, ("value", "<f8", (self.width,))])

    @property
    def content_bytes(self) -> int:
        """Return the length of a message record's content."""
        return self.row.itemsize - RECORD_HEAD_BYTES

    @property
    def definition(self) -> str:
        """Return the schema of the messages in the notation of ROS 2; units are comments."""
        note = f"  # {_comment(self.unit)}" if self.unit else ""
        lines = [f"# {_comment(self.about)}"] if self.about else []
        lines += ["float64 time  # s, the stamp to its last bit"] if self.stamped else []
        if self.fields:
            lines += [f"float64 {name}{note}" for name in ros_names(self.fields)]
        else:
            lines.append(f"float64{f'[{self.width}]' if self.width > 1 else ''} value{note}")
        return "\n".join(lines) + "\n"

    @property
    def metadata(self) -> dict[str, str]:
        """Return the metadata of the channel's record."""
        kept = {"name": self.mat, "unit": self.unit, "fields": self.fields, "width": self.width}
        return {KEY: json.dumps({**kept, "stamped": self.stamped, "about": self.about, "schema": self.schema})}


def stream_of(row: Topic) -> McapStream:
    """Return the stream of a signal of TOPICS: `/imu/gyro`, `twodof_msgs/msg/ImuGyro`."""
    parts = re.split(r"[._]", row.name)
    return McapStream(
        "/" + row.name.replace(".", "/"),
        f"{PACKAGE}/{''.join(part[:1].upper() + part[1:] for part in parts)}",
        row.mat,
        row.unit,
        row.fields,
        row.width,
        about=row.text,
    )


def named(streams: Iterable[str | Topic | McapStream]) -> dict[str, McapStream]:
    """Return streams by the name under which samples are written; a str names a signal of TOPICS or its .mat channel.

    Raises LogError for a signal that is unknown or named twice and for a stream that could not be read again.
    """
    found: dict[str, McapStream] = {}
    for one in streams:
        row = topic(one) if isinstance(one, str) else one
        name = row.topic if isinstance(row, McapStream) else row.name
        made = row if isinstance(row, McapStream) else stream_of(row)
        if name in found or any(made.topic == one.topic or made.mat == one.mat for one in found.values()):
            raise LogError("is recorded twice", name, "name each topic and channel once")
        if not made.fits or len(found) >= MAX_CHANNELS:
            what = f"{made.width} columns, fields {listed(made.fields)}, channel {shown(made.mat)} cannot be recorded"
            remedy = f"give a name for each column or none; at most {MAX_WIDTH} columns and {MAX_CHANNELS} topics"
            raise LogError(what, name, remedy)
        found[name] = made
    return found


def streams_of(log: FlightLog) -> dict[str, McapStream]:
    """Return the stream of each channel of a log; channels that are not in TOPICS get topics `/other/...`."""
    found: dict[str, McapStream] = {}
    if len(log.channels) > MAX_CHANNELS:
        raise LogError(f"{len(log.channels)} channels are too many", log.source, f"at most {MAX_CHANNELS} are written")
    for k, (name, channel) in enumerate(log.channels.items()):
        width = 1 if channel.value.ndim == 1 else channel.value.shape[1]
        known = BY_MAT.get(name)
        if width > MAX_WIDTH:
            what = f"channel {shown(name)} has {width} columns"
            raise LogError(what, log.source, f"give at most {MAX_WIDTH} columns")
        if known and (known.fields, known.unit, known.width) == (channel.fields, channel.unit, width):
            stream = stream_of(known)
        else:
            plain = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")[:60] or "channel"
            stream = McapStream(f"/other/{plain}_{k}", f"{PACKAGE}/Other{k}", name, channel.unit, channel.fields, width)
        found[name] = replace(stream, stamped=not _whole(channel))
    return found


def parse(channel: ChannelRecord, schema: str) -> McapStream | None:
    """Return the stream that a channel's record describes; None for a foreign topic. Raises for a damaged record.

    `schema` is the name of the channel's schema: earlier versions of twodof did not write it into the description.
    """
    if KEY not in channel.metadata or channel.message_encoding != "cdr":
        return None
    kept = {"schema": schema, **json.loads(channel.metadata[KEY])}
    texts = schema, name, unit, about = [kept[key] for key in ("schema", "name", "unit", "about")]
    stream = McapStream(
        channel.topic, schema, name, unit, tuple(kept["fields"]), kept["width"], kept["stamped"] is True, about
    )
    if not stream.fits or not all(isinstance(one, str) for one in (*texts, *stream.fields)):
        raise ValueError(f"the description of topic {shown(channel.topic)}")
    return stream


def ros_names(fields: Iterable[str]) -> list[str]:
    """Return names for `fields` that ROS accepts: lower case, digits and single underscores, each name once."""
    names: list[str] = []
    for field in fields:
        apart = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", field).lower()
        plain = re.sub(r"_+", "_", re.sub(r"[^a-z0-9]", "_", apart)).strip("_")[:60]
        plain = plain if plain[:1].isalpha() else f"f_{plain}".rstrip("_")
        # `time` is the stamp's.
        names.append(f"{plain}_{len(names)}" if plain in names or plain == "time" else plain)
    return names


def nanoseconds(time: NDArray[np.float64], where: str) -> NDArray[np.uint64]:
    """Return the whole nanoseconds closest to stamps [s]. Raises LogError before 0 and after the year 2262."""
    if time.size and (time[0] < 0.0 or time[-1] >= 2.0**63 / 1e9):
        what = f"stamps from {time[0]!s} to {time[-1]!s} s are out of range"
        raise LogError(what, where, "shift the time: MCAP counts nanoseconds from 0")
    return np.rint(time * 1e9).astype(np.uint64)


def seconds(time_ns: NDArray[np.uint64]) -> NDArray[np.float64]:
    """Return the stamps [s] of whole nanoseconds."""
    return time_ns.astype(np.float64) / 1e9


def _whole(channel: Channel) -> bool:
    back = seconds(nanoseconds(channel.time, channel.name))
    return back.tobytes() == channel.time.tobytes()


def _comment(line: str) -> str:
    return "".join(letter if letter.isprintable() else " " for letter in line)[:200]
