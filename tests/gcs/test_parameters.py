"""Parameters of a drone: never stale, found by path too, unknown names refused."""

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest

from tests.faults.virtual_time import VirtualLoop
from tests.gcs.peer import Peer, flight
from twodof.blocks.schema.json_form import to_json
from twodof.errors import ParameterError, Rejected, Timeout
from twodof.flight.starters import starter
from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.parameters import DESCRIPTION, SILENCE_S
from twodof.link.mavlink.messages import message
from twodof.sim.virtual_drone import VirtualDrone

pytestmark = pytest.mark.slow

OWN = {"name": "TMI_K_Q", "type": "Float", "default": 0.1, "min": 0.0, "max": 1.0, "units": "s/rad"}
OWN["path"] = "attitude_control.k_q"


def describing(peer: Peer, *rows: dict[str, Any]) -> None:
    """Give the peer a controller with these parameters."""
    for row in rows:
        peer.parameters[row["name"]] = row["default"]
    peer.files[DESCRIPTION] = json.dumps({"version": 1, "parameters": rows}).encode()


def own() -> Peer:
    """A drone whose controller has a parameter of its own."""
    peer = Peer()
    describing(peer, OWN)
    return peer


class Foreign(Peer):
    """Another's PX4: it sends no TWODOF message, and does not answer for an unknown parameter."""

    silent: tuple[str, ...] = ("TWODOF_", "PARAM_ERROR")

    def __init__(self) -> None:
        super().__init__(spoil=lambda _, sent: [] if sent.get_type().startswith(self.silent) else [sent])
        self.refuse[512] = (3, "")


class Mute(Foreign):
    """Does not list its parameters either."""

    silent = ("TWODOF_", "PARAM_")


@flight()
async def test_each_access_asks_the_drone(peer: Peer, drone: AsyncDrone) -> None:
    assert await drone.parameters.read("ATT_KP") == 11.0
    peer.parameters["ATT_KP"] = 6.0  # by another client, and the word of it was lost
    assert await drone.parameters.read("ATT_KP") == 6.0


@flight(own)
async def test_a_parameter_is_found_by_its_path(peer: Peer, drone: AsyncDrone) -> None:
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


@flight()
async def test_undo_restores_what_the_drone_had(peer: Peer, drone: AsyncDrone) -> None:
    assert await drone.parameters.read("ATT_KP") == 11.0
    peer.parameters["ATT_KP"] = 6.0  # by another client, and the word of it was lost
    await drone.parameters.update({"ATT_KP": 7.0})
    await drone.parameters.undo()
    assert peer.parameters["ATT_KP"] == 6.0


def repeating(make: type[Peer]) -> Peer:
    """Send each value twice, the second time just before the next one, as to a question that was repeated."""
    peer, waiting = make(), []
    within = peer.spoil

    def spoil(number: int, sent: Any) -> list[Any] | None:
        if sent.get_type() != "PARAM_VALUE":
            return within(number, sent)
        waiting.append(sent)
        return waiting[-2:]

    peer.spoil = spoil
    return peer


@pytest.mark.parametrize("make", [Peer, Foreign])
@flight(repeating)
async def test_late_answers_refuse_no_change(peer: Peer, drone: AsyncDrone, make: type[Peer]) -> None:
    for value in (10.0, 9.0, 11.0):
        made = await drone.parameters.update({"ATT_KP": value})
        assert (made.after, peer.parameters["ATT_KP"]) == ({"ATT_KP": value}, value)


@flight(Foreign)
async def test_a_foreign_drones_other_value_is_a_refusal(peer: Peer, drone: AsyncDrone) -> None:
    keep = {**peer.parameters}
    peer.parameters = type("Fixed", (dict,), {"__setitem__": lambda *_: None})(keep)
    with pytest.raises(Rejected, match="ATT_KP is 11 and not 6"):
        await drone.parameters.set("ATT_KP", 6.0)


