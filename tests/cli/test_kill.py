"""`twodof kill` and `twodof key`: a drone left armed by somebody else is stopped from the shell, signed or not."""

import json
from pathlib import Path

import pytest

from tests.cli.program import Shell
from tests.fcu.program import twodof_fcu
from tests.patience import PATIENCE_S
from twodof.cli.app import run
from twodof.errors import Rejected
from twodof.gcs.drone import Drone
from twodof.link.signing import read_key

pytestmark = pytest.mark.slow


@pytest.mark.long
def test_kill_stops_another_pilots_drone(tmp_path: Path, capfd: pytest.CaptureFixture[str], shell: Shell) -> None:
    file = tmp_path / "drone.key"
    assert run(["key", str(file), "--json"]) == 0
    made = read_key(file)
    assert json.loads(capfd.readouterr().out) == {"file": str(file), "fingerprint": made.fingerprint}
    with twodof_fcu("--rings", "--state", str(tmp_path / "state"), "--key", str(file)) as url:
        with Drone.connect(url, key=made) as pilot:
            pilot.arm()
            pilot.set_pitch(0.0, thrust=0.4)
            capfd.readouterr()
            said = shell(["kill", "--url", url, "--key", str(file), "--json"]).json
            assert (said["was_armed"], said["held"]) == (True, True)
            with pytest.raises(Rejected, match="the drone was killed"):
                pilot.run(PATIENCE_S)  # what streams set-points is told so
            assert not pilot.state.armed
        # Leaving has disarmed it in the ordinary way, which released nothing: the same script again does not fly.
        with (
            Drone.connect(url, key=made) as again,
            pytest.raises(Rejected, match=r"killed by system \d+, component 190"),
        ):
            again.arm()
        capfd.readouterr()
        said_again = shell(["kill", "--url", url, "--key", str(file)]).out
        assert "it was not armed" in said_again
        assert f"held so until released: twodof kill --release --url {url}" in said_again
        for was in (True, False):
            said = shell(["kill", "--release", "--url", url, "--key", str(file), "--json"]).json
            assert said == {"url": url, "was_held": was, "held": False}
        with Drone.connect(url, key=made) as again:
            again.arm()


def test_a_key_is_never_written_over(tmp_path: Path, capfd: pytest.CaptureFixture[str], shell: Shell) -> None:
    file = tmp_path / "drone.key"
    assert run(["key", str(file)]) == 0
    before = file.read_bytes()
    said = capfd.readouterr().out
    assert read_key(file).fingerprint in said
    assert before.strip().decode() not in said
    assert "is there already" in shell(["key", str(file)], 2).err
    assert file.read_bytes() == before
