"""A target with a fault, by which the fuzzer itself is tested."""

from tests.fuzz.target import Target


def attempt(data: bytes) -> None:
    """Fails for one byte in two of the first."""
    if data[:1] == b"F" and data[1:2] != b"a":
        raise RuntimeError("the fault")


TARGET = Target("faulty", lambda: [b"Fa", b"F"[:0]], attempt, 10)