@pytest.mark.parametrize("after", [0.0, 0.3])
@flight()
async def test_a_program_that_stood_still_hears_the_answer(peer: Peer, drone: AsyncDrone, after: float) -> None:
    peer.spoil = lambda number, sent: [sent] if loop.time() > asked + after else []
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualLoop)
    asked = loop.time()
    loop.call_later(after, loop.stand_still, 8.0)
    assert (await drone.parameters.update({"ATT_KP": 6.0})).after == {"ATT_KP": 6.0}


@pytest.mark.parametrize("reports", ["in time", "late", "another value"])
@flight()
async def test_an_unconfirmed_change_is_known_by_its_values(peer: Peer, drone: AsyncDrone, reports: str) -> None:
    """No COMMIT is answered; the drone reports the value before the deadline or after it."""

    def spoil(_: int, sent: Any) -> list[Any]:
        hidden = sent.get_type() == "PARAM_VALUE" and reports != "in time" and peer.parameters["ATT_KP"] != 11.0
        return [] if hidden or getattr(sent, "action", 0) == 1 else [sent]

    peer.spoil = spoil
    if reports == "in time":
        await drone.parameters.update({"ATT_KP": 6.0})
    else:
        with pytest.raises(Timeout, match="the drone may take it yet"):
            await drone.parameters.update({"ATT_KP": 6.0})
        with pytest.raises(Rejected, match="no change that could be undone"):
            await drone.parameters.undo()
        peer.spoil = lambda _, sent: [sent]
        peer.parameters["ATT_KP"] += reports == "another value"
        await drone.parameters.read("ATT_KP")
    texts = [line.text for line in drone.messages]
    assert texts == ["the drone has taken the late change of ATT_KP"] * (reports == "late")
    if reports != "another value":
        await drone.parameters.undo()
        assert peer.parameters["ATT_KP"] == 11.0


@flight()
async def test_a_new_list_during_a_change_is_no_fault(peer: Peer, drone: AsyncDrone) -> None:
    new_list = message("PARAM_VALUE", param_id="_HASH_CHECK", param_type=5, param_count=4, param_index=65535)
    peer.spoil = lambda _, sent: [sent, new_list] if sent.get_type() == "PARAM_VALUE" else [sent]
    made = await drone.parameters.update({"ATT_KP": 6.0})
    assert (made.before, made.after) == ({"ATT_KP": 11.0}, {"ATT_KP": 6.0})


@pytest.mark.parametrize("told", ["hash", "count", "rig"])
@flight(own)
async def test_entries_are_forgotten_when_the_list_changes(peer: Peer, drone: AsyncDrone, told: str) -> None:
    """The hash, the number of parameters or the diagram's mark shows it; one of them is enough."""
    assert await drone.parameters.read("attitude_control.k_q") == 0.1
    del peer.parameters["TMI_K_Q"]
    describing(peer, OWN | {"name": "TOT_K_Q", "default": 7.0, "max": 9.0})
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


@flight()
async def test_changes_at_once_run_one_after_the_other(peer: Peer, drone: AsyncDrone) -> None:
    """A PARAM_SET amid those of a transaction would become part of it."""
    change = drone.parameters.update
    together = [change({"ATT_KP": 1.0 + n, "RATE_KP": 0.01 + 0.001 * n}) for n in range(5)]
    await asyncio.gather(*together, *(drone.parameters.set("THRUST_BAR", 0.3 + 0.01 * n) for n in range(5)))
    assert peer.parameters["ATT_KP"] - 1.0 == pytest.approx((peer.parameters["RATE_KP"] - 0.01) * 1000.0, abs=1e-3)


