"""The routes of logs: what was flown is told, hostile names and files change nothing, deleting can be undone."""

import base64
import errno
import io
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote
from zipfile import ZipFile

import numpy as np
import pytest

from tests.flightlog.synthetic import attitude_steps
from tests.lab.served import COMMAND, WATCH, Served, served
from tests.patience import patiently
from twodof.flightlog.files import read_log, write_log
from twodof.flightlog.log import Channel, FlightLog
from twodof.flightlog.provenance import MAX_FILE_BYTES
from twodof.lab import folders
from twodof.lab.folders import KEPT_DAYS
from twodof.lab.routes import logs as log_routes
from twodof.lab.routes.logs import MOST_UPLOADED
from twodof.report.step_responses import step_responses

pytestmark = pytest.mark.slow


def noted(log: FlightLog, **told: object) -> FlightLog:
    return FlightLog(log.channels, {**log.provenance, **told})


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    folder, other = tmp_path_factory.mktemp("data"), tmp_path_factory.mktemp("other")
    (folder / "flights").mkdir()
    told = {
        "experiment": "attitude-steps",
        "rig": "lab",
        "flown": {"virtual": True, "controller": "stock", "reason": ""},
        "texts": [[1.5, "warning", "the battery is low"], ["nonsense"], [1, 2, 3]],
        "changes": [[2.0, "K_P", 3.5], [2.0, "K_P"]],
        "parameters": {"K_P": 3.0, "NOTE": "text"},
    }
    write_log(noted(attitude_steps(), **told), folder / "flights" / "a.mcap")
    write_log(attitude_steps(), folder / "flights" / "b.mat")
    write_log(attitude_steps(), other / "theirs.parquet")
    (folder / "flights" / "damaged.ulg").write_bytes(b"ULog\x01\x12\x35" + bytes(100))
    (folder / "secret.mat").write_bytes(b"not to be read")
    (folder / "flights" / ".hidden.mat").write_bytes(b"neither")
    with served(folder, token=COMMAND, command_token=COMMAND, watch_token=WATCH, logs=(other,)) as there:
        yield there


def unpacked(text: str, kind: str) -> np.ndarray[Any, Any]:
    return np.frombuffer(base64.b64decode(text), kind)


def names(server: Served) -> list[str]:
    return [row["name"] for row in server.ask("GET", "/api/logs").json["logs"]]


def files(server: Served) -> set[str]:
    return {path.name for path in (server.folder / "flights").iterdir() if not path.name.startswith(".")}


def nothing_is_left_over(server: Served) -> None:
    """Files on their way in or out are gone once the answer is."""
    for _ in patiently():
        if not any((server.folder / "flights").glob(".scratch/*")):
            return


def test_the_list_and_what_a_log_tells(server: Served) -> None:
    assert set(names(server)) == {"a.mcap", "b.mat", "damaged.ulg", "1:theirs.parquet"}
    assert str(server.folder.parent) not in server.ask("GET", "/api/logs").content.decode()
    found = server.ask("GET", "/api/logs/a.mcap").json
    log = attitude_steps()
    assert found["span"] == list(log.span)
    assert (found["experiment"], found["rig"], found["controller"], found["virtual"]) == (
        "attitude-steps",
        "lab",
        "stock",
        True,
    )
    assert found["texts"] == [[1.5, "warning", "the battery is low"]]
    assert found["changes"] == [[2.0, "K_P", 3.5]]
    assert found["parameters"] == [["K_P", 3.0]]
    spark = server.ask("GET", "/api/logs/a.mcap/summary").json["spark"]
    assert spark["channel"] == "theta"
    theta = log["theta"].value
    known = [value for value in spark["high"] if value is not None]
    assert (max(known), min(value for value in spark["low"] if value is not None)) == (theta.max(), theta.min())


