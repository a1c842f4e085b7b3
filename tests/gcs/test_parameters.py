"""The drone's parameters as a client has them: never stale, by path too, and what is not there is said so."""

import asyncio
import json
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest

from tests.faults.virtual_time import run_virtual
from tests.gcs.peer import Peer
from twodof.blocks.schema.json_form import to_json
from twodof.errors import ParameterError, Rejected, Timeout
from twodof.flight.starters import starter
from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.parameters import DESCRIPTION, SILENCE_S
from twodof.link.mavlink.messages import message
from twodof.sim.virtual_drone import VirtualDrone

pytestmark = pytest.mark.slow

OWN = {"name": "TMI_K_Q", "type": "Float", "default": 0.1, "min": 0.0, "max": 1.0, "units": "s/rad"}
Flight = Callable[[Peer, AsyncDrone], Coroutine[Any, Any, None]]


def describing(peer: Peer, *rows: dict[str, Any]) -> None:
    """The peer flies a controller with these parameters."""
    for row in rows:
        peer.parameters[row["name"]] = row["default"]
    peer.files[DESCRIPTION] = json.dumps({"version": 1, "parameters": rows}).encode()


def fly(flight: Flight, *rows: dict[str, Any], peer: Peer | None = None) -> None:
    """Connects to a peer that describes `rows`, and does that."""

    async def work() -> None:
        async with peer or Peer() as there:
            if peer is None:
                describing(there, *rows)
            else:
                there.refuse[512] = (3, "")
            async with await AsyncDrone.connect(there.url) as drone:
                await flight(there, drone)

    run_virtual(work())


def foreign() -> Peer:
    """Another's PX4: no TWODOF message, and no word about a parameter that it lacks."""
    silent = ("TWODOF_", "PARAM_ERROR")
    return Peer(spoil=lambda _, sent: [] if sent.get_type().startswith(silent) else [sent])


def test_each_access_asks_the_drone() -> None:
    async def flight(peer: Peer, drone: AsyncDrone) -> None:
        assert await drone.parameters.read("ATT_KP") == 11.0
        peer.parameters["ATT_KP"] = 6.0  # by another client, and the word of it was lost
        assert await drone.parameters.read("ATT_KP") == 6.0

    fly(flight)


def test_a_parameter_is_found_by_its_path_with_bounds_and_unit() -> None:
    async def flight(peer: Peer, drone: AsyncDrone) -> None:
        path = "attitude_control.k_q"
        assert await drone.parameters.read(path) == 0.1
        await drone.parameters.update({path: 0.25, "ATT_KP": 6.0})
        assert (peer.parameters["TMI_K_Q"], peer.parameters["ATT_KP"]) == (0.25, 6.0)
        with pytest.raises(ParameterError, match="2 is outside 0 to 1 s/rad"):
            await drone.parameters.set(path, 2.0)
        with pytest.raises(ParameterError, match="given twice"):
            await drone.parameters.update({path: 0.2, "TMI_K_Q": 0.3})
        with pytest.raises(ParameterError, match=r"no such parameter.*the nearest: attitude_control.k_q"):
            await drone.parameters.read("attitude_control.kq")
        assert (await drone.parameters.describe())["TMI_K_Q"].path == path
        assert (await drone.parameters.all())["TMI_K_Q"].row.unit == "s/rad"
        assert peer.parameters["TMI_K_Q"] == 0.25

    fly(flight, OWN | {"path": "attitude_control.k_q"})


