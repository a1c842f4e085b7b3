"""A disk that is full in flight, on the whole system: nothing written is lost, and nothing waits for the disk."""

import json
import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from tests.faults.test_clocks import Clock, signed
from tests.faults.virtual_time import on_virtual_time
from tests.faults.whole import Whole, silent, stands
from twodof.errors import LogError, ParameterError, RecordingError
from twodof.flightlog.mcap_file import recover
from twodof.link.signing import Key, Signing, SigningVerdict, Stamps

pytestmark = pytest.mark.slow


@contextmanager
def full_disk(most: int) -> Iterator[None]:
    """No file may exceed `most` bytes: the kernel refuses as a full disk does, in the middle of a write."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def answered(*flushes: Callable[[], object]) -> None:
    """The threads that write live in real time, and the flight waits here until they have tried."""
    for flush in flushes:
        with suppress(LogError, ParameterError):
            flush()


@pytest.mark.long
@pytest.mark.parametrize("turns", [4, pytest.param(12, marks=pytest.mark.soak)])
@on_virtual_time
async def test_a_disk_that_is_full_in_flight_stops_no_command_and_loses_nothing_written(
    turns: int, tmp_path: Path
) -> None:
    """Recorder, on-board log, parameters and time stamps of signing at once: in 12 s by the clock all is heard.

    Then there is room again: parameters and stamps are written, the next flight has its log.
    """
    key = Key.fresh()
    state, recorded = tmp_path / "drone", tmp_path / "ground.mcap"
    clock = Clock()
    stamps = tmp_path / "stamps.json"
    signing = Signing(key, Stamps(stamps, clock))
    async with Whole(signing=signing, state=state) as whole:
        log, store = whole.drone.assembly.log, whole.drone.assembly.store
        drone = await signed(whole, key, clock)
        await drone.run(0.5)
        records = drone.record(recorded)
        recording = await records.__aenter__()
        await drone.arm()
        await drone.set_pitch(0.1, thrust=0.4)
        await drone.run(1.0)
        log.flush()
        recorder = recording.recorder
        kept = recorder.flush().samples
        first = whole.tick
        with full_disk(0):
            await drone.parameters.set("ATT_KP", 9.0)
            for turn in range(turns):  # the stamps on the disk run 10 s ahead
                await drone.set_pitch(0.1 * (-1) ** turn, thrust=0.4)
                await drone.run(1.0)
                clock.offset += 12 / turns - 1.0
                answered(log.flush, store.flush, recorder.flush)
            assert signing.stamps.failure
            assert silent(whole.since(first))
            await drone.kill()
            assert stands(whole.steps[-1])
            await drone.release()
            await drone.run(1.5)  # a flight's log ends a second after it
            answered(log.flush)
            assert recording.failure is not None
        with pytest.raises(RecordingError, match="File too large"):
            await records.__aexit__(None, None, None)
        said = " ".join(text.text for text in drone.messages)
        assert "no on-board log" in said
        assert "parameters are not stored" in said
        assert (signing.counts[SigningVerdict.REPEATED], signing.counts[SigningVerdict.STALE]) == (0, 0)
        await drone.run(0.5)  # there is room again
        await drone.arm()
        await drone.set_pitch(0.1, thrust=0.4)
        await drone.run(2.0)
        await drone.close()
    rescued = recover(recorded).log
    assert sum(len(rescued[name]) for name in rescued) >= kept > 0
    first_log, second_log = sorted((state / "logs").glob("*.ulg"))
    assert len(recover(first_log).log["theta"]) > 250
    assert len(recover(second_log).log["theta"]) > 500
    assert json.loads((state / "parameters.json").read_text())["parameters"]["ATT_KP"] == 9.0
    assert json.loads(stamps.read_text())["own"] >= signing.stamps.own
