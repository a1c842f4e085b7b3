"""The user's page: its code runs as it stands there, and its tables name what there is."""

import re
import subprocess
import sys
from pathlib import Path

from tests.patience import PATIENCE_S
from twodof.gcs.drone import Drone

PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "fly-from-python.md"
# It starts five virtual drones, each in about a second; on a loaded machine several times that.


def test_the_code_on_the_page_runs(tmp_path: Path) -> None:
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert len(blocks) == 6
    script = tmp_path / "page.py"
    script.write_text("\n".join(blocks))
    done = subprocess.run(
        [sys.executable, "-W", "error", str(script)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "done" in done.stdout
    assert (tmp_path / "flight.mat").is_file()


def test_every_verb_in_the_table_is_one_of_the_drones() -> None:
    table = PAGE.read_text(encoding="utf-8").split("| verb | is |")[1].split("\n\n")[0]
    verbs = re.findall(r"`(\w+)\(", table)
    assert len(verbs) > 15
    assert [verb for verb in verbs if not callable(getattr(Drone, verb, None))] == []
