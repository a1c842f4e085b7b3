"""Public files of other programs (`twodof log fetch --foreign`) are read, or refused in our own words."""

import re

import pytest

from twodof.errors import LogError
from twodof.flightlog.files import read_columns, read_log
from twodof.flightlog.public_data import FOREIGN_FILES, available

pytestmark = pytest.mark.slow

CHANNELS = {
    "ulog-px4-2016": {"acc", "theta", "M"},
    "ulog-px4-2019-appended": {"acc", "theta", "M"},
    "ulog-px4-small": {"q", "voltage"},
    "ulog-px4-tagged": {"q", "voltage"},
    "ulog-px4-events": {"q", "x0"},
    "matlab-two-vectors": {"theta"},
}
REFUSED = {
    "matlab-hdf5": r"v7.3 \(HDF5\) file .save it in MATLAB with save",
    "matlab-v4": r"not a MATLAB v5 file .save it in MATLAB with save",
    "matlab-object": "holds no vector .*there are: testobject",
    "matlab-functions": "holds no vector .*there are: a, b, c, sqr",
    "matlab-sparse": "holds no vector .*there are: testsparse",
}


@pytest.mark.long
@pytest.mark.parametrize("name", FOREIGN_FILES)
def test_a_foreign_file_is_read_or_refused(name: str) -> None:
    path = available(FOREIGN_FILES).get(name)
    if path is None:
        pytest.skip("it is not at hand: fetch it by `twodof log fetch --foreign`")
    refusal: LogError | None = None
    try:
        log = read_columns(path, period="0.01") if path.suffix == ".mat" else read_log(path)
    except LogError as error:
        refusal = error
    if refusal is None:
        assert {*log} >= CHANNELS.get(name, set())
        assert log.span[1] - log.span[0] < 1e4
    else:
        assert refusal.remedy
    assert name not in CHANNELS or refusal is None
    assert name not in REFUSED or re.search(REFUSED[name], str(refusal))


def test_foreign_files_have_addresses_and_hashes() -> None:
    rows = FOREIGN_FILES.values()
    assert {*CHANNELS, *REFUSED} < {*FOREIGN_FILES}
    assert len({row.sha256 for row in rows}) == len(rows)
    assert all(len(row.sha256) == 64 and row.url.startswith("https://") for row in rows)
    assert {row.suffix for row in rows} == {".ulg", ".mcap", ".mat"}
