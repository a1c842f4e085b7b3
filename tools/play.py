"""Writes the page Play into out/play: `python tools/play.py`, which `make play` runs after tools/web.sh has built it.

The virtual rig and the flight code are compiled to WebAssembly and stand in the page itself, with its script and its
styles. It is one file of less than a megabyte. It needs no server and no network, and opens from a folder.
"""

import base64
import html
import json
import re
import sys
from pathlib import Path

from twodof.sim.portable_loop import play_program

PROJECT = Path(__file__).resolve().parents[1]
BUILT = PROJECT / "out" / "play-build"
OUT = PROJECT / "out" / "play"


def page(built: Path) -> str:
    """The page, of what Vite has built in `built` (play.html, play.js, play.css)."""
    wasm, told = play_program()
    text = (built / "play.html").read_text(encoding="utf-8")
    # What Vite links to is put in instead.
    text = re.sub(r"\s*<(?:script|link)[^>]*\bplay\.(?:js|css)\"[^>]*>(?:</script>)?", "", text)
    script = (built / "play.js").read_text(encoding="utf-8").replace("</script", r"<\/script")
    styles = (built / "play.css").read_text(encoding="utf-8").replace("</style", r"<\/style")
    module = base64.b64encode(wasm).decode("ascii")
    # In JSON a "<" may be written so, and no text in it can end the element.
    data = json.dumps(told, separators=(",", ":")).replace("<", r"\u003c")
    parts = (
        f'<script type="text/plain" id="play-module">{html.escape(module)}</script>',
        f'<script type="application/json" id="play-data">{data}</script>',
        f"<script>{script}</script>",
    )
    text = text.replace("</head>", f"<style>{styles}</style>\n</head>")
    return text.replace("</body>", "\n".join(parts) + "\n</body>")


def write(folder: Path = OUT) -> Path:
    """Write `folder`/index.html; returns it. Raises SystemExit where the page was not built."""
    if not (BUILT / "play.js").is_file():
        raise SystemExit(f"error: {BUILT} has no page: run tools/web.sh PYTHON play, or make play")
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "index.html"
    path.write_text(page(BUILT), encoding="utf-8")
    return path


if __name__ == "__main__":
    path = write()
    sys.stdout.write(
        f"written: {path.relative_to(PROJECT)}; open it in a browser, from the folder or from any server\n"
    )
