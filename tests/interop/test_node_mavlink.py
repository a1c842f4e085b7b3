"""node-mavlink decodes what a whole session brought, byte by byte as it came over the wire, with no error."""

from __future__ import annotations

import json
import os
import subprocess
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common

from bench.stack.programs import port
from tests.interop.raw_session import RawSession
from tests.patience import PATIENCE_S
from tests.toolchains import need_node_package
from twodof.link.mavlink import dialect

pytestmark = pytest.mark.slow

SCRIPT = Path(__file__).with_name("decode.cjs")
# Our own, and COMPONENT_METADATA, which the definitions of node-mavlink 2.3.0 do not have.
UNKNOWN = (*range(54200, 54300), 397)


@pytest.fixture(scope="module")
def stream(fcu_url: str) -> Iterator[bytes]:
    """Every byte that the drone sent in a session: parameters, streams, armed, flown by set-points, disarmed."""
    session = RawSession(port(fcu_url))
    try:
        session.listen(0.5)
        session.command(512, 148)  # AUTOPILOT_VERSION
        session.parameters()
        session.command(511, common.MAVLINK_MSG_ID_ATTITUDE, 4_000)
        session.command(511, 54205, 4_000)  # TWODOF_TRUTH
        session.command(400, 1)  # arm
        session.command(176, 1, 6, behind=session.attitude(0.0, 0.4))  # offboard
        for k in range(40):
            session.send(session.attitude(0.05 * (-1) ** (k // 20), 0.4))
            session.listen(0.05)
        session.command(400, 0)
        session.listen(1.2)
        yield bytes(session.received)
    finally:
        session.close()


@pytest.fixture(scope="module")
def decoded(stream: bytes, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Return the stream as node-mavlink decodes it."""
    modules = need_node_package("node-mavlink")
    file = tmp_path_factory.mktemp("stream") / "session.mavlink"
    file.write_bytes(stream)
    done = subprocess.run(
        ["node", str(SCRIPT), str(file)],
        env=os.environ | {"NODE_PATH": str(modules)},
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    made: dict[str, Any] = json.loads(done.stdout)
    return made


def ours(stream: bytes) -> list[Any]:
    """The same by our dialect."""
    mav = dialect.load().MAVLink(None)
    return [m for m in mav.parse_buffer(stream) or [] if m.get_type() != "BAD_DATA"]


@pytest.mark.long
def test_no_frame_is_wrong_and_only_our_own_are_unknown(stream: bytes, decoded: dict[str, Any]) -> None:
    messages = ours(stream)
    assert decoded["invalid"] == decoded["undecoded"] == 0
    assert decoded["unknown"] == sum(m.get_msgId() in UNKNOWN for m in messages) > 0
    assert decoded["counts"] == Counter(m.get_type() for m in messages if m.get_msgId() not in UNKNOWN)
    assert {"HEARTBEAT", "PARAM_VALUE", "AUTOPILOT_VERSION", "ATTITUDE", "COMMAND_ACK"} <= set(decoded["counts"])


@pytest.mark.long
def test_it_reads_the_same_values(stream: bytes, decoded: dict[str, Any]) -> None:
    wanted = [[m.time_boot_ms, m.pitch, m.pitchspeed] for m in ours(stream) if m.get_type() == "ATTITUDE"]
    assert len(wanted) > 100
    assert decoded["attitudes"] == wanted  # both give the double that the float32 is


@pytest.mark.long
def test_pymavlinks_stock_dialect_agrees(stream: bytes) -> None:
    """Our dialect takes over the identity (CRC_EXTRA, layout) of what it has in common with everybody's."""
    mav = common.MAVLink(None)
    mav.robust_parsing = True
    theirs = [m for m in mav.parse_buffer(stream) or [] if m.get_type() != "BAD_DATA"]
    known = [m for m in ours(stream) if m.get_msgId() in common.mavlink_map]
    told = [str(m.to_dict()) for m in theirs if not m.get_type().startswith("UNKNOWN")]  # as text: NaN is not NaN
    assert told == [str(m.to_dict()) for m in known]
