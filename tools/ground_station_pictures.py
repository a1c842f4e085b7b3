"""Pictures of docs/tutorials/ground-station.md, taken by following it.

`python -m tools.ground_station_pictures` needs Chromium, and the page built (`make web`).
"""

import io
import shutil
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

from tests.web.conftest import ARGUMENTS, SIZES
from tests.web.ground_station_lesson import run
from tests.web.lab_server import served

PICTURES = Path(__file__).resolve().parents[1] / "docs" / "pictures"
COLOURS = 128
"""Of each of two sorts: a page has few, and a picture takes a third of the bytes."""


def reduced(screenshot: bytes) -> Image.Image:
    """The picture in `2 * COLOURS` colours: those of the most pixels, for the page, and the rare ones of the curves."""
    drawn = Image.open(io.BytesIO(screenshot)).convert("RGB")
    counted = sorted(drawn.getcolors(drawn.width * drawn.height) or [], reverse=True)
    often = [part for _, colour in counted[:COLOURS] for part in colour]
    rare = drawn.quantize(COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).getpalette() or []
    palette = Image.new("P", (1, 1))
    palette.putpalette(often + rare[: 3 * COLOURS])
    return drawn.quantize(palette=palette, dither=Image.Dither.NONE)


def main() -> int:
    """Writes docs/pictures/ground-station-*.png."""
    with tempfile.TemporaryDirectory() as folder, served(Path(folder)) as server, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=list(ARGUMENTS))
        width, height = SIZES["wide"]
        context = browser.new_context(viewport={"width": width, "height": height}, reduced_motion="reduce")
        page = context.new_page()

        def take(name: str) -> None:
            path = PICTURES / f"ground-station-{name}.png"
            reduced(page.screenshot()).save(path, optimize=True)
            sys.stdout.write(f"{path} written\n")

        page.goto(server.link)
        run(page, take)
        browser.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
