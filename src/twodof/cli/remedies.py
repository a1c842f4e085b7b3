"""Remedies in the words of the command line: the package's errors name calls of Python where those are its remedy."""

from types import MappingProxyType

IN_SHELL = MappingProxyType(
    {
        "with `at`": "with --at",
        "(in Python overwrite=True)": "",
        "or watch with take_lease=False": "or end who has it",
        "parameters.all() lists": "`twodof parameters` lists",
        "drone.release()": "`twodof kill --release`",
        "describe(log) lists the log's events": "`twodof log info` lists the log's events",
        "call it .mcap; write_log makes others of it": "call it .mcap; `twodof log convert` makes others of it",
        "write it with to_json": "write it as `twodof diagram new`, `twodof calibrate --out` or Python's to_json do",
        "(leave it out of `estimate`)": "(leave it out of --estimate)",
    }
)
"""What a remedy says -> what the command line says in its place."""


def remedy_in_shell(remedy: str) -> str:
    """The remedy, with options and commands in place of calls."""
    for call, words in IN_SHELL.items():
        remedy = remedy.replace(call, words)
    return remedy.strip()
