"""The registry of public logs: where it looks, what it verifies, and that it never hangs."""

import hashlib
import threading
from collections.abc import Iterator
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from twodof.errors import LogError
from twodof.flightlog import public_data
from twodof.flightlog.public_data import PUBLIC_LOGS, PublicLog, available, download, find

CONTENT = b"a log"
ROW = PublicLog("made-up", "", hashlib.sha256(CONTENT).hexdigest(), "for a test")


class _Site(BaseHTTPRequestHandler):
    stop = threading.Event()

    def do_GET(self) -> None:
        if self.path == "/missing":
            self.send_error(404)
            return
        if self.path == "/rubbish":
            self.wfile.write(b"rubbish\r\n\r\n")
            return
        self.send_response(200)
        self.end_headers()
        if self.path == "/slow":
            # A byte now and then keeps a socket's own time-out from ever passing.
            while not self.stop.wait(0.05):
                try:
                    self.wfile.write(b".")
                except OSError:
                    return
        else:
            self.wfile.write(CONTENT if self.path == "/log" else bytes(1 << 20))

    def log_message(self, format: str, *values: object) -> None:
        """Log nothing."""


@pytest.fixture
def site() -> Iterator[str]:
    _Site.stop.clear()
    server = ThreadingHTTPServer(("127.0.0.1", 0), _Site)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield f"http://127.0.0.1:{server.server_address[1]}"
    _Site.stop.set()
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.fixture
def nowhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """No log at hand: an empty folder and an empty cache."""
    (tmp_path / "folder").mkdir()
    monkeypatch.setenv("TWODOF_FLIGHT_DATA", str(tmp_path / "folder"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path


def test_registry_is_complete_and_unambiguous() -> None:
    assert len(PUBLIC_LOGS) == 7
    assert len({row.sha256 for row in PUBLIC_LOGS.values()}) == 7
    assert all(len(row.sha256) == 64 and row.url.startswith("https://") for row in PUBLIC_LOGS.values())
    assert PUBLIC_LOGS["position-sweep-default"].url.endswith("2dd%20%281%29.mat")


def test_the_folder_at_hand_is_found(flight_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TWODOF_FLIGHT_DATA", str(flight_data))
    assert set(available()) == set(PUBLIC_LOGS)
    assert find("doublet-0.03") == find("doublet-0.03.mat") == flight_data / "doublet-0.03.mat"


def test_a_download_is_verified_and_kept(nowhere: Path, site: str, monkeypatch: pytest.MonkeyPatch) -> None:
    row = replace(ROW, url=f"{site}/log")
    assert available() == {}
    with pytest.raises(LogError, match=r"no such public log .choose one of free-response-impulse, doublet"):
        find("no-such-log")
    monkeypatch.setattr(public_data, "PUBLIC_LOGS", {"made-up": row})
    path = find("made-up", deadline_s=20.0)
    assert path == nowhere / "cache" / "twodof" / "flight-data" / "made-up.mat"
    assert path.read_bytes() == CONTENT
    monkeypatch.setattr(public_data, "PUBLIC_LOGS", {"made-up": replace(row, url=f"{site}/missing")})
    assert find("made-up") == path
    path.write_bytes(b"changed")
    with pytest.raises(LogError, match=r"its sha256 is .*remove the file"):
        find("made-up")


@pytest.mark.parametrize(
    ("page", "says"),
    [
        ("/missing", "cannot be downloaded from http.*404"),
        ("/rubbish", "cannot be downloaded from http.*: the answer is not HTTP"),
        ("/other", "its sha256 is"),
    ],
)
def test_a_wrong_answer_leaves_nothing(nowhere: Path, site: str, page: str, says: str) -> None:
    with pytest.raises(LogError, match=says):
        download(replace(ROW, url=site + page), nowhere / "cache", 20.0)
    assert not (nowhere / "cache").exists()


def test_a_slow_answer_ends_at_the_deadline(nowhere: Path, site: str) -> None:
    with pytest.raises(LogError, match=r"no answer within 0.3 s .*set TWODOF_FLIGHT_DATA to a folder"):
        download(replace(ROW, url=f"{site}/slow"), nowhere / "cache", 0.3)


def test_too_long_an_answer_is_cut(nowhere: Path, site: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(public_data, "MAX_BYTES", 1 << 18)
    with pytest.raises(LogError, match="more than 262144 bytes"):
        download(replace(ROW, url=f"{site}/long"), nowhere / "cache", 20.0)


def test_no_network_says_so_in_one_line(nowhere: Path) -> None:
    # Port 9 of the own machine: refused at once, as without a network.
    with pytest.raises(LogError) as caught:
        download(replace(ROW, url="http://127.0.0.1:9/log"), nowhere / "cache", 20.0)
    assert "\n" not in str(caught.value)
    assert "TWODOF_FLIGHT_DATA" in str(caught.value)