@pytest.mark.parametrize("listed", [False, True])
@flight(Foreign)
async def test_a_foreign_drones_silence_means_an_unknown_parameter(peer: Peer, drone: AsyncDrone, listed: bool) -> None:
    assert not drone.ours
    if listed:
        await drone.parameters.all()
    began = asyncio.get_running_loop().time()
    with pytest.raises(ParameterError, match=r"no such parameter.*the nearest: ATT_KP"):
        await drone.parameters.read("ATT_KPP")
    assert asyncio.get_running_loop().time() - began <= SILENCE_S + 0.5
    with pytest.raises(ParameterError, match=r"no such parameter"):
        await drone.parameters.set("NOPE", 1.0)
    with pytest.raises(Rejected, match="not a twodof drone"):
        await drone.parameters.describe()
    with pytest.raises(ParameterError, match="names on a twodof drone only"):
        await drone.parameters.read("attitude_control.k_q")
    with pytest.raises(ParameterError) as raised:
        await drone.parameters.read("RATE_KI")
    assert raised.value.remedy == "the nearest: RATE_KP, ATT_KP", "of those that it has"


@flight(Foreign)
async def test_a_foreign_drone_answers_for_unlisted_parameters(peer: Peer, drone: AsyncDrone) -> None:
    """PX4 lists only the parameters in use."""
    await drone.parameters.all()
    peer.parameters["UNUSED"] = 3.0
    assert await drone.parameters.read("UNUSED") == 3.0


@flight(Foreign)
async def test_the_packages_name_finds_the_real_drones(peer: Peer, drone: AsyncDrone) -> None:
    peer.parameters["FC_PARAM_11"] = peer.parameters.pop("ATT_KP")
    assert await drone.parameters.read("ATT_KP") == 11.0
    await drone.parameters.set("ATT_KP", 9.0)
    assert peer.parameters["FC_PARAM_11"] == 9.0


@flight(Mute)
async def test_a_drone_without_a_list_is_a_timeout_with_a_cause(peer: Peer, drone: AsyncDrone) -> None:
    with pytest.raises(Timeout, match="does not answer for a name that it lacks"):
        await drone.parameters.read("ATT_KP", 3.0)


@pytest.mark.parametrize(
    "content",
    [b"", b"[]", b"{}", b"[" * 10_000, b'{"parameters": [{}]}', b'{"parameters": [{"name": "X", "type": 7}]}'],
)
@flight()
async def test_a_damaged_description_is_refused(peer: Peer, drone: AsyncDrone, content: bytes) -> None:
    peer.files[DESCRIPTION] = content
    with pytest.raises(Rejected, match="description of its parameters cannot be read"):
        await drone.parameters.read("attitude_control.k_q")
    assert await drone.parameters.read("ATT_KP") == 11.0


@pytest.mark.long
def test_watchers_see_a_flashed_controllers_parameters_which_restarts_keep(tmp_path: Path) -> None:
    async def work() -> None:
        async with VirtualDrone(lockstep=True, state=tmp_path) as drone:
            await drone.listen("memin://flashed")
            watching = await AsyncDrone.connect("mem://flashed", take_lease=False)
            async with await AsyncDrone.connect("mem://flashed") as pilot, watching:
                stock = await watching.parameters.all()
                with pytest.raises(ParameterError, match="no such parameter"):
                    await watching.parameters.read("attitude_control.k_q")
                await pilot.fly_controller("attitude_control", to_json(starter("lqr-attitude")), progress=None)
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


@flight()
async def test_the_reason_of_a_refusal_is_a_warning(peer: Peer, drone: AsyncDrone) -> None:
    def refusing(_: int, sent: Any) -> list[Any]:
        if sent.get_type() != "PARAM_VALUE":
            return [sent]
        return [
            message("STATUSTEXT", severity=4, text="1/1 withholds tuning"),
            message("STATUSTEXT", severity=6, text="RATE_KP = 0.06, by system 9"),
            message("PARAM_ERROR", param_id=sent.param_id, param_index=-1, error=2),
        ]

    await drone.parameters.read("ATT_KP")
    peer.spoil = refusing
    with pytest.raises(Rejected, match="ATT_KP: 1/1 withholds tuning"):
        await drone.parameters.set("ATT_KP", 7.0)
