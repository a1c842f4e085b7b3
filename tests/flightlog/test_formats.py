"""Log files of every format: bit for bit there and back, tables of other programs, and the errors for wrong files."""

from collections.abc import Callable
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from mcap.writer import Writer
from scipy.io import loadmat, savemat

from tests.flightlog.synthetic import attitude_steps, channel, same_bits
from tests.flightlog.test_ulog_file import message, px4_log
from twodof.errors import LogError
from twodof.flightlog.files import convert, read_columns, read_log, write_log
from twodof.flightlog.log import Channel, FlightLog
from twodof.flightlog.mcap_encoder import MAGIC

pytestmark = pytest.mark.slow

PLAIN = st.from_regex(r"[A-Za-z][A-Za-z0-9_]{0,8}", fullmatch=True).map("a{}".format)
FORMS = [(".mat", False), (".mcap", False), (".parquet", False), (".csv", False), (".parquet", True), (".csv", True)]


@pytest.mark.parametrize(("suffix", "wide"), FORMS)
@settings(max_examples=25)
@given(data=st.data())
def test_any_log_round_trips(tmp_path_factory: pytest.TempPathFactory, suffix: str, wide: bool, data: Any) -> None:
    names = st.text(min_size=1, max_size=9) if suffix == ".mcap" else PLAIN
    units = st.just("") if suffix == ".mat" else st.sampled_from(["", "K", "N m", "rad/s²"])
    channels = {}
    for name, n in {"aq": 3, **data.draw(st.dictionaries(names, st.integers(0, 9), max_size=3))}.items():
        steps = data.draw(arrays(float, n, elements=st.floats(1e-6, 1e6)))
        width = data.draw(st.integers(1, 3))
        value = data.draw(arrays(float, (n, width), elements=st.floats(allow_nan=False, allow_infinity=False)))
        fields = data.draw(st.sampled_from([(), tuple(f"f{k}" for k in range(width))]))
        channels[name] = Channel(np.cumsum(steps), value, data.draw(units), fields)
    log = FlightLog(channels, {"seed": 1, "rig": "synthetic"})
    path = tmp_path_factory.getbasetemp() / f"any{suffix}"
    write_log(log, path, wide, overwrite=True)
    back = read_log(path)
    assert {key: back.provenance[key] for key in ("seed", "rig")} == log.provenance
    assert back.provenance["file"]["format"] == suffix[1:]
    if suffix == ".mat":  # MATLAB has no empty array of named columns
        filled = {name: one for name, one in log.channels.items() if len(one)}
        log, back = FlightLog(filled), FlightLog({name: back[name] for name in filled})
    same_bits(log, back)


@pytest.mark.parametrize(("suffix", "wide"), FORMS)
def test_flight_round_trips(tmp_path: Path, suffix: str, wide: bool) -> None:
    path, one = (
        tmp_path / f"a{suffix}",
        FlightLog({"acc": channel("acc", np.array([1.0]), np.array([[1.0, 2.0, 3.0]]))}),
    )
    for log in (attitude_steps(), one):
        write_log(log, path, wide, overwrite=True)
        same_bits(log, read_log(path))


@pytest.mark.long
def test_real_logs_survive_a_tour_of_all_formats(flight_data: Path, tmp_path: Path) -> None:
    paths = sorted(flight_data.glob("*.mat"))
    assert len(paths) == 7
    for path in paths:
        tour = [path, *(tmp_path / f"{path.stem}{suffix}" for suffix in (".mcap", ".parquet", ".csv", ".mat"))]
        for source, target in pairwise(tour):
            convert(source, target)
        first, last = read_log(path), read_log(tour[-1])
        same_bits(first, last)
        history = last.provenance["history"]
        assert [one["name"] for one in history] == [one.name for one in tour[:-1]]
        assert history[0]["sha256"] == first.provenance["file"]["sha256"]
        theirs, ours = loadmat(path, mat_dtype=True), loadmat(tour[-1], mat_dtype=True)
        names = [name for name in theirs if not name.startswith("__")]
        assert [name for name in ours if not name.startswith("__")] == [*names, "provenance"]
        for name in names:
            assert theirs[name].dtype == ours[name].dtype
            for part in theirs[name].dtype.names:
                before, after = theirs[name][0, 0][part], ours[name][0, 0][part]
                assert (before.dtype, before.shape) == (after.dtype, after.shape), (path.name, name, part)
                assert before.tobytes() == after.tobytes(), (path.name, name, part)


