"""Writes docs/reference/lab-routes.md from what the lab's server says of itself: `python -m tools.lab_docs`.

A test compares the page with what this gives.
"""

import inspect
import re
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from twodof.lab.access import MOST_BODY, LabRoute, lab_routes
from twodof.lab.answers import DESCRIPTIONS
from twodof.lab.server import ROUTERS, create_app
from twodof.lab.settings import LabSettings
from twodof.lab.telemetry_client import ALIVE_S, LONGEST, MOST_CLIENTS, MOST_COLUMNS, MOST_STREAMS
from twodof.lab.telemetry_rows import COLUMNS, MOST_BYTES, MOST_UNANSWERED

PAGE = Path(__file__).resolve().parents[1] / "docs" / "reference" / "lab-routes.md"

INTRODUCTION = f"""# The lab's API

Made by `tools/lab_docs.py` from the server's own description; do not edit. The server gives the same as OpenAPI at
`/api/openapi.json`. [How to serve the page](../how-to/serve-the-page.md) says how it is started and who reaches it.

Quantities are in SI units and radians. A number that JSON lacks (NaN, infinity) is `null`. A program that is not a
browser sends the token of its link as `Authorization: Bearer TOKEN`; on the loopback it needs none.

A request that is refused is answered by `{{"what", "where", "remedy"}}` and one of these:

| status | |
|---:|---|
{{statuses}}

**Who** says which link a route takes: `watch` takes both, `command` only the one that commands. A route that only
computes changes nothing, so `watch` may call it; and who watches may stop the motors. A request has
{MOST_BODY >> 10} KiB at most, unless its route says otherwise. `{{{{number}}}}` in a path is the MAVLink system of a
drone: 1 for the first virtual one.
"""

WEB_SOCKET = f"""## telemetry

The web socket `/api/telemetry` tells every client what happens, and sends it the rows that it asks for. A browser gives
its token in the address, `?token=TOKEN`. {MOST_CLIENTS} clients are served at once.

### What a client sends

JSON texts of at most {LONGEST} characters:

| message | |
|---|---|
| `{{"do": "subscribe", "id": 7, "drone": 1, "columns": ["estimate.theta"], "rate": 250}}` | rows of these columns |
| `{{"do": "unsubscribe", "id": 7}}` | no more rows of that number |
| `{{"do": "here"}}` | the answer to the event `alive` |

`id` is 0 to 65535; one that is in use is replaced. A client has {MOST_STREAMS} subscriptions of {MOST_COLUMNS} columns
at most. At the full rate of 250 rows a second nothing is left out. At a lower `rate` (0.1 and more) each stretch of
ticks gives two rows: the least and the largest value of each column, in the order in which they came. A message that is
none of these closes the socket with the code 1007. One that cannot be is answered by the event `refused`.

### Rows

A binary message, little-endian:

| bytes | type | |
|---|---|---|
| 0 | uint8 | 1: rows; pass over what you do not know |
| 1 | uint8 | 0 |
| 2 to 3 | uint16 | `id` of the subscription |
| 4 to 7 | uint32 | number of rows, n |
| 8 to 11 | uint32 | rows of this subscription that were dropped so far, as this client was slow |
| 12 to 15 | uint32 | 0 |
| 16 to 23 | float64 | the server's unix time at which it was sent [s] |
| then 8 n | float64 | the drone's time of each row [s] |
| then 4 n each | float32 | the columns, one after the other, in their units; NaN where a row has no sample |

The drone's time rises within one start of the drone; after a reset or a restart it begins at 10 s again, as in its
logs. A client that does not keep up loses its oldest rows first: {MOST_BYTES // 1024} KiB wait for it, and no other
client notices.

The columns are {{columns}}. `truth` is that of a virtual rig.
`safety.action` is the number of the failsafe's action, 0 for none.

### Events

JSON texts. New fields and events may come.

| event | fields | when |
|---|---|---|
| `session` | `role` | at the beginning |
| `drone` | `drone`, `state` | when it changes, and once a second |
| `text` | `drone`, `severity`, `text`, `time` | the drone, or the server about it, says a line |
| `parameters` | `drone`, `names` | parameters changed, whoever changed them |
| `job` | `job` | a job goes on or ends; its result is at `/api/jobs/ID` |
| `log` | `drone`, `name` | a flight was recorded |
| `refused` | `id`, `what`, `where`, `remedy` | a subscription cannot be |
| `alive` | | every {ALIVE_S:g} s |

A client that may command answers `alive`. Who has answered once and then leaves more than {MOST_UNANSWERED} of them
unanswered stands still, as a frozen tab does whose browser keeps the socket open. A drone that only such clients
command is levelled and disarmed, as where they have left. Who never answers is there for as long as its socket is.

The `state` of a drone has `link` ("heard" or "lost"), `why_lost`, `armed`, `mode`, `safety_switch`, `killed`,
`killed_by` [system, component], `ours_killed` (by this server), `failsafe` (what it does), `failsafe_reason` and
`warnings` in words, `lease_holder` [system, component], `ours_leases` (the server commands it), `experiment` (one that
the server began flies it), `tuning_withheld`, `controller`, `changed_parameters`, `setpoint` (as asked for last),
`excitation` (its ticks while it plays), `recording` (name of the log that is written), `battery` (`voltage` [V],
`charge` 0 to 1), `rings_locked`, `virtual`, `lockstep`, `rig`, `seed`, `noise`, `name`, `system`, `url`, `autopilot`,
`ours` (it is one of ours) and `time` [s].
"""


