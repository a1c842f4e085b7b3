"""Drone of the page: rows to the bit, commands, a script beside it, recordings, and leaving."""

import asyncio
import json
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.faults.virtual_time import run_virtual
from tests.gcs.peer import Peer, speaking
from tests.gcs.virtual import OnBoard, on_board
from tests.lab.served import WATCH, Served, holds_samples, served, wait_for_drone
from tests.patience import patiently
from twodof.errors import Rejected
from twodof.flightlog.files import read_log
from twodof.flightlog.steps import BOOT
from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.drone import Drone
from twodof.gcs.recording import seconds
from twodof.lab import telemetry_client
from twodof.lab.drones import pilot
from twodof.lab.drones.lab_drone import LabDrone
from twodof.lab.drones.parameter_table import ParameterTable
from twodof.lab.routes.parameters import undo
from twodof.lab.settings import LabSettings
from twodof.lab.telemetry_rows import Audience

pytestmark = pytest.mark.slow

FLIES = {"loop": "theta", "value": 0.05, "thrust": 0.4}


@contextmanager
def flying(folder: Path, **options: Any) -> Iterator[tuple[Served, OnBoard]]:
    """A server with one virtual drone, whose rings are locked unless `options` say otherwise."""
    with (
        on_board(conditions={"rings": True}, **options) as there,
        served(folder, there.url, watch_token=WATCH) as server,
    ):
        wait_for_drone(server)
        yield server, there


@pytest.fixture(scope="module")
def drone(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Served, OnBoard]]:
    """Drone for the tests that leave it disarmed, with its parameters, without a lease."""
    with flying(tmp_path_factory.mktemp("lab")) as found:
        yield found


def test_parameters_of_a_new_controller_are_listed() -> None:
    async def everything() -> dict[str, str]:
        return parameters.known

    parameters = SimpleNamespace(known={"ATT_KP": "stock"}, all=everything)
    state = SimpleNamespace(rig=SimpleNamespace(diagram=1))
    drone: Any = SimpleNamespace(parameters=parameters, state=state, session=SimpleNamespace(now=0.0), ours=False)
    table = ParameterTable(drone, lambda names: None)
    listed: list[Any] = asyncio.run(table.entries())
    assert listed == ["stock"]
    parameters.known = {"ATT_KP": "stock", "OWN_KP": "own"}  # flashed, and read anew by another part of the server
    listed = asyncio.run(table.entries())
    assert listed == ["stock", "own"]


def test_texts_during_connecting_are_kept(tmp_path: Path) -> None:
    async def work() -> list[str]:
        async with Peer(spoil=speaking(b"battery low")) as peer:
            one = LabDrone(peer.url, LabSettings(tmp_path), Audience())
            running = asyncio.create_task(one.run())
            while one.state["link"] != "heard":
                await asyncio.sleep(0.01)
            running.cancel()
            await asyncio.wait([running])
            return [line["text"] for line in one.texts]

    assert run_virtual(work()) == ["battery low"]


def test_undo_takes_back_the_judged_change_only() -> None:
    async def work() -> None:
        async with Peer() as peer, await AsyncDrone.connect(peer.url) as drone:
            await drone.parameters.update({"ATT_KP": 9.0})

            async def check(*_: object) -> None:
                await drone.parameters.update({"ATT_KP": 10.0})

            one = SimpleNamespace(number=1, connection=SimpleNamespace(drone=drone))
            with pytest.raises(Rejected, match="another change came before the undo"):
                await undo(SimpleNamespace(guard=SimpleNamespace(check=check)), one)
            assert peer.parameters["ATT_KP"] == 10.0

    run_virtual(work())


