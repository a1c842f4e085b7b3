"""twodof: an open control laboratory around the 2DoF Drone.

An experiment excites a rig whose flight controller runs a diagram; what happened is a flight log. From a log
we identify a model, from a model we design a diagram, a diagram compiles to the C that flies.

Importing the package loads nothing else: a room (`twodof.blocks`, `twodof.identify`, ...) is imported when it
is first named.
"""

import importlib
from types import ModuleType

__version__ = "0.2.0"


def _rooms() -> frozenset[str]:
    return frozenset(module.name for module in importlib.import_module("pkgutil").iter_modules(__path__))


def __getattr__(name: str) -> ModuleType:
    if not name.startswith("_") and name in _rooms():
        return importlib.import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_rooms()})
