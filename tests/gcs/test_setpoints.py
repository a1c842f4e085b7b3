"""Set-points and times beyond their bounds are refused before anything is sent, with the bounds in the words."""

from math import inf, nan

import pytest

from tests.faults.virtual_time import run_virtual
from tests.gcs.peer import Peer
from twodof.errors import ParameterError
from twodof.gcs import setpoints
from twodof.gcs.async_drone import AsyncDrone


@pytest.mark.parametrize("M", [5.0, -1.01, nan, inf])
def test_a_moment_beyond_its_bounds_is_refused(M: float) -> None:
    with pytest.raises(ParameterError, match=r"outside -1 to 1|is not a finite number"):
        setpoints.moment(M, None)


def test_a_thrust_beyond_its_bounds_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"thrust = 1\.5 is outside 0 to 1"):
        setpoints.pitch(0.1, 1.5)


@pytest.mark.parametrize("seconds", [-1, -1e-9, inf, nan])
def test_time_does_not_pass_backwards_and_not_for_ever(seconds: float) -> None:
    async def work() -> None:
        async with Peer() as peer, await AsyncDrone.connect(peer.url) as drone:
            with pytest.raises(ParameterError, match="give 0 or more seconds"):
                await drone.run(seconds)
            with pytest.raises(ParameterError, match="M = 5 is outside -1 to 1"):
                await drone.set_moment(5.0)
            assert drone.setpoints.sent == 0

    run_virtual(work())
