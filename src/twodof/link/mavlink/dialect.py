"""The MAVLink dialect: a Python module made of dialect.xml by pymavlink's generator on first use, then from the cache.

What is cached is the module's byte code, without docstrings, so that it loads in hundredths of a second. Its classes
and constants are pymavlink's: `load().MAVLink_heartbeat_message`, `load().MAV_CMD_COMPONENT_ARM_DISARM`.
"""

import __future__

import importlib.util
import marshal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from threading import Lock
from types import MappingProxyType, ModuleType
from typing import Any

import pymavlink

from twodof.compile.toolchain import cache
from twodof.errors import LinkError, listed, shown

FILES = ("dialect.xml", "common.xml")
MODULE = "twodof.link.generated"
FIRST_OWN_ID, LAST_OWN_ID = 54200, 54299
# It takes .2 s; a loaded machine several times that.
BUILD_SECONDS = 60
_GENERATE = """
import sys
from types import SimpleNamespace
from pymavlink.generator import mavgen
options = {"wire_protocol": "2.0", "language": "Python3", "validate": False, "strict_units": False}
sys.exit(not mavgen.mavgen(SimpleNamespace(output=sys.argv[2], **options), [sys.argv[1]]))
"""
_lock = Lock()


def load() -> ModuleType:
    """Return the dialect's module, the same one for all threads of the process.

    Raises LinkError where it cannot be generated.
    """
    with _lock:
        module = sys.modules.get(MODULE)
        if module is None:
            module = build({name: Path(__file__).with_name(name).read_text(encoding="utf-8") for name in FILES})
            sys.modules[MODULE] = module
        return module


def build(files: Mapping[str, str]) -> ModuleType:
    """Generate a module from the definitions in `files` (name -> XML; the first includes the others), unregistered.

    Raises LinkError where the generator refuses or hangs.
    """
    generator = f"pymavlink {pymavlink.__version__} {importlib.util.MAGIC_NUMBER.hex()} {sys.implementation.cache_tag}"
    key = ("mavlink", generator, *(part for item in files.items() for part in item))
    for afresh in (False, True):
        data = cache.cached_bytes(key, ".code", lambda made: _generate(files, made), afresh)
        try:
            code = marshal.loads(data)
        except (ValueError, EOFError, TypeError):  # damaged, or written by another Python
            continue
        module = ModuleType(MODULE, "MAVLink as generated from dialect.xml.")
        exec(code, module.__dict__)
        return module
    raise LinkError("its byte code cannot be read", "MAVLink dialect", "empty the folder that TWODOF_CACHE names")


def _generate(files: Mapping[str, str], made: Path) -> None:
    """Write the byte code of what the generator makes of `files` to `made`."""
    for name, text in files.items():
        made.with_name(name).write_text(text, encoding="utf-8")
    source = made.with_suffix(".py")
    # In a process of its own: the generator prints, exits and has no deadline.
    command = [sys.executable, "-W", "ignore", "-c", _GENERATE, next(iter(files)), str(source)]
    try:
        done = subprocess.run(command, capture_output=True, timeout=BUILD_SECONDS, check=False, cwd=made.parent)
    except (subprocess.TimeoutExpired, OSError) as error:
        what = f"it was not generated: {error}"
        raise LinkError(what, "MAVLink dialect", "try again when the machine is less busy") from error
    if done.returncode or not source.is_file():
        said = (done.stderr or done.stdout).decode("utf-8", "replace").strip()[-1000:]
        raise LinkError(f"the generator refused: {said}", "MAVLink dialect", "check that pymavlink is installed whole")
    # Annotations as text and no docstrings: half of the time that loading takes.
    flags = __future__.annotations.compiler_flag
    code = compile(source.read_text(encoding="utf-8"), MODULE, "exec", flags=flags, dont_inherit=True, optimize=2)
    made.write_bytes(marshal.dumps(code))


def classes() -> Mapping[str, Any]:
    """Return the class of each message of the dialect by its name, in the order of the ids."""
    kinds = load().mavlink_map
    return MappingProxyType({kinds[number].msgname: kinds[number] for number in sorted(kinds)})


def message_id(name: str) -> int:
    """Return the id of the message called `name` ("HEARTBEAT"). Raises LinkError if there is none."""
    found = getattr(load(), f"MAVLINK_MSG_ID_{name}", -1)
    if found < 0:
        raise LinkError(f"no such message {shown(name)}", "MAVLink dialect", f"there are {listed(classes(), 200)}")
    return int(found)
