"""Which files a picture may become; known without what draws it."""

from pathlib import Path

from twodof.errors import LogError
from twodof.flightlog.files import check_folder

SUFFIXES = (".png", ".svg", ".pdf")


def check_picture(path: str | Path, overwrite: bool = False) -> None:
    """Raise LogError for a suffix other than `SUFFIXES` and for a place that cannot be written."""
    if Path(path).suffix.lower() not in SUFFIXES:
        raise LogError(f"{Path(path).name} names no kind of picture", "plot", f"use {', '.join(SUFFIXES)}")
    check_folder(Path(path), overwrite)
