"""A drone for a command: connected to as `Drone.connect` does, with refusals that say what to do from the shell."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from twodof.errors import Rejected
from twodof.gcs.drone import Drone


def connect(url: str, key: Path | None = None, drone: int | None = None) -> Drone:
    """The drone at `url`, whose lease is ours; parameters as `Drone.connect`.

    Raises what that raises; Rejected where somebody else has the lease.
    """
    with lease_refusals(url):
        return Drone.connect(url, key=key, drone=drone)


@contextmanager
def lease_refusals(url: str) -> Iterator[None]:
    """Gives a refused lease of the drone at `url` the remedy of the shell."""
    try:
        yield
    except Rejected as refusal:
        if "lease" not in refusal.what:
            raise
        remedy = (
            f"wait until it is given up, or end who has it; `twodof kill --url {url}` stops the motors all the same"
        )
        raise Rejected(refusal.what, refusal.where, remedy) from refusal
