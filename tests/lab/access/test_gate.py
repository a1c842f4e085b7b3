"""Access to the server by host, origin, token, role and size on every route, and the page."""

import re
import socket
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus

from tests.lab.served import COMMAND, WATCH, Served, served
from tests.patience import PATIENCE_S
from twodof.errors import LinkError
from twodof.lab.access import LabRoute, lab_routes
from twodof.lab.server import ROUTERS
from twodof.lab.settings import LabSettings

pytestmark = pytest.mark.slow

ROWS = [(method, route) for route in lab_routes(ROUTERS) for method in sorted(route.methods)]
READS = {"GET", "HEAD"}
# What clients that only watch may call, beside reading: to let them call one more is a decision, which this list says.
# These compute and change nothing, or stop the motors.
FOR_WATCHERS = {
    "/api/diagrams/check",
    "/api/diagrams/code",
    "/api/diagrams/compile",
    "/api/diagrams/margins",
    "/api/diagrams/px4",
    "/api/diagrams/read",
    "/api/diagrams/shapes",
    "/api/diagrams/simulink",
    "/api/drones/{number}/parameters/file",
    "/api/excitations/preview",
    "/api/export/mat",
    "/api/identification/fit",
    "/api/identification/plan",
    "/api/tuning/{number}/measured",
    "/api/tuning/{number}/preview",
    "/api/tuning/{number}/step",
    "/api/drones/{number}/kill",
}


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with served(tmp_path_factory.mktemp("lab"), command_token=COMMAND, watch_token=WATCH) as found:
        yield found


def path_of(route: LabRoute) -> str:
    """A path of the route, with parameters that name nothing."""
    return re.sub(r"\{(number|drone)(:\w+)?\}", "77", re.sub(r"\{(?!number|drone)\w+(:\w+)?\}", "nothing", route.path))


@pytest.mark.parametrize(("method", "route"), ROWS, ids=[f"{method} {route.path}" for method, route in ROWS])
def test_watchers_read_compute_and_stop_only(server: Served, method: str, route: LabRoute) -> None:
    allowed = method in READS or (method == "POST" and route.path in FOR_WATCHERS)
    assert route.for_watchers == allowed
    answer = server.ask(method, path_of(route), {}, token=WATCH)
    refused = answer.status == 403
    assert refused != allowed, (answer.status, answer.content[:300])
    if refused:
        assert answer.json["what"] == "this link is for watching only"
    else:
        assert answer.status < 500 or answer.status == 504
    with_none = server.ask(method, path_of(route), {}, token="not-a-token")
    assert with_none.status == 401
    assert "token" in with_none.json["what"]
    from_elsewhere = server.ask(method, path_of(route), {}, {"Origin": "http://evil.example"}, token=COMMAND)
    if method not in READS:
        assert from_elsewhere.status == 403
        assert "another site" in from_elsewhere.json["what"]


def test_every_route_is_under_the_gate_and_in_the_description(server: Served) -> None:
    described = server.ask("GET", "/api/openapi.json", token=WATCH).json["paths"]
    routes = {(method.lower(), re.sub(r":\w+\}", "}", route.path)) for method, route in ROWS}
    assert {(method, path) for path, methods in described.items() for method in methods} == routes
    assert all(path.startswith("/api/") for _, path in routes)
    assert server.ask("GET", "/api/openapi.json", token="x").status == 401


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("127.0.0.1:{port}", 200),
        ("localhost:{port}", 200),
        ("LOCALHOST:1", 200),
        ("[::1]:{port}", 200),
        ("evil.example:{port}", 421),
        ("127.0.0.1.evil.example", 421),
        ("192.168.1.5:{port}", 421),
        ("localhost.evil.example", 421),
        ("", 421),
        ("[::1", 421),
        ("a b", 421),
    ],
)
def test_a_name_that_somebody_lets_point_here_is_not_ours(server: Served, host: str, status: int) -> None:
    headers = {"Host": host.format(port=server.port)}
    assert server.ask("GET", "/api/session", None, headers, token=COMMAND).status == status
    assert (server.ask("GET", "/", None, headers).status == 421) == (status == 421)  # the page too


@pytest.mark.parametrize(
    ("site", "api"), [("cross-site", 403), ("same-site", 403), ("same-origin", 200), ("none", 200)]
)
def test_reads_that_another_site_makes_are_refused(server: Served, site: str, api: int) -> None:
    headers = {"Sec-Fetch-Site": site}
    answer = server.ask("GET", "/api/session", None, headers, token=COMMAND)
    assert answer.status == api
    assert api == 200 or "another site" in answer.json["what"]
    assert server.ask("GET", "/", None, headers).status in (200, 503), "a link opens the page"


def test_requests_of_another_port_are_refused(server: Served) -> None:
    ours = server.ask("POST", "/api/drones/77/arm", None, {"Origin": f"http://{server.host}"}, token=COMMAND)
    assert ours.status == 404
    for origin in ("null", f"http://127.0.0.1:{server.port + 1}", "file://", f"http://{server.host}.evil.example", ""):
        assert server.ask("POST", "/api/drones/77/arm", None, {"Origin": origin}, token=COMMAND).status == 403, origin