def test_a_view_keeps_every_extreme_however_few_points(server: Served) -> None:
    """Ten points of thousands: the largest sample of the window is one of them, to the bit of a float32."""
    log = attitude_steps()
    start, end = log.span
    middle = 0.5 * (start + end)
    for window, query in (((start, end), ""), ((start, middle), f"&begin={start}&end={middle}")):
        found = server.ask("GET", f"/api/logs/a.mcap/view?points=10{query}").json
        curves = {curve["channel"]: curve for view in found["views"] for curve in view["curves"]}
        value, time = unpacked(curves["theta"]["value"], "<f4"), unpacked(curves["theta"]["time"], "<f8")
        whole = np.degrees(log["theta"].slice(*window).value).astype(np.float32)
        assert len(value) <= 14
        assert (np.nanmax(value), np.nanmin(value)) == (whole.max(), whole.min())
        assert (np.diff(time) > 0.0).all()


def test_steps_and_a_comparison_are_the_librarys(server: Served) -> None:
    expected = [step.to_json() for step in step_responses(attitude_steps())]
    assert expected
    assert server.ask("GET", "/api/logs/a.mcap/steps").json == {"steps": expected, "unclear": ""}
    found = server.ask("GET", "/api/logs/compare?name=a.mcap&name=b.mat").json
    assert found["steps"] == {"a.mcap": expected, "b.mat": expected}
    assert found["zero"] == dict.fromkeys(("a.mcap", "b.mat"), expected[0]["time"])
    labels = {curve["label"] for view in found["views"] for curve in view["curves"]}
    assert {"a.mcap", "b.mat"} <= labels
    assert found["unaligned"] == ""
    whole = attitude_steps()
    before = {key: one.slice(whole.span[0], expected[0]["time"] - 0.1) for key, one in whole.channels.items()}
    write_log(FlightLog(before, {}), server.folder / "flights" / "still.mat")
    apart = server.ask("GET", "/api/logs/compare?name=a.mcap&name=still.mat").json
    assert apart["unaligned"] == "no set-point steps in this flight (still.mat)"
    assert {"a.mcap", "still.mat"} <= {curve["label"] for view in apart["views"] for curve in view["curves"]}
    assert server.ask("DELETE", "/api/logs/still.mat").status == 200
    assert server.ask("GET", "/api/logs/compare?name=a.mcap&name=a.mcap").status == 422
    assert server.ask("GET", "/api/logs/compare?name=a.mcap&name=nowhere.mat").status == 404
    assert server.ask("GET", "/api/logs/compare?name=a.mcap").status == 422


def test_own_plots_fold_and_alignment_are_the_librarys(server: Served) -> None:
    log = attitude_steps()
    rows = server.ask("GET", "/api/logs/a.mcap/signals").json
    assert ["theta", "estimated pitch", "deg"] in rows
    panels = "".join(f"&panel={quote(text)}" for text in ("theta\nM", "q", "none"))
    found = server.ask("GET", f"/api/logs/a.mcap/view?points=4000{panels}").json["views"]
    assert [view["label"] for view in found][:3] == ["theta, M", "q [deg/s]", ""]
    assert [curve["label"] for curve in found[0]["curves"]] == ["theta [deg]", "M [–]"]
    shown = unpacked(found[1]["curves"][0]["value"], "<f4")
    assert np.degrees(log["q"].value).max() == pytest.approx(shown.max(), rel=1e-6)
    many = server.ask("GET", f"/api/logs/a.mcap/view?panel={quote(chr(10).join(900 * ['q']))}").json["views"]
    assert len(many[0]["curves"]) == 20
    steps = step_responses(log)
    (fold,) = server.ask("GET", "/api/logs/a.mcap/fold").json
    assert fold["statistics"]["overshoot [%]"][0] == len(steps)
    np.testing.assert_allclose(fold["mean"], np.mean(fold["shares"], axis=0))
    later = steps[1].time
    asked = f"/api/logs/compare?name=a.mcap&name=b.mat&zero={later}&zero={steps[0].time}"
    told = server.ask("GET", asked).json
    assert told["zero"] == {"a.mcap": later, "b.mat": steps[0].time}
    assert told["window"][1] == pytest.approx(steps[-1].time - steps[0].time + 3.0)
    assert server.ask("GET", f"{asked}&align=start&zero=nan").status == 422


