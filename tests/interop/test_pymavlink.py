"""The script for pymavlink on the page about clients, as it stands there, flies a drone behind its companion."""

import re
import subprocess
import sys
from pathlib import Path

from tests.patience import PATIENCE_S

PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "connect-clients.md"


def test_the_script_on_the_page_flies(companion_port: int, tmp_path: Path) -> None:
    """It arms, follows a pitch of .1 rad within .02 for a second, disarms; mavutil gives itself the component 0."""
    text = PAGE.read_text(encoding="utf-8").split("## pymavlink")[1].split("## node-mavlink")[0]
    (block,) = re.findall(r"```py\n(.*?)```", text, flags=re.DOTALL)
    script = tmp_path / "fly.py"
    script.write_text(block.replace(":14540", f":{companion_port}"))
    command = [sys.executable, str(script)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    pitch = re.search(r"pitch ([+-][\d.]+) rad", done.stdout)
    assert pitch is not None
    assert abs(float(pitch[1]) - 0.1) < 0.02
    assert "disarmed True" in done.stdout
