"""Fixtures of the page's tests: a browser, a server with a virtual drone, axe. Screenshots go to `out/web`."""

from __future__ import annotations

import fcntl
import functools
import re
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Generator, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from itertools import product
from pathlib import Path
from typing import Literal, TypeVar

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect, sync_playwright

from tests import toolchains
from tests.patience import PATIENCE_S
from tests.web.lab_server import LabServer, served

PROJECT = Path(__file__).resolve().parents[2]
PICTURES = PROJECT / "out" / "web"
# On a busy computer a drone may refuse to arm, refuse what it shall fly after its failsafe has stopped the motors, or
# answer too late. A test finds itself whether it flies.
NOT_DONE = re.compile(r"status of (409 .*/(arm|setpoint|excitation)|504 .*/drones/\d+/\w+)\)$")
ARGUMENTS = (
    "--no-sandbox",
    "--disable-gpu",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
)
NO_WEBGL = """(() => {
  const context = HTMLCanvasElement.prototype.getContext;
  HTMLCanvasElement.prototype.getContext = function (kind, ...options) {
    return kind.startsWith("webgl") ? null : context.call(this, kind, ...options);
  };
})()"""
SIZES = {"wide": (1280, 720), "tablet": (1024, 768), "upright": (768, 1024), "phone": (390, 844)}
Theme = Literal["light", "dark"]
THEMES: tuple[Theme, ...] = ("light", "dark")
expect.set_options(timeout=PATIENCE_S * 1000)

OpenPage = Callable[..., Page]
Kept = TypeVar("Kept")
KEPT = pytest.StashKey[dict[str, tuple[object, ExitStack]]]()
"""Resources by the name of their fixture; each lives as long as the next test asks for it too."""


def kept(request: pytest.FixtureRequest, start: Callable[[], AbstractContextManager[Kept]], kind: type[Kept]) -> Kept:
    """Return the resource of a fixture; start it if there is none."""
    there = request.config.stash.setdefault(KEPT, {})
    name = request.fixturename
    assert name is not None
    if name not in there:
        with ExitStack() as stack:
            there[name] = (stack.enter_context(start()), stack.pop_all())
    found = there[name][0]
    assert isinstance(found, kind)
    return found


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> Generator[None]:
    """Close the resources that the next test does not ask for."""
    try:
        return (yield)
    finally:
        there = item.config.stash.setdefault(KEPT, {})
        for name in [*there]:
            if name not in getattr(nextitem, "fixturenames", ()):
                there.pop(name)[1].close()


@pytest.fixture(scope="session")
def built_page() -> Path:
    """Build the page if web/ has changed; return its folder."""
    with (Path(tempfile.gettempdir()) / "twodof-tests-web-build.lock").open("w") as held:
        fcntl.flock(held, fcntl.LOCK_EX)  # the tests of several processes come here at once
        done = subprocess.run(
            [PROJECT / "tools" / "web.sh", sys.executable, "build"],
            capture_output=True,
            text=True,
            timeout=2 * PATIENCE_S,
            check=False,
        )
    assert done.returncode == 0, done.stdout + done.stderr
    return PROJECT / "src" / "twodof" / "lab" / "page"


@contextmanager
def launched() -> Iterator[Browser]:
    """Start a Chromium."""
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=list(ARGUMENTS))
        yield chromium
        chromium.close()


@pytest.fixture
def browser(request: pytest.FixtureRequest) -> Browser:
    """Return a Chromium that tests share."""
    toolchains.need("chromium")
    return kept(request, launched, Browser)


class Window:
    """Window in which each test opens a tab of its own; fetched and compiled files stay for the next one."""

    def __init__(self, browser: Browser) -> None:
        self.context = new_window(browser)
        self.tab = self.context.new_page()

    def renew(self) -> None:
        """Replace the tab and clear its storage. The old tab closes last, or all would be compiled again."""
        for page in self.context.pages:
            if page.url.startswith("http"):
                page.evaluate("localStorage.clear()")
        self.context.clear_cookies()
        self.tab = self.context.new_page()
        for page in self.context.pages:
            if page is not self.tab:
                page.close()


def new_window(browser: Browser, touch: bool = False, three_d: bool = False) -> BrowserContext:
    """Open an empty window."""
    context = browser.new_context(reduced_motion="reduce", has_touch=touch)
    context.set_default_timeout(PATIENCE_S * 1000)
    if not three_d:
        context.add_init_script(NO_WEBGL)
    return context