@pytest.mark.long
def test_rows_have_the_drones_bits(drone: tuple[Served, OnBoard]) -> None:
    server, there = drone
    columns = ["estimate.theta", "imu.gyro_y", "truth.theta", "command.M"]
    with server.socket() as client:
        client.subscribe(columns, number=7)
        client.subscribe(columns[:1], rate=25.0, number=8)
        full: list[np.ndarray[Any, Any]] = []
        few: list[np.ndarray[Any, Any]] = []
        while sum(piece.shape[1] for piece in full) < 300 or sum(piece.shape[1] for piece in few) < 20:
            frame = client.frame()
            assert frame.dropped == 0
            (full if frame.id == 7 else few).append(np.vstack([frame.times, frame.columns]))
    rows, decimated = np.concatenate(full, axis=1), np.concatenate(few, axis=1)
    ticks = np.rint((rows[0] - BOOT) / 0.004).astype(int)
    assert np.array_equal(ticks, np.arange(ticks[0], ticks[0] + len(ticks)))  # each tick, once, in order
    steps = {step.tick: step for step in there.steps}
    theta = np.array([steps[tick].theta for tick in ticks], dtype=np.float32)
    gyro = np.array([steps[tick].sample.gyro_y for tick in ticks], dtype=np.float32)
    # The server asks for one stream after the other: the first rows of all may lack what has not come yet.
    begun = int(np.argmax(np.isfinite(rows[1:3]).all(axis=0)))
    assert begun < 25
    assert np.array_equal(rows[1, begun:].astype(np.float32), theta[begun:])
    assert np.array_equal(rows[2, begun:].astype(np.float32), gyro[begun:])
    # The truth begins a moment later, as it is asked for apart.
    assert np.isfinite(rows[3][-100:]).all()
    for k in range(2 if begun else 0, decimated.shape[1], 2):
        first, last = (round((time - BOOT) / 0.004) for time in decimated[0, k : k + 2])
        assert k == 0 or last - first == 19  # the first bucket had begun when it was asked for
        bucket = np.array([steps[tick].theta for tick in range(first, last + 1)], dtype=np.float32)
        assert set(decimated[1, k : k + 2].astype(np.float32)) == {bucket.min(), bucket.max()}


def test_the_page_flies_the_drone_as_it_is_told(drone: tuple[Served, OnBoard]) -> None:
    server, there = drone
    with server.socket() as client:
        assert server.ask("POST", "/api/drones/1/arm").json["armed"]
        state = server.ask("PUT", "/api/drones/1/setpoint", FLIES).json
        assert (state["mode"], state["setpoint"]) == ("offboard", {**FLIES, "acceleration": None})
        client.event("drone", armed=True, mode="offboard", ours_leases=True)
        played = {"excitation": {"kind": "doublet", "amplitude": 0.02, "period": 2.0, "unit": "rad"}, "loop": "theta"}
        excited = server.ask("POST", "/api/drones/1/excitation", played)
        assert excited.status == 200, excited.content
        assert server.ask("GET", "/api/drones/1").json["excitation"] == {
            "start_tick": excited.json["start_tick"],
            "end_tick": excited.json["end_tick"],
        }
        for _ in patiently():
            if there.steps[-1].tick > excited.json["end_tick"]:
                break
        asked = {step.tick: step.theta0 for step in there.steps}
        assert asked[excited.json["start_tick"] + 5] == pytest.approx(0.07, abs=1e-3)
        assert server.ask("POST", "/api/drones/1/mode", {"mode": "hold"}).json["setpoint"] is None
        given_up = server.ask("DELETE", "/api/drones/1/lease")
        assert (given_up.status, given_up.json["what"]) == (409, "the drone is armed")
        assert not server.ask("POST", "/api/drones/1/disarm").json["armed"]
        assert not server.ask("DELETE", "/api/drones/1/lease").json["ours_leases"]


@pytest.mark.long
def test_the_page_tunes_and_stops_a_scripts_drone(drone: tuple[Served, OnBoard]) -> None:
    server, there = drone
    with server.socket() as client, Drone.connect(there.url) as script:
        script.arm()
        script.set_pitch(0.02, thrust=0.4)
        client.event("drone", armed=True, mode="offboard", ours_leases=False)
        refused = server.ask("PUT", "/api/drones/1/setpoint", FLIES)
        assert refused.status == 409
        assert "holds the lease" in refused.json["what"]
        told = server.ask("PATCH", "/api/drones/1/parameters", {"RATE_KP": 0.08, "ATT_KP": 10.0}).json["changed"]
        assert [(row["name"], row["before"], row["value"]) for row in told] == [
            ("RATE_KP", 0.0854, 0.08),
            ("ATT_KP", 11.0, 10.0),
        ]
        assert {"RATE_KP", "ATT_KP"} <= set(client.event("parameters")["names"])
        assert script.parameters["RATE_KP"] == pytest.approx(0.08)
        assert server.ask("POST", "/api/drones/1/parameters/undo").status == 200
        client.event("parameters")
        script.parameters["ATT_KP"] = 9.0  # whoever changes it
        assert "ATT_KP" in client.event("parameters")["names"]
        script.parameters["ATT_KP"] = 11.0
        assert script.state.armed
        killed = server.ask("POST", "/api/drones/1/kill", token=WATCH)  # whoever is beside it may
        assert killed.status == 200
        assert (killed.json["armed"], killed.json["killed"]) == (False, True)
        client.event("drone", killed=True)
        said = [(line["severity"], line["text"]) for line in server.ask("GET", "/api/drones/1/texts").json]
        assert ("critical", "the emergency stop was pressed by a watching client at 127.0.0.1") in said
        for _ in patiently():
            if script.state.killed:
                break
    assert server.ask("POST", "/api/drones/1/release", token=WATCH).status == 403
    assert server.ask("POST", "/api/drones/1/release").json["killed"] is False
    assert server.ask("DELETE", "/api/drones/1/lease").status == 200