@pytest.mark.parametrize("told", ["hash", "count", "rig"])
def test_what_was_known_is_forgotten_when_the_list_is_another(told: str) -> None:
    """Told by the hash, by the number of parameters, or by which diagram flies: any one that arrives is enough."""

    async def flight(peer: Peer, drone: AsyncDrone) -> None:
        assert await drone.parameters.read("attitude_control.k_q") == 0.1
        del peer.parameters["TMI_K_Q"]
        describing(peer, OWN | {"name": "TOT_K_Q", "default": 7.0, "max": 9.0, "path": "attitude_control.k_q"})
        if told == "hash":
            peer.send("PARAM_VALUE", param_id="_HASH_CHECK", param_type=5, param_count=5, param_index=65535)
        elif told == "count":
            peer.parameters["ONE_MORE"] = 1.0
            await drone.parameters.read("ATT_KP")
        else:
            peer.send("TWODOF_RIG", tick_us=4000, flags=4, name="paper", start=peer.start, diagram=5)
        await asyncio.sleep(0.1)
        assert await drone.parameters.read("attitude_control.k_q") == 7.0
        await drone.parameters.set("attitude_control.k_q", 8.0)
        assert peer.parameters["TOT_K_Q"] == 8.0
        with pytest.raises(ParameterError, match="no such parameter"):
            await drone.parameters.set("TMI_K_Q", 0.5)

    fly(flight, OWN | {"path": "attitude_control.k_q"})


def test_of_changes_at_once_one_is_done_after_the_other() -> None:
    """A PARAM_SET that came between the others of a transaction would be a part of it."""

    async def flight(peer: Peer, drone: AsyncDrone) -> None:
        change = drone.parameters.update
        together = [change({"ATT_KP": 1.0 + n, "RATE_KP": 0.01 + 0.001 * n}) for n in range(5)]
        await asyncio.gather(*together, *(drone.parameters.set("THRUST_BAR", 0.3 + 0.01 * n) for n in range(5)))
        assert peer.parameters["ATT_KP"] - 1.0 == pytest.approx((peer.parameters["RATE_KP"] - 0.01) * 1000.0, abs=1e-3)

    fly(flight)


@pytest.mark.parametrize("listed", [False, True])
def test_what_a_foreign_drone_is_silent_about_is_no_parameter_of_it(listed: bool) -> None:
    async def flight(peer: Peer, drone: AsyncDrone) -> None:
        assert not drone.ours
        if listed:
            await drone.parameters.all()
        began = asyncio.get_running_loop().time()
        with pytest.raises(ParameterError, match=r"no such parameter.*the nearest: ATT_KP"):
            await drone.parameters.read("ATT_KPP")
        assert asyncio.get_running_loop().time() - began <= SILENCE_S + 0.5
        with pytest.raises(ParameterError, match=r"no such parameter"):
            await drone.parameters.set("NOPE", 1.0)
        with pytest.raises(Rejected, match="not one of ours"):
            await drone.parameters.describe()
        with pytest.raises(ParameterError, match="names on a drone of ours only"):
            await drone.parameters.read("attitude_control.k_q")
        with pytest.raises(ParameterError) as raised:
            await drone.parameters.read("RATE_KI")
        assert raised.value.remedy == "the nearest: RATE_KP, ATT_KP", "of those that it has"

    fly(flight, peer=foreign())


def test_a_foreign_drone_answers_for_what_it_does_not_list() -> None:
    """PX4 lists what is in use, and knows the others by their names."""

    async def flight(peer: Peer, drone: AsyncDrone) -> None:
        await drone.parameters.all()
        peer.parameters["UNUSED"] = 3.0
        assert await drone.parameters.read("UNUSED") == 3.0

    fly(flight, peer=foreign())


def test_the_real_drones_own_name_is_found_by_the_packages() -> None:
    async def flight(peer: Peer, drone: AsyncDrone) -> None:
        peer.parameters["FC_PARAM_11"] = peer.parameters.pop("ATT_KP")
        assert await drone.parameters.read("ATT_KP") == 11.0
        await drone.parameters.set("ATT_KP", 9.0)
        assert peer.parameters["FC_PARAM_11"] == 9.0

    fly(flight, peer=foreign())


def test_the_timeout_of_a_drone_that_does_not_even_list_says_what_it_may_be() -> None:
    silent = ("TWODOF_", "PARAM_")
    peer = Peer(spoil=lambda _, sent: [] if sent.get_type().startswith(silent) else [sent])

    async def flight(_: Peer, drone: AsyncDrone) -> None:
        with pytest.raises(Timeout, match="silent about a name that it lacks"):
            await drone.parameters.read("ATT_KP", 3.0)

    fly(flight, peer=peer)