def test_a_renamed_log_keeps_notes_and_format(server: Served, tmp_path: Path) -> None:
    write_log(attitude_steps(), tmp_path / "x.mat")
    name = server.ask("POST", "/api/logs/x.mat", (tmp_path / "x.mat").read_bytes()).json["name"]
    assert server.ask("PUT", f"/api/logs/{name}/notes", {"text": "gusts"}).status == 200
    assert server.ask("POST", f"/api/logs/{name}/rename?to=best").json == {"name": "best.mat"}
    assert server.ask("GET", "/api/logs/best.mat").json["notes"] == "gusts"
    assert server.ask("POST", "/api/logs/best.mat/rename?to=b").json == {"name": "b-2.mat"}, "b.mat stays"
    for to in ("..%2Fsecret", ".hidden", "a" * 130):
        assert server.ask("POST", f"/api/logs/b-2.mat/rename?to={to}").status in (409, 422), to
    assert server.ask("POST", "/api/logs/1%3Atheirs.parquet/rename?to=mine").status == 409
    assert server.ask("POST", "/api/logs/b-2.mat/rename?to=c", token=WATCH).status == 403
    assert server.ask("DELETE", "/api/logs/b-2.mat").status == 200


def test_a_replay_holds_the_samples(server: Served) -> None:
    found = server.ask("GET", "/api/logs/a.mcap/replay").json
    log = attitude_steps()
    times = found["start"] + np.arange(found["count"]) / found["rate"]
    theta = unpacked(found["columns"]["theta"], "<f4")
    known = np.isfinite(theta)
    np.testing.assert_array_equal(theta[known], log.resample("theta", times[known]).astype("<f4"))
    assert known.mean() > 0.9


@pytest.mark.parametrize("form", ["mcap", "mat", "parquet", "csv", "ulg"])
def test_a_download_in_any_format_is_the_same_flight(server: Served, form: str, tmp_path: Path) -> None:
    got = server.ask("GET", f"/api/logs/a.mcap/file?form={form}")
    assert got.status == 200
    assert f'filename="a.{form}"' in got.headers["content-disposition"]
    path = tmp_path / f"got.{form}"
    path.write_bytes(got.content)
    log, kept = attitude_steps(), read_log(path)
    for name in ("theta", "q", "theta0", "M", "T"):
        # ULog counts microseconds; a value goes through unchanged.
        np.testing.assert_allclose(kept[name].time, log[name].time, rtol=0.0, atol=0.5e-6 if form == "ulg" else 0.0)
        np.testing.assert_array_equal(kept[name].value, log[name].value)
    nothing_is_left_over(server)


@pytest.mark.parametrize(
    "name",
    [
        *("../secret.mat", "..%2fsecret.mat", "%2e%2e/secret.mat", "..\\secret.mat", "/etc/passwd", ".hidden.mat"),
        *("1:../secret.mat", "2:theirs.parquet", "-1:a.mcap", "9999999999:a.mcap", "a.mcap/..", "a.mcap%00.mat"),
        *(
            "%ff.mat",
            "nowhere.mat",
            "a" * 300 + ".mat",
            "con:a.mcap",
            "٣:theirs.parquet",
            "a.mcap\u202e.mat",
            ".",
            "..",
            "~",
        ),
    ],
)
def test_a_hostile_name_finds_nothing(server: Served, name: str) -> None:
    before = files(server)
    path = name if "%" in name else quote(name, safe="")
    for method, end in (("GET", ""), ("GET", "/file"), ("GET", "/view"), ("DELETE", ""), ("PUT", "/notes")):
        got = server.ask(method, f"/api/logs/{path}{end}", {"text": "x"} if method == "PUT" else None)
        assert got.status in (404, 405, 422), (method, got)
        assert b"not to be read" not in got.content
    assert server.ask("POST", f"/api/logs/{path}", b"x" * 10).status in (404, 405, 422)
    assert server.ask("POST", f"/api/logs/trash/{path}/restore").status in (404, 405, 422)
    assert files(server) == before
    assert (server.folder / "secret.mat").read_bytes() == b"not to be read"


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("empty.mat", b""),
        ("noise.mcap", os.urandom(5000)),
        ("noise.parquet", b"PAR1" + bytes(200) + b"PAR1"),
        ("text.csv", b"a,b\n1,2\n"),
        ("cut.ulg", b"ULog\x01\x12\x35"),
        ("page.mat", b"<script>alert(1)</script>" * 100),
    ],
)
def test_a_file_without_a_log_is_refused(server: Served, name: str, content: bytes) -> None:
    before = files(server)
    got = server.ask("POST", f"/api/logs/{name}", content)
    assert got.status == 422
    assert got.json["what"]
    assert str(server.folder) not in got.content.decode()
    assert files(server) == before
    nothing_is_left_over(server)


