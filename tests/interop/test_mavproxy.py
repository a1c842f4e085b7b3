"""MAVProxy, without a screen: connect, `param show`, `param set`, `arm throttle`, `status`."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.stack.programs import port
from tests.interop.mavproxy import MavProxy
from tests.patience import patiently
from twodof.fcu.parameters.parameter_store import ParameterStore

pytestmark = pytest.mark.slow

NUMBER = r"-?\d+\.\d+"  # a prompt may follow in the same line


@pytest.mark.long
def test_mavproxy_sees_sets_and_arms(fcu_url: str, tmp_path: Path) -> None:
    with MavProxy(f"tcp:127.0.0.1:{port(fcu_url)}", tmp_path) as proxy:
        proxy.expect(r"Detected vehicle 1:1 on link 0")
        assert int(proxy.expect(r"Received (\d+) parameters")[1]) == len(ParameterStore().rows)
        proxy.type("param show RATE_KI")
        assert float(proxy.expect(rf"RATE_KI +({NUMBER})")[1]) == pytest.approx(ParameterStore()["RATE_KI"], rel=1e-6)
        proxy.type("param set RATE_KI 0.3")  # says nothing when it has succeeded
        for _ in patiently():
            if fetched(proxy, "RATE_KI") == pytest.approx(0.3, rel=1e-6):
                break
        proxy.type("arm throttle")
        proxy.expect(r"Got COMMAND_ACK: COMPONENT_ARM_DISARM: ACCEPTED")
        proxy.expect(r"ARMED")
        proxy.type("status HEARTBEAT")
        proxy.expect(r"HEARTBEAT \{type : 2, autopilot : 12, base_mode : \d+")
        proxy.type("disarm")
        proxy.expect(r"Got COMMAND_ACK: COMPONENT_ARM_DISARM: ACCEPTED")
        proxy.expect(r"DISARMED")
        proxy.type("link")
        proxy.expect(r"link 1 OK")
        assert "breach" not in proxy.text  # of a fence that there is not


def fetched(proxy: MavProxy, name: str) -> float:
    """A parameter as the drone sends it when it is asked for it."""
    proxy.type(f"param fetch {name}")
    return float(proxy.expect(rf"{name} = ({NUMBER})")[1])