def test_a_refusal_says_why_in_the_drones_words(drone: tuple[Served, OnBoard]) -> None:
    server, _ = drone
    for method, path, body, status, word in (
        ("PUT", "setpoint", {"loop": "x", "value": 0.1}, 409, "rings"),
        ("PUT", "setpoint", {"loop": "theta", "value": 30.0}, 422, "radians"),
        ("PUT", "setpoint", {"loop": "theta", "value": 0.1, "thrust": 1.5}, 422, "less than or equal to 1"),
        ("PATCH", "parameters", {"RATE_KP": 50.0}, 422, "outside"),
        ("PATCH", "parameters", {"RATE_KQ": 0.1}, 422, "no such parameter"),
        ("POST", "excitation", {"excitation": {"kind": "doublet", "amplitude": 90.0, "period": 1.0}}, 422, "peak 90"),
        ("POST", "excitation", {"excitation": {"kind": "wobble"}}, 422, "wobble"),
        ("POST", "mode", {"mode": "acro"}, 422, "acro"),
    ):
        answer = server.ask(method, f"/api/drones/1/{path}", body)
        assert answer.status == status, (path, body, answer.content)
        said = answer.json
        assert word in said["what"] + said["where"] + said["remedy"], said
    assert server.ask("DELETE", "/api/drones/1/lease").status == 200


def test_parameters_are_told_with_what_a_person_needs(drone: tuple[Served, OnBoard]) -> None:
    server, _ = drone
    rows = {row["name"]: row for row in server.ask("GET", "/api/drones/1/parameters").json}
    gain = rows["RATE_KP"]
    assert (gain["value"], gain["default"], gain["low"], gain["high"]) == (0.0854, 0.0854, 0.0, 0.12)
    assert gain["unit"] == "s/rad"
    assert "proportional" in gain["text"]
    assert gain["tuning"]
    assert not rows["SAFE_LINK_T"]["tuning"]


@pytest.mark.long
def test_a_flight_is_recorded_from_arming_to_rest_whoever_flies_it(drone: tuple[Served, OnBoard]) -> None:
    server, there = drone
    with server.socket() as client:
        client.event("drone", armed=False, recording="")  # of the flight before
        with Drone.connect(there.url) as script:
            script.arm()
            while not (written := client.event("drone", armed=True)["state"]["recording"]):
                pass
            assert any(holds_samples(server.folder / "flights" / written) for _ in patiently())
            began = script.tick
            script.set_pitch(0.05, thrust=0.4)
            script.parameters["RATE_KP"] = 0.08
            script.run(0.6)
            for path in (written, f"{written}/summary"):
                told = server.ask("GET", f"/api/logs/{path}")
                assert (told.status, told.json["unreadable"].split(":")[0]) == (200, "the log is being recorded")
            script.disarm()
            ended = script.tick
            name = client.event("log")["name"]
            script.parameters["RATE_KP"] = 0.0854
    assert name == written
    log = read_log(server.folder / "flights" / name)
    theta = log["theta"]
    assert theta.time[0] <= seconds(began)
    assert theta.time[-1] >= seconds(ended)
    assert [(row[1], round(row[2], 4)) for row in log.provenance["changes"]] == [("RATE_KP", 0.08)]
    assert log.provenance["recorded"]["by"] == "lab"


