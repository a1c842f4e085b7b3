"""The file of the parameters: there and back, torn at every byte, damaged, on a disk that refuses or is silent."""

import json
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.patience import PATIENCE_S, patiently
from twodof.errors import ParameterError
from twodof.fcu.parameters import parameter_store
from twodof.fcu.parameters.parameter_store import RETRY_S, ParameterStore, StoredParameters, text_of

VALUES = {"RATE_KP": 0.07, "SAFE_SP_T": 0.4, "COM_DL_LOSS_T": 20}


def written(folder: Path, values: Mapping[str, float] = VALUES) -> Path:
    path = folder / "parameters.json"
    with ParameterStore(path, values=values) as store:
        assert store.remarks == ()
    return path


def test_there_and_back(tmp_path: Path) -> None:
    path = written(tmp_path / "not" / "there" / "yet")
    with ParameterStore(path) as again:
        assert (again.changed(), again.remarks) == (VALUES, ())
        again.reset()
    with ParameterStore(path) as last:
        assert last.changed() == {}
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]


def test_a_file_that_was_cut_at_any_byte_gives_the_defaults_and_is_kept(tmp_path: Path) -> None:
    whole = written(tmp_path).read_bytes()
    for size in range(len(whole)):
        path = tmp_path / f"{size}" / "p.json"
        path.parent.mkdir()
        path.write_bytes(whole[:size])
        with ParameterStore(path) as store:
            assert store.changed() == {}, size
            assert "defaults" in store.remarks[0]
        assert path.with_name("p.json.damaged").read_bytes() == whole[:size]


def test_a_byte_that_changed_never_flies(tmp_path: Path) -> None:
    whole = written(tmp_path).read_bytes()
    path = tmp_path / "p.json"
    for at in range(len(whole)):
        for flip in (1, 0x10, 0xFF):
            path.write_bytes(whole[:at] + bytes((whole[at] ^ flip,)) + whole[at + 1 :])
            store = ParameterStore(path)
            # Of white space between the values it takes no notice.
            assert (store.changed() == {} and store.remarks) or store.changed() == VALUES, (at, flip)


@pytest.mark.parametrize(
    "content", [b"", b"[]", b"7", b"\xff\xfe", b"[" * 100_000, b'{"version": 1}', b"x" * (1 << 21)]
)
def test_rubbish_is_said_and_set_aside(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "p.json"
    path.write_bytes(content)
    with ParameterStore(path) as store:
        assert len(store.remarks) == 1
        store.update({"RATE_KP": 0.07})
    with ParameterStore(path) as again:
        assert again.changed() == {"RATE_KP": 0.07}


def test_values_that_are_wrong_by_now_are_left_out_one_by_one(tmp_path: Path) -> None:
    path = tmp_path / "p.json"
    path.write_text(text_of(StoredParameters({"RATE_KP": 0.07, "RATE_KI": 99.0, "GONE": 1.0, "COM_DL_LOSS_T": 5.5})))
    with ParameterStore(path) as store:
        assert store.changed() == {"RATE_KP": 0.07}
        assert sorted(remark.split(":")[0] for remark in store.remarks) == ["COM_DL_LOSS_T", "GONE", "RATE_KI"]


def test_many_changes_are_one_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writes: list[str] = []
    atomic = parameter_store.atomic_write

    @contextmanager
    def counted(path: Path, mode: Any) -> Iterator[Any]:
        with atomic(path, mode) as file:
            yield file
        writes.append(path.read_text())

    monkeypatch.setattr(parameter_store, "atomic_write", counted)
    monkeypatch.setattr(parameter_store, "GATHER_S", 60.0)
    with ParameterStore(tmp_path / "p.json") as store:
        for k in range(1, 101):
            store.update({"RATE_KP": k / 1000})
        store.flush()
        store.flush()
    assert [json.loads(text)["parameters"] for text in writes] == [{"RATE_KP": 0.1}]


def test_what_changes_while_the_file_is_written_is_waited_for_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, writes = threading.Event(), list[float]()
    atomic = parameter_store.atomic_write

    @contextmanager
    def slow(path: Path, mode: Any) -> Iterator[Any]:
        if not begun.is_set():
            begun.set()
            for _ in patiently():  # until somebody waits for the file
                if store._file is not None and store._file._at_once:
                    break
        else:
            time.sleep(0.05)  # in which one who waited for the writing before only would be gone
        with atomic(path, mode) as file:
            yield file
        writes.append(json.loads(path.read_text())["parameters"]["RATE_KP"])

    monkeypatch.setattr(parameter_store, "atomic_write", slow)
    monkeypatch.setattr(parameter_store, "GATHER_S", 0.0)
    store = ParameterStore(tmp_path / "p.json")
    store.update({"RATE_KP": 0.07})
    assert begun.wait(PATIENCE_S)
    store.update({"RATE_KP": 0.05})
    store.flush(PATIENCE_S)
    assert writes == [0.07, 0.05]
    store.close()


def test_a_disk_that_refuses_is_reported_and_stops_nothing(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    store = ParameterStore(tmp_path / "file" / "p.json")
    store.update({"RATE_KP": 0.07})
    with pytest.raises(ParameterError, match="not stored"):
        store.flush()
    assert store.failure is not None
    store.update({"RATE_KP": 0.05})
    assert store["RATE_KP"] == 0.05
    (tmp_path / "file").unlink()
    store.flush()
    store.update({"RATE_KP": 0.06})
    begun = time.monotonic()
    for _ in patiently():
        if "0.06" in (tmp_path / "file" / "p.json").read_text():
            break
    assert time.monotonic() - begun < RETRY_S, "what follows a success does not wait for another try"
    store.update({"RATE_KP": 0.05})
    store.close()
    assert store.failure is None
    with ParameterStore(tmp_path / "file" / "p.json") as again:
        assert again["RATE_KP"] == 0.05