@pytest.mark.parametrize(
    "content",
    [b"", b"[]", b"{}", b"[" * 10_000, b'{"parameters": [{}]}', b'{"parameters": [{"name": "X", "type": 7}]}'],
)
def test_a_description_that_is_none_is_said_so(content: bytes) -> None:
    async def flight(peer: Peer, drone: AsyncDrone) -> None:
        peer.files[DESCRIPTION] = content
        with pytest.raises(Rejected, match="description of its parameters is none"):
            await drone.parameters.read("attitude_control.k_q")
        assert await drone.parameters.read("ATT_KP") == 11.0

    fly(flight)


@pytest.mark.long
def test_whoever_watches_sees_the_parameters_of_what_is_flashed_and_a_restart_keeps_them(tmp_path: Path) -> None:
    async def work() -> None:
        async with VirtualDrone(lockstep=True, state=tmp_path) as drone:
            await drone.listen("memin://flashed")
            watching = await AsyncDrone.connect("mem://flashed", take_lease=False)
            async with await AsyncDrone.connect("mem://flashed") as pilot, watching:
                stock = await watching.parameters.all()
                with pytest.raises(ParameterError, match="no such parameter"):
                    await watching.parameters.read("attitude_control.k_q")
                await pilot.fly_controller("attitude_control", to_json(starter("lqr-attitude")))
                k_q = starter("lqr-attitude").params["k_q"].value
                assert await watching.parameters.read("attitude_control.k_q") == pytest.approx(k_q, rel=1e-7)
                await pilot.parameters.update({"attitude_control.k_q": 0.2, "attitude_control.k_past[4]": 0.1})
                assert await watching.parameters.read("TLA_K_Q") == 0.2
                assert drone.controller.code.parameter("attitude_control.k_past")[4] == 0.1
                assert len(await watching.parameters.all()) == len(stock) + 30
                await pilot.fly_controller("attitude_control", to_json(starter("pid-attitude")))
                with pytest.raises(ParameterError, match=r"no such parameter.*attitude_control.q_k"):
                    await watching.parameters.read("attitude_control.k_q")
                assert (await pilot.parameters.all()).keys() - stock.keys() >= {"TPA_Q_KP", "TPA_THETA_KP"}
                await pilot.fly_controller("attitude_control", to_json(starter("lqr-attitude")))
                assert await pilot.parameters.read("attitude_control.k_q") == 0.2, "as it was tuned"
                assert drone.controller.code.parameter("attitude_control.k_q") == 0.2
                await pilot.run(0.1)
                assert any("as it was tuned before: TLA_K_Q, TLA_K_PAST_4" in text.text for text in watching.messages)

    asyncio.run(work())
    drone = VirtualDrone(lockstep=True, state=tmp_path)
    assert drone.controller.code.parameter("attitude_control.k_q") == 0.2
    drone.assembly.close()


def test_the_reason_of_a_refusal_is_not_what_is_told_beside_it() -> None:
    """That another's change was done may be told late: between a refusal's reason and the refusal."""

    def refusing(_: int, sent: Any) -> list[Any]:
        if not armed or sent.get_type() != "PARAM_VALUE":
            return [sent]
        return [
            message("STATUSTEXT", severity=4, text="1/1 withholds tuning"),
            message("STATUSTEXT", severity=6, text="RATE_KP = 0.06, by system 9"),
            message("PARAM_ERROR", param_id=sent.param_id, param_index=-1, error=2),
        ]

    async def flight(_: Peer, drone: AsyncDrone) -> None:
        await drone.parameters.read("ATT_KP")
        armed.append(True)
        with pytest.raises(Rejected, match="ATT_KP: 1/1 withholds tuning"):
            await drone.parameters.set("ATT_KP", 7.0)

    armed: list[bool] = []
    peer = Peer(spoil=refusing)
    fly(flight, peer=peer)
