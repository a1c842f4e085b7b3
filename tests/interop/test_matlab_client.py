"""The MATLAB client, in Octave: the script of its page flies, identifies and tunes; refusals carry their reasons."""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.patience import PATIENCE_S
from tests.toolchains import need
from tests.web.lab_server import LabServer, served

pytestmark = pytest.mark.slow

PROJECT = Path(__file__).resolve().parents[2]
MU = 358.5  # [rad/s2], of the paper and its rig
SIGMAS = 5.0  # the interval is of noise alone, and the flight is in real time on a busy computer


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LabServer]:
    need("octave-cli", "curl")
    with served(tmp_path_factory.mktemp("data"), "--rings", "--rig", "paper", "--token") as found:
        yield found


def octave(program: str, server: LabServer, folder: Path) -> str:
    """Run a program in Octave, in the repository's folder, and return what it prints."""
    script = folder / "script.m"
    script.write_text(program)
    done = subprocess.run(
        ["octave-cli", "--norc", "--quiet", str(script)],
        cwd=PROJECT,
        env=os.environ | {"TWODOF_LINK": server.link},
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    errors = [line for line in done.stderr.splitlines() if not line.startswith("error: ignoring const")]
    assert errors == [], done.stdout  # Octave 7.3 prints that line as it ends
    return done.stdout


@pytest.mark.long
def test_the_script_of_the_page_flies_and_identifies(server: LabServer, tmp_path: Path) -> None:
    page = (PROJECT / "docs" / "how-to" / "fly-from-matlab.md").read_text()
    (program,) = re.findall(r"```matlab\n(.*?)```", page, flags=re.DOTALL)
    said = octave(program, server, tmp_path)
    found = re.search(r"mu = ([\d.]+) \+- ([\d.]+) rad/s2", said)
    assert found, said
    mu, sigma = map(float, found.groups())
    assert abs(mu - MU) < SIGMAS * sigma + 1.0
    (rate,) = re.findall(r"largest pitch rate: ([\d.]+) rad/s", said)
    assert 1.0 < float(rate) < 20.0
    (pitch,) = re.findall(r"pitch: (-?[\d.]+) rad", said)
    assert abs(float(pitch) - 0.17) < 0.05
    assert "ATT_KP = 9" in said
    assert server.until(armed=False)["lease_holder"] is not None
    assert len(server.call("GET", "logs")["logs"]) >= 1


@pytest.mark.long
def test_a_refusal_says_why(server: LabServer, tmp_path: Path) -> None:
    program = """
addpath('matlab');
drone = twodof.connect();
drone.reset('rings', true);
try, drone.set_pitch(100); catch e, disp([e.identifier, ' ', e.message]); end
try, drone.set_parameters(struct('RATE_KP', 7)); catch e, disp([e.identifier, ' ', e.message]); end
try, drone.log('no such.mcap'); catch e, disp([e.identifier, ' ', e.message]); end
try, drone.identify('no such.mcap'); catch e, disp([e.identifier, ' ', e.message]); end
link = strtok(getenv('TWODOF_LINK'), '?');
other = twodof.connect(link, 1);
try, other.arm(); catch e, disp([e.identifier, ' ', e.message]); end
try, twodof.connect(link); catch e, disp([e.identifier, ' ', e.message]); end
"""
    said = octave(program, server, tmp_path).splitlines()
    wanted = (
        "twodof:refused set-point: angles are in radians",
        "twodof:refused RATE_KP",
        "twodof:refused no such.mcap",
        "twodof:refused no such.mcap",
        "twodof:refused ",
        "twodof:http GET ",
    )
    assert len(said) == len(wanted), said
    for line, beginning in zip(said, wanted, strict=True):
        assert line.startswith(beginning), said
    assert "token is missing" in said[4]