# Wrong files


def struct(n: int = 5, **parts: Any) -> dict[str, Any]:
    return {"timestamp": np.arange(n, dtype=float)[:, None], "value": np.zeros((n, 1)), **parts}


def mat(**content: Any) -> bytes:
    made = BytesIO()
    savemat(made, content)
    return made.getvalue()


def parquet(**columns: Any) -> bytes:
    made = BytesIO()
    pq.write_table(pa.table(columns), made)
    return made.getvalue()


def foreign_mcap() -> bytes:
    made = BytesIO()
    writer = Writer(made)
    writer.start()
    writer.add_message(writer.register_channel("/camera", "json", 0), 1, b"{}", 1)
    writer.finish()
    return made.getvalue()


def absurd_mat() -> bytes:
    content = mat(q=struct(value=np.arange(5, dtype=float)[:, None] + 0.5))
    dims = np.array([5, 1], dtype="<i4").tobytes()
    assert content.count(dims) == 2
    return content.replace(dims, np.array([2**31 - 1, 2**20], dtype="<i4").tobytes())


TIDY = "channel,field,time,value\n"
WRONG: list[tuple[str, bytes | str, str]] = [
    (".mat", b"", "the file is empty"),
    (".mat", b"PK\x03\x04" + bytes(500), "is not a MATLAB v5 file"),
    (".mat", b"MATLAB 7.3 MAT-file" + bytes(500), "v7.3 .HDF5. file .save it in MATLAB with save"),
    (".mat", b"\x89HDF\r\n\x1a\n" + bytes(500), "HDF5"),
    (".mat", bytes(124) + b"\x00\x02IM" + bytes(8), "cannot be read: MatReadError"),
    (".mat", bytes(124) + b"\x00\x01IM" + b"\x63\x00\x00\x00\x00\x00\x00\x00", "cannot be read: "),
    (".mat", absurd_mat(), "wrong.mat"),
    (".mat", mat(A=np.eye(3), name="x"), r"no struct \{timestamp, value\} in the file, which holds: A, name"),
    (".mat", mat(q=np.zeros(3)), "channel 'q' is not a struct"),
    (".mat", mat(q={"timestamp": np.arange(3.0)}), "channel 'q' is not a struct"),
    (".mat", mat(q=struct(value=np.zeros((4, 1)))), "4 samples for 5 time stamps"),
    (".mat", mat(q=struct(value=np.zeros((5, 2)))), "2 columns, 'q' has 1"),
    (".mat", mat(q=struct(value=np.full((5, 1), np.nan))), "value is nan at sample 0"),
    (".mat", mat(q=struct(timestamp=np.array([[0.0], [1], [1], [2], [3]]))), "time does not increase: sample 2"),
    (".mat", mat(q=struct(timestamp=np.ones((5, 2)))), "timestamp is .5, 2., not a column"),
    (".mat", mat(q=struct(value=np.ones((5, 1)) * 1j)), "channel 'q' is not a struct"),
    (".mat", mat(q=struct(value="text")), "channel 'q' is not a struct"),
    (".mat", mat(lmnf=struct()), "give columns called M, T, openloop"),
    (".mat", mat(q=struct(), provenance="no json"), "provenance kept in the file is not JSON"),
    (".mat", mat(q=struct(), provenance="[1]"), "not a table of entries"),
    (".mcap", b"", "the file is empty"),
    (".mcap", b"PK\3\4" + bytes(100), "is no MCAP file"),
    (".mcap", MAGIC, "was not closed"),
    (".mcap", MAGIC + b"\x06" + b"\xff" * 8, "promises 18446744073709551615 bytes"),
    (".mcap", foreign_mcap(), "no topic of a flight log is in it; topics: /camera"),
    (".mcap", foreign_mcap() + b"x", "goes on after its end"),
    (".parquet", parquet(time=[1.0], q=["x"]), "column 'q' holds something other than numbers: .*'x'"),
    (".parquet", parquet(time=[1.0], q=[[1.0]]), "column 'q' holds something other than numbers: .*list"),
    (
        ".parquet",
        parquet(channel=["gyr", None], field=["x", None], time=[0.0, 1.0], value=[1.0, 2.0]),
        "1 empty cells in column 'channel'",
    ),
    (".parquet", parquet(a=[1.0]), "no column 'time'"),
    (".csv", "", "the file is empty"),
    (".csv", "a,b\n1,2\n", "no column 'time' among: a, b"),
    (".csv", "time\n1\n", "the table has only the column of the time"),
    (".csv", "time,q\n1,x\n", "is not a table of numbers: .*'x'"),
    (".csv", "time,q\n1\n", "is not a table of numbers: .*Expected 2 columns, got 1"),
    (".csv", "time,q\n2,1\n1,1\n", "wrong.csv: q: time does not increase.*give two runs as two files"),
    (".csv", "time,mode,q\n0,AUTO,1\n1,AUTO,1.2.3\n", "invalid value '1.2.3'"),
    (".csv", "time;q\n0,0;1.234,5\n", "invalid value '1.234,5' .*without separators of thousands"),
    (".csv", "time;q\n0.5;1,5\n", "time stamps in column 'time' are '0.5'"),
    (
        ".csv",
        "time;q\n31.01.2026 12:00;1\n",
        "'31.01.2026 12:00' .write seconds with one decimal mark, or dates as 2026-01-31T",
    ),
    (".csv", "time [h],q\n0,1\n", "the time stamps are in 'h'"),
    (".csv", "0,1\n1,2\n", "write the names of the columns above the numbers"),
    (".csv", b"\xff\xfet", "not text in UTF-16"),
    (".csv", "time,q\n,1\n", "1 empty cells in column 'time'"),
    (".csv", "time,q\n0,1\nnan,2\n", "1 empty cells in column 'time'"),
    (".csv", "time,q,q\n1,1,1\n", "two columns have one name"),
    (".csv", "time,q [rad/s],q\n1,1,1\n", "two columns are called 'q'"),
    (".csv", TIDY + "gyr,x,0,1\ngyr,y,1,2\n", "the fields of 'gyr' differ in their time stamps"),
    (".csv", TIDY + "gyr,x,0,\n", "1 empty cells in column 'value'"),
    (".csv", TIDY + "lmnf,M,0,1\nlmnf,N,0,1\nlmnf,M,nan,2\nlmnf,N,nan,2\n", "lmnf: time is nan at sample 1"),
    (".csv", '# twodof.flightlog {"version": 2}\n' + TIDY + "q,,0,1\n", "layout version 2, not 1"),
    (".csv", "# twodof.flightlog {\n" + TIDY + "q,,0,1\n", "not JSON"),
    *(
        (
            ".csv",
            f'# twodof.flightlog {{"version": 1{rest}}}\n{TIDY}q,,0,1\n',
            "line of units and provenance is damaged",
        )
        for rest in ("", ', "channels": [{"name": "q"}], "provenance": {}', ', "channels": [], "provenance": 1')
    ),
    (".ulg", b"", "the file is empty"),
    (".ulg", b"ULog", "is not a ULog file"),
    (".ulg", px4_log(0)[:7] + b"\x09" + bytes(8), "has the ULog version 9"),
    (".ulg", px4_log(1) + bytes(50), "no message at byte"),
    (".ulg", px4_log(0), "no topic in it becomes a channel; topics: battery_status"),
    (".ulg", px4_log(1) + message("D", b"\x55\x55" + bytes(8)), "a message is not described"),
    (".ulg", px4_log(1) + message("D", b"\0\0" + bytes(8)), "is not as long as its description"),
    (".ulg", px4_log(0)[:59] + message("F", b"a:a x;") + message("A", b"\0\x77\0a"), "is nested too deep"),
    (".xlsx", b"x", r"no log format has the suffix '.xlsx' .use .mat, .mcap, .parquet, .csv"),
]


