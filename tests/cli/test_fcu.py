"""`twodof fcu`: it says where it listens, flies, and ends cleanly by a signal, armed or not."""

import asyncio
import json
import os
import signal
from pathlib import Path

import pytest

from tests.fcu.program import twodof_fcu
from tests.patience import patiently
from twodof.cli.app import run
from twodof.cli.connection import run_until_signal
from twodof.cli.fcu import serve
from twodof.errors import LinkError, LinkLost
from twodof.flightlog.files import read_log
from twodof.gcs.drone import Drone
from twodof.link.signing import Key, write_key
from twodof.sim.virtual_drone import VirtualDrone

pytestmark = pytest.mark.slow


@pytest.mark.long
def test_a_signal_in_flight_leaves_the_log_whole(tmp_path: Path) -> None:
    """SIGTERM; that Ctrl-C does the same is seen below."""
    drone = None
    try:
        with twodof_fcu("--lockstep", "--rings", "--state", str(tmp_path)) as url:
            drone = Drone.connect(url)
            drone.run(1.0)
            drone.arm()
            drone.set_pitch(0.1, thrust=0.4)
            drone.run(2.0)
            assert drone.state.armed
    finally:
        assert drone is not None
        with pytest.raises(LinkLost):
            drone.close()
    (log,) = (tmp_path / "logs").iterdir()
    theta = read_log(log)["theta"]
    assert len(theta) >= 500
    assert theta.value[-1] == pytest.approx(0.1, abs=0.03)


@pytest.mark.long
def test_only_clients_with_the_key_are_heard(tmp_path: Path) -> None:
    write_key(tmp_path / "key", Key.fresh())
    write_key(tmp_path / "other", Key.fresh())
    with twodof_fcu("--key", str(tmp_path / "key"), "--state", str(tmp_path / "state"), "--index", "4") as url:
        for _ in patiently():
            with pytest.raises(LinkError) as refused:
                Drone.connect(url, timeout=1.5, key=tmp_path / "other")
            if "signed with another key" in str(refused.value):  # else it said nothing within that time
                break
        with Drone.connect(url, key=tmp_path / "key") as drone:
            assert drone.there.session.system == 5
            tick = drone.tick
            drone.run(0.2)
            assert drone.tick > tick


def test_with_json_one_line_says_where_it_is(capfd: pytest.CaptureFixture[str]) -> None:
    async def work() -> None:
        drone = VirtualDrone(lockstep=True, index=3)
        running = asyncio.ensure_future(run_until_signal(serve(drone, ["memin://said"], json=True)))
        while not (said := capfd.readouterr().out):
            assert not running.done()
            await asyncio.sleep(0.01)
        flies = {"controller": "stock", "changed": 0}
        assert json.loads(said) == {"system": 4, "lockstep": True, "listening": ["memin://said"]} | flies
        os.kill(os.getpid(), signal.SIGINT)
        await running

    asyncio.run(work())


def test_wrong_options_are_refused_before_the_start(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TWODOF_DATA", str(tmp_path))
    for wrong, said in (
        (["--rig", "nowhere.json"], "nowhere.json"),
        (["--controller", "nothing"], "nothing"),
        (["--listen", "http://x"], "not a kind of link"),
        (["--key", str(tmp_path / "none")], "the key cannot be read"),
        (["--index", "199"], "198"),
        (["--precision", "float16"], "float16"),
        (["--noise", "nan"], "noise"),
        (["--rate", "fast"], "onboard"),
    ):
        assert run(["fcu", *wrong]) == 2, wrong
        assert said in capfd.readouterr().err
