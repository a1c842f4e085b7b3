"""The web socket: telemetry in binary rows, events in JSON, to every client at its own pace."""

from __future__ import annotations

from contextlib import suppress

from fastapi import APIRouter, WebSocket
from starlette.websockets import WebSocketDisconnect

from twodof.lab.access.role import Role
from twodof.lab.current_lab import CurrentLab
from twodof.lab.telemetry.client import MostClients, TelemetryClient
from twodof.lab.telemetry.request import MalformedRequest

router = APIRouter(tags=["telemetry"])
MALFORMED, TRY_LATER = 1007, 1013


@router.websocket("/api/telemetry")
async def telemetry(websocket: WebSocket, lab: CurrentLab) -> None:
    """Telemetry and events, see docs/reference/lab-routes.md."""
    role = websocket.state.role
    assert isinstance(role, Role)
    await websocket.accept()
    client = TelemetryClient(websocket, role, lab)
    try:
        async with client:
            await client.serve()
    except MalformedRequest as mistake:
        with suppress(RuntimeError, WebSocketDisconnect):
            await websocket.close(MALFORMED, str(mistake)[:120])
    except MostClients as full:
        await websocket.close(TRY_LATER, str(full))
    except (WebSocketDisconnect, TimeoutError):
        pass
