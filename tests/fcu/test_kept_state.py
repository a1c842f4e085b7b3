"""State that a virtual drone keeps after a session over MAVLink: parameters, and a log with its texts."""

import asyncio
import struct
from pathlib import Path

from tests.patience import PATIENCE_S
from twodof.flightlog.ulog_file import scan_ulog
from twodof.link.connection import Connection
from twodof.link.mavlink.messages import message
from twodof.link.transport import open_transport
from twodof.sim.virtual_drone import VirtualDrone

ARM, REAL32, INT32 = 400, 9, 6
US = {"target_system": 1, "target_component": 1}


async def session(state: Path, name: str) -> list[str]:
    """Logs always, sets a gain, arms where that is refused, flies a second; what the drone said in words."""
    said: list[str] = []
    async with VirtualDrone("lab", {"rings": True}, lockstep=True, state=state, safety_off=False) as drone:
        await drone.listen(f"memin://{name}")
        async with Connection(await open_transport(f"mem://{name}"), system=250, component=190) as client:
            always = struct.unpack("<f", struct.pack("<i", 2))[0]
            client.send(message("PARAM_SET", param_id=b"SDLOG_MODE", param_value=always, param_type=INT32, **US))
            client.send(message("PARAM_SET", param_id=b"FC_PARAM_4", param_value=0.07, param_type=REAL32, **US))
            client.send(message("TWODOF_GRANT", until=250, **US))
            client.send(message("COMMAND_LONG", command=ARM, param1=1.0, **US))
            client.send(message("TWODOF_GRANT", until=500, **US))
            while True:
                received = await client.receive(PATIENCE_S)
                assert received is not None
                got = received.message
                if got.get_type() == "STATUSTEXT":
                    said.append(got.text)
                if got.get_type() == "TWODOF_TICK" and got.tick >= 500:
                    break
    drone.assembly.close()
    return said


def test_a_session_is_in_the_log_and_its_parameters_in_the_next_one(tmp_path: Path) -> None:
    said = asyncio.run(asyncio.wait_for(session(tmp_path, "kept"), PATIENCE_S))
    assert any("safety switch" in text for text in said)
    (path,) = (tmp_path / "logs").iterdir()
    found = scan_ulog(path.read_bytes(), str(path))
    assert any("safety switch" in text for _, _, text in found.texts)
    assert (found.info["rig"], found.info["rings"], found.info["controller"]) == ("lab", 1, "stock")
    drone = VirtualDrone("lab", lockstep=True, state=tmp_path)
    assert drone.assembly.store.changed() == {"RATE_KP": 0.07, "SDLOG_MODE": 2}
    # To the bit what a simulation with .07 has, though it came as a float32.
    assert drone.controller.code.parameter("RATE_KP") == 0.07
    drone.assembly.close()
