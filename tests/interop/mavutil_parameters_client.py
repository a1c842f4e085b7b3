"""A ground station made with pymavlink's mavutil: `python mavutil_parameters_client.py URL NAME VALUE`.

It lists all parameters, sets one, reads it back, and prints what it saw as JSON.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

from pymavlink import mavutil

DEADLINE_S = 60.0


def main(url: str, name: str, value: str) -> None:
    link = mavutil.mavlink_connection(url, source_system=255, source_component=190)
    link.wait_heartbeat(timeout=DEADLINE_S)
    link.mav.heartbeat_send(6, 8, 0, 0, 0)
    link.param_fetch_all()
    found: dict[str, Any] = {}
    end, total = time.monotonic() + DEADLINE_S, 1
    while len(found) < total and time.monotonic() < end:
        got = link.recv_match(type="PARAM_VALUE", blocking=True, timeout=1.0)
        if got is not None and got.param_id != "_HASH_CHECK":
            total = got.param_count
            found[got.param_id] = got.param_value
    link.mav.param_set_send(link.target_system, link.target_component, name.encode(), float(value), 9)
    told = link.recv_match(type="PARAM_VALUE", condition=f"PARAM_VALUE.param_id=='{name}'", blocking=True, timeout=10)
    link.param_fetch_one(name)
    read = link.recv_match(type="PARAM_VALUE", condition=f"PARAM_VALUE.param_id=='{name}'", blocking=True, timeout=10)
    saw = {"names": sorted(found), "total": total, "before": found.get(name)}
    sys.stdout.write(json.dumps(saw | {"told": told.param_value, "read": read.param_value}) + "\n")
    link.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