def test_without_a_token_the_loopback_may_command(tmp_path: Path) -> None:
    with served(tmp_path, watch_token=WATCH) as server:
        told = server.ask("GET", "/api/session").json
        assert told["role"] == "command"
        assert told["watch_link"] == f"/?token={WATCH}"
        watching = server.ask("GET", "/api/session", token=WATCH).json
        assert (watching["role"], watching["watch_link"]) == ("watch", "")
        assert server.ask("POST", "/api/drones/77/arm", token=WATCH).status == 403
        assert server.ask("POST", "/api/drones/77/arm").status == 404


def test_a_web_socket_for_another_host_is_not_opened(server: Served) -> None:
    asked = f"GET /api/telemetry?token={COMMAND} HTTP/1.1\r\nHost: evil.example:{server.port}\r\n"
    asked += "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
    asked += "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
    with socket.create_connection(("127.0.0.1", server.port), PATIENCE_S) as raw:
        raw.sendall(asked.encode())
        assert raw.recv(64).startswith(b"HTTP/1.1 403 ")
    with socket.create_connection(("127.0.0.1", server.port), PATIENCE_S) as raw:
        raw.sendall(asked.replace("evil.example", "localhost").encode())
        assert raw.recv(64).startswith(b"HTTP/1.1 101 ")


def test_a_server_that_others_reach_lets_nobody_in_without_a_token(tmp_path: Path) -> None:
    with served(tmp_path, host="0.0.0.0", command_token=COMMAND, watch_token=WATCH) as server:
        assert server.ask("GET", "/api/session").status == 401
        assert server.ask("GET", "/api/session").headers["www-authenticate"] == "Bearer"
        assert server.ask("GET", "/api/session", token=COMMAND).json["role"] == "command"
        assert server.ask("GET", "/", token="").status != 401  # the page itself holds nothing
        assert server.ask("GET", "/api/session", None, {"Host": "evil.example"}, token=COMMAND).status == 421
        with pytest.raises(InvalidStatus), server.socket(""):
            pass


def test_a_server_for_others_without_a_token_is_not_made(tmp_path: Path) -> None:
    for host in ("0.0.0.0", "192.168.1.2", "lab.example", "::"):
        with pytest.raises(LinkError, match="needs a token"):
            LabSettings(tmp_path, host)
        assert COMMAND not in repr(LabSettings(tmp_path, host, command_token=COMMAND))
    for host in ("127.0.0.1", "localhost", "::1"):
        LabSettings(tmp_path, host)


def test_a_request_that_is_too_large_is_refused_in_words(server: Served) -> None:
    for headers in ({}, {"Transfer-Encoding": "chunked"}):
        body = b"x" * (1 << 20) + b"y"
        sent = b"100001\r\n" + body + b"\r\n0\r\n\r\n" if headers else body
        answer = server.ask("PUT", "/api/drones/77/setpoint", sent, headers, token=COMMAND)
        assert answer.status == 413, answer.content[:200]
        assert "larger than 262144 bytes" in answer.json["what"]
    # Without a body: closed under bytes that nobody has read, the connection would be reset and the answer lost.
    assert server.ask("PUT", "/api/drones/77/setpoint", b"", {"Content-Length": "x"}, token=COMMAND).status == 400


@pytest.mark.parametrize(("token", "status"), [(WATCH, 403), ("not-a-token", 401)])
def test_who_still_sends_is_told_why_it_is_refused(server: Served, token: str, status: int) -> None:
    """Answered at once and closed, the connection would be reset under the rest of the request, and the answer lost."""
    body = b'{"mode": "hold"}'
    head = f"POST /api/drones/1/mode HTTP/1.1\r\nHost: {server.host}\r\nAuthorization: Bearer {token}\r\n"
    with socket.create_connection(("127.0.0.1", server.port), PATIENCE_S) as client:
        client.sendall(f"{head}Content-Type: application/json\r\nContent-Length: {len(body)}\r\n\r\n".encode())
        client.settimeout(0.5)
        with pytest.raises(TimeoutError):
            client.recv(1)
        client.settimeout(PATIENCE_S)
        client.sendall(body)
        told = b"".join(iter(lambda: client.recv(4096), b""))
    assert told.startswith(f"HTTP/1.1 {status} ".encode())
    assert b'"what"' in told


def test_every_answer_carries_the_headers_that_guard_the_page(server: Served) -> None:
    for path, token in (("/", ""), ("/api/session", COMMAND), ("/api/nothing", COMMAND), ("/api/session", "wrong")):
        headers = server.ask("GET", path, token=token).headers
        policy = headers["content-security-policy"]
        assert "default-src 'self'" in policy
        assert "'wasm-unsafe-eval'" in policy
        assert "'unsafe-eval'" not in policy
        assert not re.search(r"https?:|\*", policy)  # nothing from elsewhere
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"
        assert "server" not in headers
    assert server.ask("GET", "/api/session", token=COMMAND).headers["cache-control"] == "no-store"


