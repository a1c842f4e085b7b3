"""MAVProxy, without a screen: connect, `param show`, `param set`, `arm throttle`, `status`."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.interop.mavproxy import MavProxy
from tests.interop.programs import port
from twodof.fcu.store import Store


def test_mavproxy_sees_sets_and_arms(fcu_url: str, tmp_path: Path) -> None:
    with MavProxy(f"tcp:127.0.0.1:{port(fcu_url)}", tmp_path) as proxy:
        proxy.expect(r"Detected vehicle 1:1 on link 0")
        assert int(proxy.expect(r"Received (\d+) parameters")[1]) == len(Store().rows)
        proxy.type("param show RATE_KI")
        assert float(proxy.expect(r"RATE_KI +(\S+)")[1]) == pytest.approx(Store()["RATE_KI"], rel=1e-6)
        proxy.type("param set RATE_KI 0.3")
        proxy.type("param fetch RATE_KI")
        assert float(proxy.expect(r"RATE_KI = (\S+)")[1]) == pytest.approx(0.3, rel=1e-6)
        proxy.type("arm throttle")
        proxy.expect(r"Got COMMAND_ACK: COMPONENT_ARM_DISARM: ACCEPTED")
        proxy.expect(r"ARMED")
        proxy.type("status HEARTBEAT")
        proxy.expect(r"HEARTBEAT \{type : 2, autopilot : 12, base_mode : \d+")
        proxy.type("disarm")
        proxy.expect(r"Got COMMAND_ACK: COMPONENT_ARM_DISARM: ACCEPTED")
        proxy.expect(r"DISARMED")
        proxy.type("link")
        assert float(proxy.expect(r"(\d+\.\d+)% loss")[1]) == 0.0