def render() -> str:
    """The page's text."""
    app = create_app(LabSettings(Path()))
    described = app.openapi()
    statuses = "\n".join(f"| {status} | {text} |" for status, text in DESCRIPTIONS.items())
    lines = [INTRODUCTION.replace("{statuses}", statuses)]
    tag = ""
    rows = [(route, method) for route in lab_routes(ROUTERS) for method in sorted(route.methods or ())]
    for route, method in rows:
        told = described["paths"][_plain(route.path)][method.lower()]
        if told["tags"][0] != tag:
            tag = told["tags"][0]
            lines += [f"## {tag}", ""]
        lines += _route(route, method, told, described["components"]["schemas"])
    lines.append(WEB_SOCKET.replace("{columns}", ", ".join(f"`{name}`" for name in COLUMNS)))
    return "\n".join(lines)


def _plain(path: str) -> str:
    """A path as OpenAPI has it: without the kind of a parameter."""
    return re.sub(r":\w+\}", "}", path)


def _route(route: LabRoute, method: str, told: Mapping[str, Any], schemas: Mapping[str, Any]) -> Iterator[str]:
    who = "watch" if route.for_watchers else "command"
    size = f"; a request of up to {route.most_body / 2**20:.0f} MiB" if route.most_body != MOST_BODY else ""
    yield from (f"### {method} {_plain(route.path)}", "", f"Who: `{who}`{size}.", "")
    yield from (inspect.cleandoc(route.endpoint.__doc__ or ""), "")
    fields = [*_parameters(told), *_body(told, schemas)]
    if fields:
        yield from ("| field | | |", "|---|---|---|", *fields, "")


def _parameters(told: Mapping[str, Any]) -> Iterator[str]:
    for one in told.get("parameters", ()):
        if one["in"] in ("path", "query") and one["name"] != "number":
            need = (
                "in the path" if one["in"] == "path" else "in the query" + (", needed" if one.get("required") else "")
            )
            yield f"| `{one['name']}`, {need} | {_kind(one['schema'])} | {_cell(one.get('description', ''))} |"


def _body(told: Mapping[str, Any], schemas: Mapping[str, Any]) -> Iterator[str]:
    for kind, content in told.get("requestBody", {}).get("content", {}).items():
        schema = _resolved(content["schema"], schemas)
        if "properties" not in schema:
            yield f"| the body, {kind} | {_kind(schema)} | {_cell(schema.get('description', ''))} |"
            continue
        for name, one in schema["properties"].items():
            need = ", needed" if name in schema.get("required", ()) else ""
            found = _resolved(one, schemas)
            yield f"| `{name}`{need} | {_kind(found)} | {_cell(found.get('description', ''))} |"


def _resolved(schema: Mapping[str, Any], schemas: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the schema that a reference names; for a choice with null, the other alternative."""
    for choice in schema.get("anyOf", ()):
        if choice.get("type") != "null":
            return {**_resolved(choice, schemas), **{k: v for k, v in schema.items() if k != "anyOf"}}
    reference = schema.get("$ref", "").rpartition("/")[2]
    return schemas[reference] if reference else schema


def _kind(schema: Mapping[str, Any]) -> str:
    """Its type, bounds and default in words."""
    if "enum" in schema:
        words = " or ".join(f"`{value}`" for value in schema["enum"])
    elif "const" in schema:
        words = f"`{schema['const']}`"
    else:
        words = str(schema.get("type", "any"))
    low = schema.get("minimum", schema.get("exclusiveMinimum"))
    high = schema.get("maximum", schema.get("exclusiveMaximum"))
    if low is not None or high is not None:
        words += f", {'' if low is None else f'{low:g}'} to {'' if high is None else f'{high:g}'}"
    if "maxLength" in schema:
        words += f", up to {schema['maxLength']} characters"
    if "maxItems" in schema:
        words += f", up to {schema['maxItems']}"
    if schema.get("default") is not None:
        words += f"; left out: `{schema['default']}`"
    return words.replace("|", "\\|")


def _cell(text: str) -> str:
    """A text as a cell of a table."""
    return " ".join(text.split()).replace("|", "\\|")


if __name__ == "__main__":
    PAGE.write_text(render(), encoding="utf-8")
    sys.stdout.write(f"{PAGE} written\n")
