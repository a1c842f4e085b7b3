"""The page is served as it was built; where it was not, the link says how to."""

from __future__ import annotations

from pathlib import Path

from tests.lab.served import served


def test_a_page_that_is_not_built_says_how_and_is_there_once_it_is(tmp_path: Path) -> None:
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