@pytest.mark.parametrize(("suffix", "content", "says"), WRONG, ids=[f"{row[0]} {row[2]}" for row in WRONG])
def test_wrong_file_is_refused_with_its_name(tmp_path: Path, suffix: str, content: bytes | str, says: str) -> None:
    path = tmp_path / f"wrong{suffix}"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(LogError, match=says) as caught:
        read_log(path)
    assert path.name in str(caught.value)


@pytest.mark.parametrize("suffix", [".mat", ".parquet", ".csv"])
def test_cut_file_is_refused(tmp_path: Path, suffix: str) -> None:
    write_log(attitude_steps().slice(100.0, 100.4), tmp_path / f"whole{suffix}")
    whole = (tmp_path / f"whole{suffix}").read_bytes()
    ends, at = {0}, 128
    while suffix == ".mat" and at < len(whole):  # a .mat file of fewer variables is a whole file
        ends.add(at := at + 8 + int.from_bytes(whole[at + 4 : at + 8], "little"))
    path = tmp_path / f"cut{suffix}"
    for size in {*np.linspace(1, len(whole) - 1, 120, dtype=int).tolist()} - ends:
        path.write_bytes(whole[:size])
        with pytest.raises(LogError, match="cut"):
            read_log(path)


def test_log_that_a_format_cannot_hold_is_refused(tmp_path: Path) -> None:
    one = Channel([0.0], [1.0])
    twins = FlightLog({"a.b": one, "a": Channel([0.0], [[1.0, 2.0]], "", ("b", "c"))})
    wrong: list[tuple[FlightLog, str, bool, str]] = [
        *((FlightLog({name: one}), ".mat", False, "cannot name a MATLAB") for name in ("2f", "a b", "provenance")),
        (FlightLog({"q": one}, {"rig": object()}), ".mat", False, "provenance is not JSON"),
        (FlightLog({'a"b': one}), ".csv", False, "a name cannot stand in CSV"),
        (FlightLog({"q": Channel([-1.0], [0.0])}), ".mcap", False, "MCAP counts nanoseconds from 0"),
        (FlightLog({"w": Channel([0.0], np.zeros((1, 1001)))}), ".mcap", False, "at most 1000"),
        (FlightLog({f"c{k}": Channel([], []) for k in range(1001)}), ".mcap", False, "at most 1000"),
        (twins, ".csv", True, r"two columns would be called 'a.b'"),
        (attitude_steps(), ".mcap", True, r"not tables \(write .parquet, .csv"),
        (attitude_steps(), ".txt", False, "no log format"),
    ]
    for log, suffix, wide, says in wrong:
        with pytest.raises(LogError, match=says):
            write_log(log, tmp_path / f"a{suffix}", wide)
    assert list(tmp_path.iterdir()) == []
    write_log(attitude_steps(), tmp_path / "a.csv")
    with pytest.raises(LogError, match="written over itself"):
        convert(tmp_path / "a.csv", tmp_path / "a.csv")