@pytest.fixture
def window(browser: Browser, request: pytest.FixtureRequest) -> Window:
    """Return the shared window; use `open_page` instead."""
    return kept(request, lambda: nullcontext(Window(browser)), Window)


@pytest.fixture
def open_page(browser: Browser, window: Window) -> Iterator[OpenPage]:
    """Open a link in a clean window: `open_page(link, "tablet", "dark")`.

    There is no WebGL without `three_d`, which is slow by software. `own` opens a new window. Errors of the page fail
    the test at its end, except those that contain a text of `expects`.
    """
    contexts: list[BrowserContext] = []
    errors: list[str] = []
    expected: list[str] = ["THREE.WebGLRenderer"]  # what it says where there is none
    opened: list[Page] = []

    def open_one(
        link: str,
        size: str = "wide",
        theme: Theme = "light",
        expects: tuple[str, ...] = (),
        three_d: bool = False,
        own: bool = False,
    ) -> Page:
        if opened or own or three_d or size != "wide":
            contexts.append(new_window(browser, size != "wide", three_d))
            page = contexts[-1].new_page()
        else:
            page = window.tab
        opened.append(page)
        width, height = SIZES[size]
        page.set_viewport_size({"width": width, "height": height})
        page.emulate_media(color_scheme=theme)
        expected.extend(expects)
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on(
            "console",
            lambda said: errors.append(f"{said.text} ({said.location['url']})") if said.type == "error" else None,
        )
        page.goto(link)
        return page

    yield open_one
    for context in contexts:
        context.close()
    if window.tab in opened:
        window.renew()
    errors = [error for error in errors if not NOT_DONE.search(error)]
    unexpected = [error for error in errors if not any(words in error for words in expected)]
    assert not unexpected, unexpected


@pytest.fixture
def shared_server(
    request: pytest.FixtureRequest, built_page: Path, tmp_path_factory: pytest.TempPathFactory
) -> LabServer:
    """Return the shared server; use `lab_server` instead."""
    assert built_page.is_dir()
    return kept(request, lambda: served(tmp_path_factory.mktemp("lab")), LabServer)


@pytest.fixture
def lab_server(shared_server: LabServer) -> LabServer:
    """Serve the page and a virtual drone at its start."""
    shared_server.calm()
    return shared_server


AXE = PROJECT / "web" / "node_modules" / "axe-core" / "axe.min.js"


def axe(page: Page, within: str = "body") -> list[str]:
    """Return the faults that axe finds, one line each."""
    page.evaluate(
        AXE.read_text(encoding="utf-8") + ";0"
    )  # not as a script element, which the page's own policy forbids
    found = page.evaluate("(within) => axe.run(within, { resultTypes: ['violations'] })", within)
    return [
        f"{fault['id']}: {fault['help']} at {', '.join(' '.join(map(str, node['target'])) for node in fault['nodes'])}"
        for fault in found["violations"]
    ]


def picture(page: Page, name: str) -> Path:
    """Write a screenshot to out/web."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    path = PICTURES / f"{name}.png"
    page.screenshot(path=path)
    return path


def looks(page: Page, name: str) -> Iterator[tuple[str, Theme]]:
    """Show each size and theme in turn; check that nothing scrolls sideways, and take a picture."""
    for size, theme in product(SIZES, THEMES):
        width, height = SIZES[size]
        page.set_viewport_size({"width": width, "height": height})
        page.emulate_media(color_scheme=theme)
        assert not scrolls_sideways(page), (size, theme)
        picture(page, f"{name}-{size}-{theme}")
        yield size, theme


def readable(page: Page, name: str) -> None:
    """Check the page in each size and theme, and by axe in both themes."""
    for size, theme in looks(page, name):
        if size == "wide":
            assert axe(page) == [], theme


def scrolls_sideways(page: Page) -> bool:
    """Return whether the page is wider than its window."""
    wider: bool = page.evaluate("document.documentElement.scrollWidth > document.documentElement.clientWidth")
    return wider


class QuietHandler(SimpleHTTPRequestHandler):
    """Handler of file requests without a log."""

    def log_message(self, format: str, *args: object) -> None:
        """Write nothing."""


@contextmanager
def files_served(folder: Path) -> Iterator[str]:
    """Serve the files of a folder; yields the link."""
    handler = functools.partial(QuietHandler, directory=str(folder))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{server.server_address[1]}/"
        server.shutdown()
        thread.join()
