"""Parquet and CSV: bit for bit there and back; other people's tables; damage."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.flightlog.synthetic import attitude_steps, same_bits
from twodof.errors import LogError
from twodof.flightlog.files import convert, read_log, write_log
from twodof.flightlog.log import Channel, FlightLog
from twodof.flightlog.table_file import write_parquet

pytestmark = pytest.mark.slow

SUFFIXES = (".parquet", ".csv", ".mat", ".mcap")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_log_round_trips_to_the_bit(tmp_path: Path, suffix: str) -> None:
    log = attitude_steps()
    write_log(log, tmp_path / f"a{suffix}")
    back = read_log(tmp_path / f"a{suffix}")
    same_bits(log, back)
    assert {key: back.provenance[key] for key in ("seed", "rig")} == log.provenance
    assert back.provenance["file"]["format"] == suffix[1:]


def test_real_logs_survive_a_tour_of_all_formats(flight_data: Path, tmp_path: Path) -> None:
    for name in ("doublet-0.03", "attitude-steps-10deg-student"):
        first = read_log(flight_data / f"{name}.mat")
        convert(flight_data / f"{name}.mat", tmp_path / "b.parquet", overwrite=True)
        convert(tmp_path / "b.parquet", tmp_path / "c.csv", overwrite=True)
        convert(tmp_path / "c.csv", tmp_path / "d.mat", overwrite=True)
        last = read_log(tmp_path / "d.mat")
        same_bits(first, last)
        history = last.provenance["history"]
        assert [one["name"] for one in history] == [f"{name}.mat", "b.parquet", "c.csv"]
        assert history[0]["sha256"] == first.provenance["file"]["sha256"]


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@settings(max_examples=40)
@given(value=arrays(float, (7, 2), elements=st.floats(allow_nan=False, allow_infinity=False)))
def test_every_finite_number_survives(tmp_path_factory: pytest.TempPathFactory, suffix: str, value: np.ndarray) -> None:
    path = tmp_path_factory.getbasetemp() / f"numbers{suffix}"
    log = FlightLog({"odd": Channel(np.arange(7) / 3.0, value, "N m", ("a", "b")), "none": Channel([], [])})
    write_log(log, path, overwrite=True)
    same_bits(log, read_log(path))


def test_columns_without_names(tmp_path: Path) -> None:
    log = FlightLog({"wide": Channel([0.0, 1.0], np.arange(24.0).reshape(2, 12), "K")})
    for suffix in (".csv", ".parquet"):
        write_log(log, tmp_path / f"a{suffix}")
        same_bits(log, read_log(tmp_path / f"a{suffix}"))


def test_rows_may_come_in_any_order_of_channels(tmp_path: Path) -> None:
    log = attitude_steps()
    write_parquet(log, tmp_path / "a.parquet")
    table = pq.read_table(tmp_path / "a.parquet")
    pq.write_table(table.sort_by([("time", "ascending"), ("field", "descending")]), tmp_path / "a.parquet")
    same_bits(log, read_log(tmp_path / "a.parquet"))


def test_a_tidy_table_without_our_line_takes_units_from_topics(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(
        "channel,field,time,value\ngyr,x,0,1\ngyr,y,0,2\ngyr,z,0,3\nq,,0.5,4\nmine,left,0,5\n"
    )
    log = read_log(tmp_path / "a.csv")
    assert (log["gyr"].value.tolist(), log["gyr"].unit, log["gyr"].fields) == ([[1, 2, 3]], "rad/s", ("x", "y", "z"))
    assert (log["q"].value.tolist(), log["q"].unit) == ([4], "rad/s")
    assert log["mine"].value.tolist() == [5]


def test_other_peoples_wide_tables(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("# made by hand\ntime [s],theta,height [m]\n0,0.1,\n0.5,0.2,7\n1.0,0.3,8\n")
    log = read_log(tmp_path / "a.csv")
    assert (log["theta"].time.tolist(), log["theta"].unit) == ([0, 0.5, 1.0], "rad")
    assert (log["height"].time.tolist(), log["height"].value.tolist(), log["height"].unit) == ([0.5, 1.0], [7, 8], "m")
    pq.write_table(pa.table({"time": [0, 1], "q": pa.array([1.5, None], pa.float32())}), tmp_path / "a.parquet")
    log = read_log(tmp_path / "a.parquet")
    assert (log["q"].time.tolist(), log["q"].value.tolist()) == ([0], [1.5])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "the file is empty"),
        ("a,b\n1,2\n", "no column 'time' among: a, b"),
        ("time\n1\n", "no column beside 'time'"),
        ("time,q\n1,x\n", "is not a table of numbers: .*'x'"),
        ("time,q\n1\n", "is not a table of numbers: .*Expected 2 columns, got 1"),
        ("time,q\n1,nan\n", "a.csv: q: value is nan at sample 0"),
        ("time,q\n1,inf\n", "a.csv: q: value is inf"),
        ("time,q\n2,1\n1,1\n", "a.csv: q: time does not increase"),
        ("time,q\n,1\n", "1 empty cells in column 'time'"),
        ("time,q,q\n1,1,1\n", "two columns have one name"),
        ("time,q [rad/s],q\n1,1,1\n", "two columns are called 'q'"),
        ("channel,field,time,value\ngyr,x,0,1\ngyr,y,1,2\n", "the fields of 'gyr' differ in their time stamps"),
        ("channel,field,time,value\ngyr,x,0,\n", "1 empty cells in column 'value'"),
        ('# twodof.flightlog {"version": 2}\nchannel,field,time,value\nq,,0,1\n', "layout version 2, not 1"),
        ("# twodof.flightlog {\nchannel,field,time,value\nq,,0,1\n", "not JSON"),
        ('# twodof.flightlog {"version": 1}\nchannel,field,time,value\nq,,0,1\n', "line of units .* is damaged"),
    ],
)
def test_wrong_tables_say_what_and_where(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(LogError, match=says) as caught:
        read_log(tmp_path / "a.csv")
    assert "a.csv" in str(caught.value)


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_a_cut_file_says_so_wherever_it_is_cut(tmp_path: Path, suffix: str) -> None:
    write_log(attitude_steps().slice(100.0, 100.4), tmp_path / f"whole{suffix}")
    whole = (tmp_path / f"whole{suffix}").read_bytes()
    path = tmp_path / f"cut{suffix}"
    for size in np.linspace(0, len(whole) - 1, 120, dtype=int):
        path.write_bytes(whole[:size])
        with pytest.raises(LogError, match="cut"):
            read_log(path)


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
@given(data=st.data())
def test_damage_is_a_log_error_or_a_valid_log(tmp_path_factory: pytest.TempPathFactory, suffix: str, data: Any) -> None:
    base = tmp_path_factory.getbasetemp()
    write_log(
        FlightLog({"q": Channel([0.0, 1.0], [2.0, 3.0]), "lmnf": Channel([], [])}), base / f"f{suffix}", overwrite=True
    )
    content = bytearray((base / f"f{suffix}").read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    (base / f"f{suffix}").write_bytes(content)
    try:
        log = read_log(base / f"f{suffix}")
    except LogError:
        return
    assert all(np.isfinite(log[name].value).all() for name in log)


def test_wrong_parquet_tables(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    for table, says in [
        (pa.table({"time": [1.0], "q": ["x"]}), "column 'q' is not of numbers"),
        (pa.table({"time": [1.0], "q": [[1.0]]}), "column 'q' is not of numbers"),
        (pa.table({"a": [1.0]}), "no column 'time'"),
    ]:
        pq.write_table(table, path)
        with pytest.raises(LogError, match=says):
            read_log(path)


def test_a_file_too_large_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_log(attitude_steps(), tmp_path / "a.csv")
    monkeypatch.setattr("twodof.flightlog.provenance.MAX_FILE_BYTES", 1000)
    with pytest.raises(LogError, match="at most 1000 bytes are read"):
        read_log(tmp_path / "a.csv")


def test_other_tools_see_the_tidy_table(tmp_path: Path) -> None:
    log = attitude_steps()
    write_parquet(log, tmp_path / "a.parquet")
    table = pq.read_table(tmp_path / "a.parquet")
    assert table.column_names == ["channel", "field", "time", "value"]
    rows = table.filter((pc.field("channel") == "gyr") & (pc.field("field") == "y"))
    assert rows.column("value").to_pylist() == log["gyr"].field("y").tolist()


def test_suffixes_and_conversion_onto_itself(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"no log format has the suffix '.xlsx' .use .mat, .mcap, .parquet, .csv"):
        read_log(tmp_path / "a.xlsx")
    write_log(attitude_steps(), tmp_path / "a.csv")
    with pytest.raises(LogError, match="written over itself"):
        convert(tmp_path / "a.csv", tmp_path / "a.csv")
    with pytest.raises(LogError, match="no log format"):
        convert(tmp_path / "a.csv", tmp_path / "a.txt")
    with pytest.raises(LogError, match="a name cannot stand in CSV"):
        write_log(FlightLog({'a"b': Channel([0.0], [1.0])}), tmp_path / "b.csv")
    assert sorted(one.name for one in tmp_path.iterdir()) == ["a.csv"]


@pytest.mark.parametrize(
    ("text", "without"),
    [
        ("time,q\n0.0,1.0\nnan,2.0\n0.008,3.0\n", "nan,2.0\n"),
        (
            "channel,field,time,value\nlmnf,M,0.0,1.0\nlmnf,N,0.0,1.0\nlmnf,M,nan,2.0\nlmnf,N,nan,2.0\n",
            "lmnf,M,nan,2.0\nlmnf,N,nan,2.0\n",
        ),
    ],
)
def test_a_time_stamp_that_is_no_number_is_named_and_its_remedy_works(text: str, without: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(text)
    with pytest.raises(LogError, match=r"time stamp is nan in row [23]") as caught:
        read_log(path)
    assert "remove them" in caught.value.remedy
    path.write_text(text.replace(without, ""))
    assert len(read_log(path).channels) == 1


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_wide_table_round_trips_to_the_bit(tmp_path: Path, suffix: str) -> None:
    log = attitude_steps()
    write_log(log, tmp_path / f"a{suffix}", wide=True)
    back = read_log(tmp_path / f"a{suffix}")
    same_bits(log, back)
    assert back.provenance["seed"] == log.provenance["seed"]
    odd = FlightLog({"cold": Channel([0.0, 1.0], np.arange(8.0).reshape(2, 4), "K"), "none": Channel([], [])})
    write_log(odd, tmp_path / f"b{suffix}", wide=True)
    same_bits(odd, read_log(tmp_path / f"b{suffix}"))


def test_a_wide_table_has_a_row_a_stamp_and_a_column_a_signal(tmp_path: Path) -> None:
    gyro = Channel([0.0, 0.5], [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], "rad/s", ("x", "y", "z"))
    log = FlightLog({"theta": Channel([0.0, 0.25], [0.1, 0.2], "rad"), "gyr": gyro})
    write_log(log, tmp_path / "a.csv", wide=True)
    _, *rows = (tmp_path / "a.csv").read_text().splitlines()
    assert rows == [
        '"time [s]","theta [rad]","gyr.x [rad/s]","gyr.y [rad/s]","gyr.z [rad/s]"',
        "0,0.1,1,2,3",
        "0.25,0.2,,,",
        "0.5,,4,5,6",
    ]


def test_a_column_added_to_a_wide_table_is_a_channel(tmp_path: Path) -> None:
    write_log(FlightLog({"theta": Channel([0.0, 1.0], [0.1, 0.2], "rad")}), tmp_path / "a.csv", wide=True)
    meta, heading, *rows = (tmp_path / "a.csv").read_text().splitlines()
    lines = [meta, heading + ",twice [rad]", *(f"{row},{k}" for k, row in enumerate(rows))]
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    assert read_log(tmp_path / "a.csv")["twice"].value.tolist() == [0.0, 1.0]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda text: text.replace("gyr.y", "gyr.w"), "gyr.y.*is missing"),
        (lambda text: text.replace("4,5,6", "4,,6"), "not all there in each row"),
        (lambda text: text.rpartition("0.5,")[0], "truncated"),
    ],
)
def test_a_damaged_wide_table_is_refused(tmp_path: Path, change: Callable[[str], str], says: str) -> None:
    gyro = Channel([0.0, 0.5], [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], "rad/s", ("x", "y", "z"))
    write_log(FlightLog({"gyr": gyro}), tmp_path / "a.csv", wide=True)
    meta, rest = (tmp_path / "a.csv").read_text().split("\n", 1)
    (tmp_path / "a.csv").write_text(f"{meta}\n{change(rest)}")
    with pytest.raises(LogError, match=says):
        read_log(tmp_path / "a.csv")


def test_only_tables_are_wide(tmp_path: Path) -> None:
    for suffix in (".mat", ".mcap"):
        with pytest.raises(LogError, match=r"not tables \(write .parquet, .csv"):
            write_log(attitude_steps(), tmp_path / f"a{suffix}", wide=True)
    twins = FlightLog({"a.b": Channel([0.0], [1.0]), "a": Channel([0.0], [[1.0, 2.0]], "", ("b", "c"))})
    with pytest.raises(LogError, match=r"two columns would be called 'a.b'"):
        write_log(twins, tmp_path / "a.csv", wide=True)
