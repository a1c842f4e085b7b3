"""Requests drawn from the API's own description, right and wrong ones, to a server with a virtual drone."""

from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from tests.gcs.virtual import on_board
from tests.lab.served import Served, served, wait_for_drone
from tests.patience import PATIENCE_S
from twodof.lab.access import lab_routes
from twodof.lab.server import ROUTERS
from twodof.lab.telemetry_client import MalformedRequest, Subscribe, Unsubscribe, read_request

pytestmark = pytest.mark.slow

QUICK, LONG = 4, 100
"""Requests of each kind, right ones and wrong ones, for each route."""
ROUTES = [(method, route.path) for route in lab_routes(ROUTERS) for method in sorted(route.methods)]
# What is malformed is drawn too: it is to be refused, not to be believed.
MODES = [schemathesis.GenerationMode.POSITIVE, schemathesis.GenerationMode.NEGATIVE]


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """A server with a drone, and a folder of its own to fill."""
    folder = tmp_path_factory.mktemp("lab")
    with on_board(conditions={"rings": True}) as there, served(folder, there.url) as found:
        wait_for_drone(found)
        yield found


@pytest.fixture(scope="module")
def schema(server: Served) -> Any:
    """Description of the API by the server."""
    return schemathesis.openapi.from_url(f"http://{server.host}/api/openapi.json")


def modes(schema: Any, method: str, path: str) -> list[Any]:
    """Requests as they should be; and, where anything about them can be wrong, such as they should not."""
    told = schema.raw_schema["paths"][path][method.lower()]
    return MODES if told.get("parameters") or told.get("requestBody") else MODES[:1]


def ask(operation: Any, mode: Any, examples: int) -> None:
    """Send `examples` requests of one kind to one route; none may end in an error of the server."""

    told = operation.definition.raw["responses"]

    @settings(
        max_examples=examples,
        deadline=None,
        database=None,
        derandomize=examples == QUICK,
        phases=[Phase.generate],
        suppress_health_check=[*HealthCheck],
    )
    @given(case=operation.as_strategy(generation_mode=mode))
    def run(case: Any) -> None:
        if mode is MODES[0] and "number" in (case.path_parameters or {}):
            case.path_parameters["number"] = 1  # the drone that there is
        got = case.call(timeout=PATIENCE_S)
        assert got.status_code < 500, f"{case.as_curl_command()}\n{got.status_code}: {got.text[:500]}"
        assert str(got.status_code) in {*told, "405"}, f"{case.as_curl_command()}\n{got.status_code} is not described"
        if got.status_code >= 400:
            assert set(got.json()) == {"what", "where", "remedy"}, got.text[:500]
            assert got.json()["what"]

    run()


@pytest.mark.long
@pytest.mark.parametrize(("method", "path"), ROUTES, ids=lambda one: str(one))
def test_no_request_breaks_the_server(server: Served, schema: Any, method: str, path: str) -> None:
    for mode in modes(schema, method, path):
        ask(schema[path][method], mode, QUICK)
    assert server.ask("GET", "/api/session").status == 200


@pytest.mark.soak
@pytest.mark.parametrize(("method", "path"), ROUTES, ids=lambda one: str(one))
def test_no_request_of_very_many_breaks_the_server(server: Served, schema: Any, method: str, path: str) -> None:
    for mode in modes(schema, method, path):
        ask(schema[path][method], mode, LONG)


@pytest.mark.parametrize("body", [b"\xf4\x5a\x90\xf1", b"\xff\xfe{", b'"', b"["])
def test_a_body_that_cannot_be_decoded_is_refused_as_malformed(server: Served, body: bytes) -> None:
    answer = server.ask("PUT", "/api/drones/1/setpoint", body)
    assert answer.status == 422
    assert {"what", "where", "remedy"} == set(answer.json)
    assert answer.json["remedy"]


@pytest.mark.parametrize("value", [b"NaN", b"1e999", b"[" * 400 + b"]" * 400, rb'"\ud800"'])
def test_a_model_that_json_cannot_hold_is_refused(server: Served, value: bytes) -> None:
    answer = server.ask("PUT", "/api/models/odd", b'{"x": %b}' % value)
    assert (answer.status, answer.json["where"]) in ((422, "model odd"), (422, "/api/models/odd"))
    assert server.ask("GET", "/api/models/odd").status == 404


def test_all_names_may_have_80_letters(server: Served) -> None:
    snapshots = "/api/drones/1/parameters/snapshots"
    for count, status in ((80, 201), (81, 422)):
        name = "n" * count
        for answer in (server.ask("PUT", f"/api/models/{name}", {}), server.ask("POST", snapshots, {"name": name})):
            assert answer.status == status
            assert status == 201 or "at most 80" in answer.json["what"]
    assert server.ask("GET", f"{snapshots}/{'n' * 80}?other={'n' * 80}").status == 200


@pytest.mark.parametrize("value", [False, True, "0.1"])
@pytest.mark.parametrize(
    ("method", "path", "fine", "field"),
    [
        ("PUT", "drones/1/setpoint", {"loop": "theta", "value": 0.0, "thrust": 0.0}, "value"),
        ("PUT", "drones/1/setpoint", {"loop": "theta", "value": 0.0, "thrust": 0.0}, "thrust"),
        ("PUT", "drones/1/setpoint", {"loop": "v", "value": 0.0}, "acceleration"),
        ("POST", "drones/1/reset", {}, "x"),
        ("POST", "drones/1/reset", {}, "noise"),
        ("PATCH", "drones/1/parameters", {}, "ATT_KP"),
    ],
)
def test_a_number_of_a_command_is_a_number(
    server: Served, method: str, path: str, fine: dict[str, object], field: str, value: object
) -> None:
    answer = server.ask(method, f"/api/{path}", {**fine, field: value})
    assert answer.status == 422
    assert field in answer.json["where"]


def test_a_truth_value_of_a_command_is_one(server: Served) -> None:
    for value in (0, 1, "yes"):
        answer = server.ask("POST", "/api/drones/1/reset", {"rings": value})
        assert (answer.status, answer.json["where"]) == (422, "body.rings")


@pytest.mark.long
@settings(deadline=None)
@given(st.one_of(st.text(), st.recursive(st.none() | st.booleans() | st.floats() | st.text(), st.lists).map(repr)))
def test_a_socket_message_is_a_request_or_refused(text: str) -> None:
    with suppress(MalformedRequest):  # and nothing else
        assert isinstance(read_request(text), Subscribe | Unsubscribe)