@pytest.mark.parametrize(
    ("token", "headers"),
    [
        ("wrong", {}),
        (COMMAND, {"Origin": "http://evil.example"}),
        (COMMAND, {"Origin": "https://127.0.0.1"}),
        (WATCH, {"Origin": "null"}),
    ],
)
def test_a_web_socket_of_somebody_else_is_not_opened(server: Served, token: str, headers: dict[str, str]) -> None:
    with pytest.raises(InvalidStatus) as refused, server.socket(token, additional_headers=headers):
        pass
    assert refused.value.response.status_code == 403


@pytest.mark.parametrize("token", [COMMAND, WATCH])
def test_a_socket_of_our_page_has_its_role(server: Served, token: str) -> None:
    with server.socket(token, origin=f"http://{server.host}") as client:
        assert client.event("session")["role"] == token.split("-")[0]


MALFORMED = [
    "",
    "no JSON",
    "[]",
    "null",
    "1e999",
    '{"do":"fly"}',
    '{"do":"subscribe"}',
    '{"do":"unsubscribe","id":-1}',
    '{"do":"unsubscribe","id":65536}',
    '{"do":"unsubscribe","id":1,"more":2}',
    '{"do":"subscribe","id":1,"drone":1,"columns":[],"rate":250}',
    '{"do":"subscribe","id":1,"drone":1,"columns":["estimate.theta"],"rate":0}',
    '{"do":"subscribe","id":1,"drone":1,"columns":["estimate.theta"],"rate":NaN}',
    '{"do":"subscribe","id":1,"drone":1,"columns":["estimate.theta"],"rate":1e999}',
    '{"do":"subscribe","id":1,"drone":1e99,"columns":["estimate.theta"]}',
    '{"do":"subscribe","id":1,"drone":1,"columns":' + '["x"' + ',"x"' * 64 + "]}",
    "[" * 8000,
    '{"do":"unsubscribe","id":1' + " " * 8192 + "}",
    b"\x00\x01",
]


@pytest.mark.parametrize("message", MALFORMED, ids=lambda one: str(one)[:40])
def test_a_malformed_message_closes_its_own_socket_only(server: Served, message: str | bytes) -> None:
    with server.socket(WATCH) as other, server.socket(WATCH) as client:
        client.websocket.send(message)
        code, reason = client.closed()
        assert code == 1007
        assert reason
        other.send(do="unsubscribe", id=1)
        other.event("session")


def test_a_huge_message_is_not_taken_in(server: Served) -> None:
    with server.socket(WATCH) as client:
        with suppress(ConnectionClosed):
            client.websocket.send("x" * 2_000_000)
        assert client.closed()[0] in (1006, 1009)
    assert server.ask("GET", "/api/session", token=WATCH).status == 200


def test_what_is_well_formed_and_cannot_be_is_refused_in_words(server: Served) -> None:
    with server.socket(WATCH) as client:
        client.subscribe(["estimate.theta"], drone=77)
        refused = client.event("refused")
        assert (refused["id"], refused["where"]) == (1, "drone 77")
        client.subscribe(["estimate.thta"], number=2)
        refused = client.event("refused")
        assert refused["id"] == 2
        assert "estimate.theta" in refused["remedy"]


def test_a_page_is_served_once_it_is_built(tmp_path: Path) -> None:
    page = tmp_path / "page"
    with served(tmp_path, page=page) as server:
        missing = server.ask("GET", "/")
        assert missing.status == 503
        assert b"make web" in missing.content
        assert server.ask("GET", "/assets/x.js").status == 404
        (page / "assets").mkdir(parents=True)
        (page / "index.html").write_text("<!doctype html><title>built</title>")
        (page / "assets" / "x-abc.js").write_text("1")
        (tmp_path / "secret").write_text("x")
        built = server.ask("GET", "/?token=abc")
        assert (built.status, built.headers["cache-control"]) == (200, "no-cache")
        assert b"built" in built.content
        assert "immutable" in server.ask("GET", "/assets/x-abc.js").headers["cache-control"]
        for outside in ("/../secret", "/%2e%2e/secret", "/assets/..%2f..%2fsecret", "//secret"):
            assert server.ask("GET", outside).status == 404, outside
        assert server.ask("GET", "/api/nothing").json["what"] == "there is no such page or route"
        for path, allowed in (("/", "GET, HEAD"), ("/api/drones", "GET"), ("/api/models/some", "DELETE, GET, PUT")):
            for method in ("TRACE", "PATCH"):
                got = server.ask(method, path)
                assert (got.status, got.headers.get("allow")) == (405, allowed), (method, path)
        assert server.ask("TRACE", "/api/nothing").status == 404