def test_file_too_large_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_log(attitude_steps(), tmp_path / "a.csv")
    monkeypatch.setattr("twodof.flightlog.provenance.MAX_FILE_BYTES", 1000)
    with pytest.raises(LogError, match="at most 1000 bytes are read"):
        read_log(tmp_path / "a.csv")


# Files of others


def test_matlab_integers_and_rows_are_read(tmp_path: Path) -> None:
    value = np.arange(5, dtype=np.uint8)[:, None]
    content = {"T": struct(value=value), "q": struct(value=np.ones((1, 5))), "A": np.eye(2), "odd": {"a": 1.0}}
    savemat(tmp_path / "a.mat", content)
    log = read_log(tmp_path / "a.mat")
    assert (log["T"].value.tolist(), log["T"].unit) == ([0, 1, 2, 3, 4], "-")
    assert (log["q"].value.tolist(), log["q"].unit) == ([1] * 5, "rad/s")
    assert log.provenance["ignored"] == ["A", "odd"]


def test_tidy_rows_in_any_order_take_units_from_topics(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    write_log(attitude_steps(), path)
    table = pq.read_table(path)
    pq.write_table(table.sort_by([("time", "ascending"), ("field", "descending")]), path)
    same_bits(attitude_steps(), read_log(path))
    (tmp_path / "a.csv").write_text(f"{TIDY}gyr,x,0,1\ngyr,y,0,2\ngyr,z,0,3\nq,,0.5,4\nmine,left,0,5\n")
    log = read_log(tmp_path / "a.csv")
    assert (log["gyr"].value.tolist(), log["gyr"].unit, log["gyr"].fields) == ([[1, 2, 3]], "rad/s", ("x", "y", "z"))
    assert (log["q"].value.tolist(), log["q"].unit, log["mine"].value.tolist()) == ([4], "rad/s", [5])


def test_wide_tables_of_others_are_read(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("# made by hand\ntime [s],theta,height [m]\n0,0.1,\n0.5,0.2,7\n1.0,0.3,8\n")
    log = read_log(tmp_path / "a.csv")
    assert (log["theta"].time.tolist(), log["theta"].unit) == ([0, 0.5, 1.0], "rad")
    assert (log["height"].time.tolist(), log["height"].value.tolist(), log["height"].unit) == ([0.5, 1.0], [7, 8], "m")
    (tmp_path / "a.parquet").write_bytes(parquet(time=[0, 1], q=pa.array([1.5, None], pa.float32())))
    log = read_log(tmp_path / "a.parquet")
    assert (log["q"].time.tolist(), log["q"].value.tolist()) == ([0], [1.5])


TABLES = {
    "semicolons": "time;u;y\n0,00;1;-0,5\n0,02;2;1e-3\n",
    "semicolons and points": "time;u;y\n0.00;1;-0.5\n0.02;2;1e-3\n",
    "a comma in a note": "time;u;y;note\n0.00;1;-0.5;take off, hover\n0.02;2;1e-3;land\n",
    "tabs": "time\tu\ty\n0,00\t1\t-0,5\n0,02\t2\t1e-3\n",
    "Excel": "sep=;\r\ntime;u;y\r\n0,00;1;-0,5\r\n0,02;2;1e-3\r\n",
    "quotes": '"time","u","y"\n"0","1","-0.5"\n"0.02","2","0.001"\n',
    "comments": "# by hand\n% twice\n\ntime,u,y\n0,1,-0.5\n0.02,2,1e-3\n",
    "a line of units": "time,u,y\nms,,\n0,1,-0.5\n20,2,1e-3\n",
    "milliseconds": "time [ms],u,y\n0,1,-0.5\n20,2,1e-3\n",
    "dates": "time,u,y\n2026-01-31T23:59:59.990,1,-0.5\n2026-02-01T00:00:00.010,2,1e-3\n",
    "a semicolon at the end": "time;u;y;\n0,00;1;-0,5;\n0,02;2;1e-3;\n",
    "an old Mac": "time,u,y\r0,1,-0.5\r0.02,2,1e-3\r",
}


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("text", TABLES.values(), ids=TABLES)
def test_tables_as_people_have_them_are_read(tmp_path: Path, text: str, encoding: str) -> None:
    (tmp_path / "a.csv").write_bytes(text.encode(encoding))
    log = read_log(tmp_path / "a.csv")
    assert {name: one.value.tolist() for name, one in log.channels.items()} == {"u": [1.0, 2.0], "y": [-0.5, 1e-3]}
    assert log["y"].time.tolist() == [0.0, 0.02]


def test_columns_of_words_are_passed_over_and_named(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("time,mode,u,by\n0,AUTO,1,me\n1,MANUAL,NA,you\n2,AUTO,3,me\n")
    log = read_log(tmp_path / "a.csv")
    assert ([*log], log["u"].time.tolist(), log["u"].value.tolist()) == (["u"], [0, 2], [1, 3])
    assert log.provenance["ignored"] == ["mode (words, 'AUTO' in row 1)", "by (words, 'me' in row 1)"]


def test_a_table_of_text_has_a_gap_where_a_cell_is_not_a_number(tmp_path: Path) -> None:
    """As MATLAB's `writetable` has it, in a file whose suffix says nothing of its separator."""
    for suffix in (".txt", ".tsv", ".dat"):
        (tmp_path / f"a{suffix}").write_text("t\tu\ty\n0\t1\tNaN\n1\tnan\t5\n2\t3\t6\n")
        log = read_columns(tmp_path / f"a{suffix}", time="t")
        assert {name: (one.time.tolist(), one.value.tolist()) for name, one in log.channels.items()} == {
            "u": ([0, 2], [1, 3]),
            "y": ([1, 2], [5, 6]),
        }


def test_units_below_the_heading_are_the_channels(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("time,u,y\ns,V,[m/s2]\n0,1,2\n")
    assert [one.unit for one in read_log(tmp_path / "a.csv").channels.values()] == ["V", "m/s2"]


def test_dates_in_parquet_begin_at_zero(tmp_path: Path) -> None:
    stamps = pa.array([1769904000000, 1769904000020], pa.timestamp("ms", "UTC"))
    (tmp_path / "a.parquet").write_bytes(parquet(time=stamps, q=[1.0, 2.0]))
    assert read_log(tmp_path / "a.parquet")["q"].time.tolist() == [0.0, 0.02]


def matlab_object(name: str, kind: str) -> bytes:
    """A variable of a class of MATLAB (array class 17), as MATLAB writes a datetime."""

    def element(code: int, content: bytes) -> bytes:
        return np.array([code, len(content)], "<u4").tobytes() + content + bytes(-len(content) % 8)

    words = b"".join(element(1, word.encode()) for word in (name, "MCOS", kind))
    return element(14, element(6, np.array([17, 0], "<u4").tobytes()) + words + mat(x=np.uint32([[1]]))[128:])


def test_matlab_objects_are_passed_over_and_named(tmp_path: Path) -> None:
    objects = matlab_object("when", "datetime") + matlab_object("who", "string")
    (tmp_path / "a.mat").write_bytes(mat(q=struct()) + objects)
    log = read_log(tmp_path / "a.mat")
    assert ([*log], log.provenance["ignored"]) == (["q"], ["when", "who"])
    (tmp_path / "a.mat").write_bytes(mat(t=np.arange(3.0), data={"u": np.ones(3), "y": np.ones(3)}) + objects)
    log = read_columns(tmp_path / "a.mat", time="t")
    assert ([*log], log.provenance["ignored"]) == (
        ["data.u", "data.y"],
        ["when (a MATLAB datetime)", "who (a MATLAB string)"],
    )
    with pytest.raises(LogError, match=r"'time' is missing .there are: t, data, when .a MATLAB datetime.*--period"):
        read_columns(tmp_path / "a.mat", time="time")
    (tmp_path / "a.mat").write_bytes(mat(q=struct()) + mat(q=struct())[128:])
    with pytest.raises(LogError, match="'q' is there twice"):
        read_log(tmp_path / "a.mat")


GYRO = Channel([0.0, 0.5], [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], "rad/s", ("x", "y", "z"))


def test_wide_table_has_a_row_for_each_stamp(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    write_log(FlightLog({"theta": Channel([0.0, 0.25], [0.1, 0.2], "rad"), "gyr": GYRO}), path, wide=True)
    meta, heading, *rows = path.read_text().splitlines()
    assert heading == '"time [s]","theta [rad]","gyr.x [rad/s]","gyr.y [rad/s]","gyr.z [rad/s]"'
    assert rows == ["0,0.1,1,2,3", "0.25,0.2,,,", "0.5,,4,5,6"]
    added = [meta, heading + ",twice [rad]", *(f"{row},{k}" for k, row in enumerate(rows))]
    path.write_text("\n".join(added) + "\n")
    assert read_log(path)["twice"].value.tolist() == [0.0, 1.0, 2.0]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda text: text.replace("gyr.y", "gyr.w"), "gyr.y.*is missing"),
        (lambda text: text.replace("4,5,6", "4,,6"), "has only some of its fields"),
        (lambda text: text.rpartition("0.5,")[0], "truncated"),
    ],
)
def test_damaged_wide_table_is_refused(tmp_path: Path, change: Callable[[str], str], says: str) -> None:
    write_log(FlightLog({"gyr": GYRO}), tmp_path / "a.csv", wide=True)
    meta, rest = (tmp_path / "a.csv").read_text().split("\n", 1)
    (tmp_path / "a.csv").write_text(f"{meta}\n{change(rest)}")
    with pytest.raises(LogError, match=says):
        read_log(tmp_path / "a.csv")
