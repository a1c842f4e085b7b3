"""What a program of ours said before it ended, told once: its own error where it named one, else its last lines."""

from collections.abc import Sequence

from twodof.errors import LinkError

_WHAT, _WHERE, _REMEDY = "error:", "  where:", "  remedy:"


def indented_lines(said: Sequence[str]) -> str:
    """The lines, each below the one before and indented; "it said nothing" without any."""
    return "".join(f"\n    {line}" for line in said if line.strip()) or "\n    it said nothing"


def child_error(said: Sequence[str], name: str, status: int | None = None) -> LinkError:
    """The error that the program `name` ended with, of its last lines `said`.

    Where it is one of ours (`output.print_error`) it has that one's fact, place and remedy; else it shows all lines.
    """
    begins = [number for number, line in enumerate(said) if line.startswith(_WHAT)]
    if not begins:
        ended = "it ended" if status is None else f"it ended with status {status}"
        return LinkError(f"{ended}; it last said:{indented_lines(said)}", name, "put right what it says")
    last = [line.rstrip() for line in said[begins[-1] :]]
    what = [last[0].removeprefix(_WHAT).strip()]
    where = remedy = ""
    for line in last[1:]:
        if line.startswith(_WHERE):
            where = line.removeprefix(_WHERE).strip()
        elif line.startswith(_REMEDY):
            remedy = line.removeprefix(_REMEDY).strip()
        elif line.strip() and not remedy:
            what.append(line.rstrip())
    return LinkError("\n".join(what), f"{name}, {where}" if where else name, remedy)
