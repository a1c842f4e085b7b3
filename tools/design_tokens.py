"""Copies web/src/design/tokens.css, the one place of the design's colours, to the report and to the documentation.

`python -m tools.design_tokens` writes the copies; a test compares them.
"""

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "web" / "src" / "design" / "tokens.css"
COPIES = (ROOT / "src" / "twodof" / "report" / "templates" / "tokens.css", ROOT / "docs" / "tokens.css")
_HEAD = "/* Made by tools/design_tokens.py from web/src/design/tokens.css; do not edit. */\n"


def render() -> str:
    """The text of a copy."""
    return _HEAD + SOURCE.read_text(encoding="utf-8")


if __name__ == "__main__":
    for copy in COPIES:
        copy.write_text(render(), encoding="utf-8")
        sys.stdout.write(f"{copy} written\n")
