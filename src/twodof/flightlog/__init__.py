"""Flight logs: the recorded channels of a flight, their file formats, and the search for events in them.

Names are loaded when they are first used, because scipy.io and pyarrow take longer to import than the rest of
the package together.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twodof.flightlog.atomic import atomic_write as atomic_write
    from twodof.flightlog.atomic import numbered as numbered
    from twodof.flightlog.contents import DetectedExcitation as DetectedExcitation
    from twodof.flightlog.contents import describe as describe
    from twodof.flightlog.contents import excitations as excitations
    from twodof.flightlog.contents import find_excitation as find_excitation
    from twodof.flightlog.events import Event as Event
    from twodof.flightlog.events import Stretch as Stretch
    from twodof.flightlog.events import modes as modes
    from twodof.flightlog.events import openloop_edges as openloop_edges
    from twodof.flightlog.events import setpoint_steps as setpoint_steps
    from twodof.flightlog.events import thrust_edges as thrust_edges
    from twodof.flightlog.events import window as window
    from twodof.flightlog.files import convert as convert
    from twodof.flightlog.files import read_log as read_log
    from twodof.flightlog.files import write_log as write_log
    from twodof.flightlog.log import Channel as Channel
    from twodof.flightlog.log import FlightLog as FlightLog
    from twodof.flightlog.log import Gap as Gap
    from twodof.flightlog.mcap_file import Recovered as Recovered
    from twodof.flightlog.mcap_file import recover as recover
    from twodof.flightlog.recorder import Recorder as Recorder
    from twodof.flightlog.ulog_writer import ULogWriter as ULogWriter

_HOMES = {
    "atomic": ("atomic_write", "numbered"),
    "contents": ("DetectedExcitation", "describe", "excitations", "find_excitation"),
    "events": ("Event", "Stretch", "modes", "openloop_edges", "setpoint_steps", "thrust_edges", "window"),
    "files": ("convert", "read_log", "write_log"),
    "log": ("Channel", "FlightLog", "Gap"),
    "recorder": ("Recorder",),
    "mcap_file": ("Recovered", "recover"),
    "ulog_writer": ("ULogWriter",),
}
_HOME = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})
