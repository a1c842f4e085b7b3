"""Getting to know a drone that was found: whether it is one of ours, who we are to it, and whether we command it."""

from __future__ import annotations

from contextlib import suppress

from twodof.errors import LinkLost, Timeout
from twodof.gcs.drone_base import DroneBase
from twodof.gcs.mavlink.deadline import Deadline
from twodof.gcs.mavlink.identity import drawn

_GREETING_S, _RETRY_S = 4.0, 0.3
_WORTH_SAYING_S = 0.5


async def greet(drone: DroneBase, deadline: Deadline, drawn_id: bool) -> None:
    """Learn whether it is one of ours, and if so how its time passes; take the lease if it is to command.

    `drawn_id`: our system id was drawn, so another one may be drawn. Raises LinkLost, Rejected, Timeout.
    """
    session = drone.session
    try:
        drone.ours = await _answers(drone, "TWODOF_RIG", "asking what it is", deadline)
    except Timeout:  # it is somebody else's, which does not know the question, or does not let us in
        signed = session.signed_frames
        if signed and session.connection.signing is None:
            what = f"drone {session.system} answers nothing: {signed} frames came signed, and we have no key"
            raise LinkLost(what, session.url, "connect with its key: key=FILE") from None
    drone.parameters.transactions = drone.commands.words_follow = drone.ours
    if drone.ours and drawn_id:
        await _differ(drone, deadline)
    if drone.ours and drone.commanding:
        waited = await drone.lease.take(deadline.left)
        if waited > _WORTH_SAYING_S:
            drone.texts.note("notice", f"waited {waited:.1f} s for the lease of somebody who is not heard any more")
        if session.lockstep:
            await drone.clock.begin_granting(deadline.left)


async def _differ(drone: DroneBase, deadline: Deadline) -> None:
    """Draw another id where somebody who has the lease drew the same: else we would have their lease."""
    with suppress(Timeout):
        await _answers(drone, "TWODOF_LEASE", "asking who has the lease", deadline)
    connection, holder = drone.session.connection, drone.lease.holder
    if holder is not None and holder[0] == connection.system:
        connection.system = drawn(besides=(connection.system,))
        drone.session.beat()


async def _answers(drone: DroneBase, name: str, doing: str, deadline: Deadline) -> bool:
    """Whether it sends this message when asked. Raises Timeout, LinkLost."""
    asking = drone.session.deadline(min(_GREETING_S, deadline.left), doing)
    return await drone.commands.request(name, asking, _RETRY_S) is not None