def test_an_experiment_is_one_log_and_the_drone_stands_as_before(drone: tuple[Served, OnBoard]) -> None:
    """The job resets the drone and keeps the log: nothing is recorded twice, and no link is lost by it."""
    server, _ = drone
    # The recording of the test before this one may still be ending.
    assert any(server.ask("GET", "/api/drones/1").json["recording"] == "" for _ in patiently())
    before = {path.name for path in (server.folder / "flights").glob("*")}
    pulse = {"kind": "impulse", "amplitude": 0.02, "width": 0.05, "lead": 0.1, "settle": 0.1}
    asked = {"name": "velocity-doublet", "hold": 0.3, "rest": 0.1, "excitation": {**pulse, "unit": "rad"}}
    with server.socket() as client:
        started = server.ask("POST", "/api/identification/fly", {"experiment": asked, "drone": 1, "seed": 5})
        assert started.status == 202, started.content
        states = []
        while True:
            got = client.next()
            event = json.loads(got) if isinstance(got, str) else {"event": "rows"}
            if event["event"] == "drone":
                states.append(event["state"])
            assert event.get("job", {}).get("state") != "failed", event
            if event["event"] == "log":
                break
        told = server.ask("GET", f"/api/jobs/{started.json['id']}").json["result"]
    assert (told["rings_locked"], told["put_back"]) == (True, True)
    assert {state["link"] for state in states} == {"heard"}
    assert {state["recording"] for state in states} == {""}
    assert {state["rings_locked"] for state in states} == {True, False}  # flown with the cart free
    assert any(state["armed"] for state in states)
    assert server.ask("GET", "/api/drones/1").json["rings_locked"]
    assert {path.name for path in (server.folder / "flights").glob("*")} - before == {event["name"]}
    assert read_log(server.folder / "flights" / event["name"]).provenance["experiment"] == "velocity-doublet"


@pytest.mark.long
def test_a_drone_without_clients_is_levelled_then_disarmed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pilot, "LEVEL_S", 0.4)
    monkeypatch.setattr(pilot, "LEAVE_S", 1.2)
    with flying(tmp_path, safety_off=True) as (server, there):
        with server.socket():
            server.ask("POST", "/api/drones/1/arm")
            server.ask("PUT", "/api/drones/1/setpoint", FLIES)
            with server.socket():
                pass  # another one comes and goes
            for _ in patiently():  # as long as somebody is there it flies on
                if there.steps[-1].tick > 2.0 / 0.004:
                    break
            assert server.ask("GET", "/api/drones/1").json["mode"] == "offboard"
        for _ in patiently():
            state = server.ask("GET", "/api/drones/1").json
            if not state["armed"]:
                break
        said = [line["text"] for line in server.ask("GET", "/api/drones/1/texts").json]
        assert any("the drone is levelled" in line for line in said)
        assert any("the drone is disarmed" in line for line in said)
        levelled = [step for step in there.steps if step.theta0 == 0.0]
        assert levelled
        with Drone.connect(there.url) as script:  # it is free for others
            script.arm()


@pytest.mark.long
def test_a_frozen_page_does_not_keep_the_drone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(telemetry_client, "ALIVE_S", 0.1)
    monkeypatch.setattr(pilot, "LEVEL_S", 0.4)
    monkeypatch.setattr(pilot, "LEAVE_S", 1.2)
    with flying(tmp_path, safety_off=True) as (server, there), server.socket() as client:
        server.ask("POST", "/api/drones/1/arm")
        server.ask("PUT", "/api/drones/1/setpoint", FLIES)
        while there.steps[-1].tick < 2.0 / 0.004:  # it flies on while that is answered
            client.event("alive")
            client.send(do="here")
        assert server.ask("GET", "/api/drones/1").json["mode"] == "offboard"
        client.event("drone", armed=False)  # and then no more
        said = [line["text"] for line in server.ask("GET", "/api/drones/1/texts").json]
        assert any("stands still for 0.4 s: the drone is levelled" in line for line in said), said


@pytest.mark.long
def test_rows_go_on_after_the_drone_has_restarted(tmp_path: Path) -> None:
    with ExitStack() as first, ExitStack() as second:
        there = first.enter_context(on_board(conditions={"rings": True}))
        server = second.enter_context(served(tmp_path, there.url))
        wait_for_drone(server)
        client = second.enter_context(server.socket())
        client.subscribe(["estimate.theta"])
        reached = BOOT + 2.0  # a slow machine may connect again only after half a second
        while client.frame().times[-1] < reached:
            pass
        assert server.ask("POST", "/api/drones/1/lease").status == 200
        client.event("drone", ours_leases=True)
        first.close()
        lost = client.event("drone", link="lost")["state"]
        assert lost["why_lost"]
        assert lost["lease_holder"] is None, "the page would say that another client commands"
        assert server.ask("POST", "/api/drones/1/arm").status == 504
        second.enter_context(on_board(there.url.replace("tcp:", "tcpin:"), conditions={"rings": True}))
        client.event("drone", link="heard")
        assert client.frame().times[0] < reached, "the time of the new drone"
