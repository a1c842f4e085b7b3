"""A virtual drone as one thing: parameters that fly, uploads that are kept, what is damaged, the page of the docs."""

import asyncio
import re
from pathlib import Path

import pytest

from tests.fcu.flights import exhausting
from twodof.errors import CompileError, LinkError, LogError, ParameterError
from twodof.fcu.control import flight_code
from twodof.fcu.control.controllers import Controllers
from twodof.fcu.control.flight_code import FlightCode
from twodof.flight.controller_store import ControllerStore
from twodof.flight.starters import starter
from twodof.flight.templates import ATTITUDE
from twodof.link.mavlink.dialect import MavResult
from twodof.rig.parameters import NAMES, load_rig, save_rig
from twodof.sim.virtual_drone import VirtualDrone

pytestmark = pytest.mark.slow

PAGE = Path(__file__).resolve().parents[2] / "docs" / "explanation" / "flight-controller.md"


def test_parameters_of_the_store_fly_and_are_there_after_a_restart(tmp_path: Path) -> None:
    async def change() -> None:
        async with VirtualDrone(lockstep=True, state=tmp_path) as drone:
            store, code = drone.assembly.store, drone.controller.code
            store.update({"ATT_KP": 5.0, "RATE_KP": 0.05})
            assert (code.parameter("ATT_KP"), code.parameter("RATE_KP")) == (5.0, 0.05)
            with pytest.raises(ParameterError):
                store.update({"ATT_KP": 6.0, "RATE_KP": 1e9})
            assert code.parameter("ATT_KP") == 5.0

    async def look() -> None:
        async with VirtualDrone(lockstep=True, state=tmp_path, controllers=["lqr-attitude"]) as drone:
            assert drone.controller.code.parameter("ATT_KP") == 5.0, "of the stock controller in reserve"

    asyncio.run(change())
    asyncio.run(look())


def test_a_rig_file_never_has_a_ready_made_name(tmp_path: Path) -> None:
    save_rig(load_rig("lab"), tmp_path / "paper.json")
    drone = VirtualDrone(str(tmp_path / "paper.json"))
    assert drone.rig.name == "own"
    asyncio.run(drone.close())


def test_what_was_kept_and_is_damaged_is_left_out_and_told(tmp_path: Path) -> None:
    (tmp_path / "flying").mkdir()
    (tmp_path / "flying" / f"{ATTITUDE.name}.json").write_text("{")
    drone = VirtualDrone(lockstep=True, state=tmp_path, controllers=["pid-position"])
    assert [diagram.name for diagram in drone.controller.code.controllers] == ["pid_position"]
    assert any("left out" in text for _, text in drone.commander.remarks)
    asyncio.run(drone.close())


def test_where_no_sandbox_can_be_built_what_was_kept_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(*_: object, **__: object) -> None:
        raise CompileError("the package wasmtime is not there", "target wasm", "install it")

    ControllerStore(tmp_path).flash(starter("lqr-attitude"))
    monkeypatch.setattr(flight_code, "Sandbox", missing)
    code, damage = Controllers(kept=tmp_path).build()
    assert code.controllers == ()
    assert "wasmtime" in damage
    with pytest.raises(CompileError):
        Controllers(["lqr-attitude"]).build()


@pytest.mark.long
def test_only_what_was_given_is_trusted_and_only_while_nothing_was_uploaded(tmp_path: Path) -> None:
    uploads, kept = tmp_path / "uploads", tmp_path / "kept"
    made = Controllers(["pid-position"], True, uploads, kept)
    code, damage = made.build()
    assert (code.trusted, code.sandbox, damage) == (True, None, "")
    assert made.uploads is not None
    made.uploads.flash(starter("lqr-attitude"))
    code, _ = made.build()
    assert code.trusted, "an upload that was not built yet changes nothing, over restarts too"
    built, uploaded = made.build_uploaded()
    assert made.build()[0].trusted, "what was built but does not fly yet changes nothing either"
    made.keep(uploaded)
    for code in (built, made.build()[0]):
        assert not code.trusted
        assert code.sandbox is not None
        assert sorted(diagram.name for diagram in code.controllers) == ["lqr_attitude", "pid_position"]
    made.uploads.flash(starter("stock-attitude"))
    made.uploads.flash(starter("stock-position"))
    assert made.build_uploaded()[0].identity.controller == "stock"
    made.uploads.remove("position_control")
    made.uploads.remove("attitude_control")
    assert made.build_uploaded()[0].identity.controller == "pid_position"
    made.keep({})
    assert made.build()[0].trusted


def test_a_controller_that_cannot_fly_is_not_armed_with() -> None:
    drone = VirtualDrone(lockstep=True, controllers=[exhausting(0)], fuel=15_000)
    for _ in range(100):
        drone.controller.step()
    verdict = drone.commander.arming.arm((250, 1))
    assert not verdict.accepted
    assert "fuel" in verdict.text
    drone.controller.replace(FlightCode())
    drone.controller.step()
    assert drone.commander.arming.arm((250, 1)).result == MavResult.IN_PROGRESS
    asyncio.run(drone.close())


def test_a_link_that_cannot_be_opened_leaves_nothing_open(tmp_path: Path) -> None:
    async def start() -> None:
        async with VirtualDrone(lockstep=True, state=tmp_path) as drone:
            await drone.listen("memin://taken")
            await drone.listen("memin://taken")

    for _ in range(2):
        with pytest.raises(LinkError, match="taken"):
            asyncio.run(start())


def test_a_folder_that_cannot_be_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(LogError, match="no folder for logs"):
        VirtualDrone(state=tmp_path / "file")


def test_the_pages_example_flies(capsys: pytest.CaptureFixture[str]) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    exec(compile(code, str(PAGE), "exec"), {"__name__": "page"})
    estimate, truth = map(float, capsys.readouterr().out.split())
    assert truth == pytest.approx(0.17, abs=0.03)  # 2 s after the step, in turbulence
    assert estimate == pytest.approx(truth, abs=0.01)


@pytest.mark.parametrize("rig", NAMES)
def test_the_failsafe_knows_where_the_rigs_imu_is(rig: str) -> None:
    drone, values = VirtualDrone(rig), load_rig(rig)
    for name, path in (("SAFE_IMU_BELOW", "imu_below"), ("SAFE_IMU_AHEAD", "imu_ahead")):
        drone.assembly.store.set(name, 0.1)
        assert drone.flown.changed == 1
        drone.assembly.store.reset()
        assert drone.flown.changed == 0
        assert drone.controller.code.machine.get(f"failsafe.force.{path}") == pytest.approx(values[path], rel=1e-6)
    asyncio.run(drone.close())
