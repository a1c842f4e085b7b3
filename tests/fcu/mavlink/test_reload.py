"""Controllers that are uploaded: nobody arms while they are built, and only what flies is found after a restart."""

import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from tests.fcu.mavlink.test_on_board import Client
from tests.link.ends import in_loop
from tests.patience import PATIENCE_S
from twodof.blocks.schema.json_form import to_json
from twodof.compile.wasm import target
from twodof.errors import CompileError, LogError
from twodof.fcu.control.controllers import Controllers
from twodof.fcu.control.flight_code import FlightCode
from twodof.fcu.mavlink.vehicle_commands import ASK
from twodof.flight.controller_store import ControllerStore
from twodof.flight.starters import starter
from twodof.link.connection import Connection
from twodof.link.mavlink.dialect import MavResult
from twodof.link.transport import open_transport
from twodof.sim.virtual_drone import VirtualDrone

pytestmark = pytest.mark.slow

ARM, RELOAD = 400, 31010
BUILT = "lqr_attitude"


class Gate:
    """Holds the building of uploads up until it is opened."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.open = threading.Event()
        build = Controllers.build_uploaded

        def gated(controllers: Controllers) -> object:
            assert self.open.wait(PATIENCE_S)
            return build(controllers)

        monkeypatch.setattr(Controllers, "build_uploaded", gated)


@asynccontextmanager
async def being_built(state: Path, gate: Gate) -> AsyncIterator[tuple[VirtualDrone, Client]]:
    """A drone whose reload waits at the gate."""
    ControllerStore(state / "controllers").flash(starter("lqr-attitude"))
    async with VirtualDrone(lockstep=True, conditions={"rings": True}, state=state) as drone:
        await drone.listen(f"memin://{state.name}")
        async with Connection(await open_transport(f"mem://{state.name}"), 250, 1) as link:
            client = Client(link)
            try:
                client.say("TWODOF_LEASE", action=1, duration_ms=30_000)
                await client.run(50)
                assert await client.command(RELOAD) == MavResult.IN_PROGRESS
                yield drone, client
            finally:
                gate.open.set()


async def answer(client: Client) -> int:
    """The second answer to the reload."""
    return int((await client.wait("COMMAND_ACK", lambda ack: ack.command == RELOAD)).result)


def after_restart(state: Path) -> list[str]:
    """The controllers that a program started now would fly."""
    made: FlightCode = Controllers(uploads=state / "controllers", kept=state / "flying").build()[0]
    return [diagram.name for diagram in made.controllers]


@in_loop
async def test_nobody_arms_while_a_controller_is_built(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gate = Gate(monkeypatch)
    async with being_built(tmp_path, gate) as (_, client):
        client.came.clear()
        assert await client.command(ARM, 1.0) == MavResult.TEMPORARILY_REJECTED
        await client.run(60)
        assert after_restart(tmp_path) == []
        gate.open.set()
        assert await answer(client) == MavResult.ACCEPTED
        assert after_restart(tmp_path) == [BUILT]
        assert await client.command(ARM, 1.0) == MavResult.IN_PROGRESS
        assert await client.command(RELOAD) == MavResult.TEMPORARILY_REJECTED, "nobody builds while it arms"


@pytest.mark.parametrize("there", [False, True])
@in_loop
async def test_who_asks_first_is_told_all_that_is_missing_at_once_and_nothing_is_built(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, there: bool
) -> None:
    """A student without the two packages learns it before anything is sent, in one message."""

    def nowhere(name: str) -> None:
        assert name == "wasmtime"

    def none(name: str | None = None) -> None:
        raise CompileError("no compiler for WebAssembly was found", "target wasm", "install one")

    if not there:
        monkeypatch.setattr(target, "find_spec", nowhere)
        monkeypatch.setattr(target, "find_wasm_compiler", none)
    async with VirtualDrone(lockstep=True, state=tmp_path) as drone:
        await drone.listen(f"memin://{tmp_path.name}")
        async with Connection(await open_transport(f"mem://{tmp_path.name}"), 250, 1) as link:
            client = Client(link)
            flew = drone.controller.code
            assert await client.command(RELOAD, ASK) == (MavResult.ACCEPTED if there else MavResult.FAILED)
            assert drone.commander.lease.holder is None
            await client.run(60)
            texts = "".join(said.text for said in client.came if said.get_type() == "STATUSTEXT")
            assert drone.controller.code is flew
            assert there or all(word in texts for word in ("wasmtime", "ziglang", "pip install"))


@pytest.mark.parametrize("flies", [False, True])
@in_loop
async def test_what_could_not_be_built_is_not_there_any_more(tmp_path: Path, flies: bool) -> None:
    """Otherwise it would make every later upload fail, also one of another template."""
    if flies:
        ControllerStore(tmp_path / "flying").flash(starter("lqr-attitude"))
    (tmp_path / "controllers").mkdir()
    upload = tmp_path / "controllers" / "attitude_control.json"
    upload.write_text("{")
    async with VirtualDrone(lockstep=True, state=tmp_path) as drone:
        await drone.listen(f"memin://{tmp_path.name}")
        async with Connection(await open_transport(f"mem://{tmp_path.name}"), 250, 1) as link:
            client = Client(link)
            assert await client.command(RELOAD) == MavResult.IN_PROGRESS
            assert await answer(client) == MavResult.FAILED
    assert (upload.read_text() if flies else upload.exists()) == (flies and to_json(starter("lqr-attitude")))
    assert after_restart(tmp_path) == ([BUILT] if flies else [])


@in_loop
async def test_a_fault_of_the_program_leaves_no_upload_behind_either(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def faulty(_: Controllers) -> None:
        raise ArithmeticError("nobody thought of it")

    (tmp_path / "controllers").mkdir()
    upload = tmp_path / "controllers" / "attitude_control.json"
    upload.write_text(to_json(starter("lqr-attitude")))
    monkeypatch.setattr(Controllers, "build_uploaded", faulty)
    async with VirtualDrone(lockstep=True, state=tmp_path) as drone:
        await drone.listen(f"memin://{tmp_path.name}")
        async with Connection(await open_transport(f"mem://{tmp_path.name}"), 250, 1) as link:
            client = Client(link)
            assert await client.command(RELOAD) == MavResult.IN_PROGRESS
            assert await answer(client) == MavResult.FAILED
    assert not upload.exists()


@in_loop
async def test_a_controller_that_could_not_replace_the_other_is_not_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate = Gate(monkeypatch)
    async with being_built(tmp_path, gate) as (drone, client):
        latest = drone.controller.latest
        assert latest is not None
        drone.controller.latest = replace(latest, armed=True)
        gate.open.set()
        assert await answer(client) == MavResult.FAILED
        assert drone.controller.code.controllers == ()
    assert after_restart(tmp_path) == []


@in_loop
async def test_one_that_flies_and_cannot_be_stored_is_said_to_do_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_: Controllers, _uploaded: object) -> None:
        raise LogError("cannot be written: No space left on device", "flying", "nothing was changed")

    gate = Gate(monkeypatch)
    monkeypatch.setattr(Controllers, "keep", full)
    async with being_built(tmp_path, gate) as (drone, client):
        gate.open.set()
        told = await client.wait("STATUSTEXT", lambda text: "until a restart" in text.text)
        assert told.text.startswith("it flies until a restart and is not stored: ")
        assert [diagram.name for diagram in drone.controller.code.controllers] == [BUILT]
    assert after_restart(tmp_path) == []
