"""The page about the wire: its code runs as it stands there."""

import re
import subprocess
import sys
from pathlib import Path

from tests.patience import PATIENCE_S

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "protocol.md"


def test_the_code_on_the_page_runs(tmp_path: Path) -> None:
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(), flags=re.DOTALL)
    assert len(blocks) == 3
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
    assert done.stdout.split() == ["0.17000000178813934", "0.10000000149011612", "0.0"]