@pytest.mark.long
def test_a_huge_file_is_refused(server: Served) -> None:
    assert MOST_UPLOADED < MAX_FILE_BYTES
    got = server.ask("POST", "/api/logs/big.mat", None, {"Content-Length": str(MOST_UPLOADED + 1)})
    assert (got.status, str(MOST_UPLOADED) in got.json["what"]) == (413, True)
    assert "big.mat" not in names(server)


def test_an_uploaded_log_never_replaces_another(server: Served, tmp_path: Path) -> None:
    write_log(attitude_steps(), tmp_path / "x.mat")
    content = (tmp_path / "x.mat").read_bytes()
    first, second = (server.ask("POST", "/api/logs/dropped.mat", content) for _ in range(2))
    assert (first.status, first.json["name"], second.json["name"]) == (200, "dropped.mat", "dropped-2.mat")
    assert first.json["summary"]["span"] == list(attitude_steps().span)
    assert server.ask("GET", "/api/logs/dropped.mat/file").content == content
    for name in ("dropped.mat", "dropped-2.mat"):
        assert server.ask("DELETE", f"/api/logs/{name}").status == 200


def test_a_full_disk_is_said_without_folders(server: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_log(attitude_steps(), tmp_path / "x.mat")
    server.ask("POST", "/api/logs/full.mat", (tmp_path / "x.mat").read_bytes())

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr("twodof.flightlog.atomic.os.fsync", full)
        answer = server.ask("PUT", "/api/logs/full.mat/notes", {"text": "x"})
    assert answer.status == 507
    assert "No space left" in answer.json["what"]
    assert "/" not in answer.json["where"]


def test_deleting_is_undone_with_the_notes_and_ends_after_its_days(
    server: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_log(attitude_steps(), tmp_path / "x.mat")
    content = (tmp_path / "x.mat").read_bytes()
    server.ask("POST", "/api/logs/gone.mat", content)
    text = "Gusts from the window.\n"
    assert server.ask("PUT", "/api/logs/gone.mat/notes", {"text": text}).json == {"text": text}
    gone = server.ask("DELETE", "/api/logs/gone.mat").json
    assert "gone.mat" not in names(server)
    listed = server.ask("GET", "/api/logs").json
    assert (gone["entry"] in [row["entry"] for row in listed["trash"]], listed["kept_days"]) == (True, KEPT_DAYS)
    assert server.ask("POST", f"/api/logs/trash/{gone['entry']}/restore").json == {"name": "gone.mat"}
    assert server.ask("GET", "/api/logs/gone.mat").json["notes"] == text
    assert server.ask("GET", "/api/logs/gone.mat/file").content == content, "notes are never inside a log"
    entry = server.ask("DELETE", "/api/logs/gone.mat").json["entry"]
    now = folders.time.time()
    monkeypatch.setattr(folders.time, "time", lambda: now + KEPT_DAYS * 86_400.0 + 10.0)
    assert server.ask("GET", "/api/logs").json["trash"] == []
    monkeypatch.undo()
    assert server.ask("POST", f"/api/logs/trash/{entry}/restore").status == 404
    assert not list((server.folder / "flights" / ".trash").iterdir())


def test_a_file_that_vanishes_stops_no_transfer(server: Served) -> None:
    vanished = server.folder / "flights" / ".scratch" / "vanished.csv"
    vanished.parent.mkdir(exist_ok=True)
    vanished.symlink_to("nowhere")
    assert server.ask("GET", "/api/logs/a.mcap/file?form=csv").status == 200
    vanished.unlink()


def test_long_names_are_left_out_or_refused(server: Served) -> None:
    paths = [server.folder / "flights" / name for name in (f"{'é' * 122}.csv", f"{'k' * 236}.csv")]
    for path in paths:
        path.write_text("time,q\n")
    assert [names(server).count(path.name) for path in paths] == [0, 1]
    refusal = server.ask("DELETE", f"/api/logs/{paths[1].name}")
    assert (refusal.status, refusal.json["what"]) == (422, "cannot be moved: File name too long")
    for path in paths:
        path.unlink()


def test_another_folder_is_only_read_and_a_watcher_changes_nothing(server: Served) -> None:
    assert server.ask("GET", "/api/logs/1%3Atheirs.parquet").json["ours"] is False
    assert server.ask("DELETE", "/api/logs/1%3Atheirs.parquet").status == 409
    assert server.ask("PUT", "/api/logs/1%3Atheirs.parquet/notes", {"text": "x"}).status == 409
    for method, path in (
        ("DELETE", "/api/logs/a.mcap"),
        ("PUT", "/api/logs/a.mcap/notes"),
        ("POST", "/api/logs/new.mat"),
        ("POST", "/api/logs/trash/x/restore"),
    ):
        assert server.ask(method, path, {"text": ""}, token=WATCH).status == 403
    assert server.ask("GET", "/api/logs/a.mcap/view", token=WATCH).status == 200


def test_what_cannot_be_read_says_so_and_harms_no_other(server: Served) -> None:
    """As data where a list or a page asks by itself; nothing names the server's folders."""
    for path in ("damaged.ulg", "damaged.ulg/summary"):
        got = server.ask("GET", f"/api/logs/{path}")
        assert (got.status, "span" in got.json) == (200, False)
        assert "twodof log recover damaged.ulg" in got.json["unreadable"]
        assert str(server.folder) not in got.content.decode()
    # What can be had of it is the file as it is.
    assert server.ask("GET", "/api/logs/damaged.ulg").json["formats"] == ["ulg"]
    assert server.ask("GET", "/api/logs/damaged.ulg/file?form=ulg").status == 200
    assert server.ask("GET", "/api/logs/damaged.ulg/file?form=mat").status == 422
    assert server.ask("GET", "/api/logs/a.mcap").json["formats"] == ["mcap", "mat", "parquet", "csv", "ulg"]
    refused = server.ask("GET", "/api/logs/damaged.ulg/view")
    assert (refused.status, str(server.folder) in refused.content.decode()) == (422, False)
    gone = server.ask("GET", "/api/logs/deleted-meanwhile.mcap/summary")
    assert (gone.status, gone.json) == (200, {"unreadable": "there is no such log: choose one of the list"})
    for path in ("a.mcap", "a.mcap/summary"):
        got = server.ask("GET", f"/api/logs/{path}")
        assert (got.status, got.json["unreadable"]) == (200, "")
    for query in ("begin=1", "begin=nan&end=2", "begin=5&end=1", "begin=1e9&end=2e9", "topic=none"):
        assert server.ask("GET", f"/api/logs/a.mcap/view?{query}").status == 422


def test_a_cut_recording_is_recovered_as_a_new_log(server: Served) -> None:
    whole = next(server.folder.glob("flights/*.mcap")).read_bytes()
    cut = server.folder / "flights" / "cut.mcap"
    cut.write_bytes(whole[:-100])
    assert server.ask("GET", "/api/logs/cut.mcap").json["unreadable"]
    told = server.ask("POST", "/api/logs/cut.mcap/recover").json
    assert told.get("name") == "cut.recovered.mcap", told
    assert told["samples"] > 100
    assert told["what"]
    assert server.ask("GET", f"/api/logs/{told['name']}").json["unreadable"] == ""
    sent = server.ask("POST", "/api/logs/sent.mcap", cut.read_bytes())  # taken, since something of it can be read
    assert (sent.status, sent.json["name"], bool(sent.json["summary"]["unreadable"])) == (200, "sent.mcap", True)
    assert server.ask("DELETE", "/api/logs/sent.mcap").status == 200
    cut.write_bytes(b"nothing")
    assert server.ask("POST", "/api/logs/cut.mcap/recover").status == 422
    (server.folder / "flights" / told["name"]).unlink()
    cut.unlink()


def test_a_log_of_others_is_shown_too(server: Served) -> None:
    """No channel of ours in it: the first ones that it has."""
    time = np.arange(1000) * 0.01
    with tempfile.TemporaryDirectory() as folder:
        write_log(FlightLog({"temperature": Channel(time, np.sin(time), "K")}), Path(folder) / "t.parquet")
        content = (Path(folder) / "t.parquet").read_bytes()
    name = server.ask("POST", "/api/logs/temperature.parquet", content).json["name"]
    found = server.ask("GET", f"/api/logs/{name}/view").json
    assert [view["label"] for view in found["views"]] == ["temperature [K]"]
    assert server.ask("GET", f"/api/logs/{name}/steps").json["unclear"]
    assert server.ask("DELETE", f"/api/logs/{name}").status == 200


def test_a_zip_file_has_the_logs_as_they_are(server: Served) -> None:
    got = server.ask("GET", "/api/logs/zip?name=a.mcap&name=b.mat&name=1:theirs.parquet")
    assert got.headers["content-type"] == "application/zip"
    with ZipFile(io.BytesIO(got.content)) as archive:
        assert archive.namelist() == ["a.mcap", "b.mat", "1/theirs.parquet"]
        for name in ("a.mcap", "b.mat"):
            assert archive.read(name) == (server.folder / "flights" / name).read_bytes()
    for query, status in (("name=../secret.mat", 404), ("", 422), ("&".join(["name=a.mcap"] * 51), 422)):
        assert server.ask("GET", f"/api/logs/zip?{query}").status == status


def test_too_many_bytes_for_a_zip_file_are_refused(server: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log_routes, "MOST_ZIP_BYTES", 1000)
    got = server.ask("GET", "/api/logs/zip?name=a.mcap")
    assert (got.status, got.json["remedy"]) == (409, "choose fewer at once")


def test_compared_flights_are_named_by_what_differs(server: Served) -> None:
    folder = server.folder / "flights"
    same = {"parameters": {"RATE_KP": 0.0854, "ATT_KP": 5.0, "M_MAX": 0.2}, "flown": {"controller": "stock"}}
    other = {"parameters": {"RATE_KP": 0.1, "ATT_KP": 5.0, "M_MAX": 0.2}, "flown": {"controller": "stock"}}
    own = {**same, "flown": {"controller": "lqr"}}
    for name, told in {"same": same, "other": other, "own": own}.items():
        write_log(noted(attitude_steps(), **told), folder / f"{name}.mcap")
    late = {"changes": [[2.0, "RATE_KP", 0.1]], "recorded": {"began": "2026-03-01T10:00:00+01:00"}}
    write_log(noted(attitude_steps(), **same, **late), folder / "changed.mcap")

    def called(*names: str) -> dict[str, str]:
        query = "&".join(f"name={name}.mcap" for name in names)
        found = server.ask("GET", f"/api/logs/compare?{query}").json
        assert {*found["names"].values()} <= {one["label"] for view in found["views"] for one in view["curves"]}
        return {name.removesuffix(".mcap"): said for name, said in found["names"].items()}

    assert called("same", "other") == {"same": "RATE_KP 0.0854", "other": "RATE_KP 0.1"}
    assert called("same", "own") == {"same": "stock controller", "own": "lqr controller"}
    assert called("same", "other", "changed") == {
        "same": "RATE_KP 0.0854",
        "other": "RATE_KP 0.1, other.mcap",
        "changed": "RATE_KP 0.1, 2026-03-01T10:00:00",
    }
    for name in ("same", "other", "own", "changed"):
        (folder / f"{name}.mcap").unlink()
