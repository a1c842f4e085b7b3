"""Who a client is to the server: its role, and the link with which others may watch."""

from typing import Any

from fastapi import APIRouter

from twodof import __version__
from twodof.lab.access.lab_client import CurrentClient
from twodof.lab.access.role import Role
from twodof.lab.current_lab import CurrentLab

router = APIRouter(prefix="/api/session", tags=["session"])


@router.get("")
async def session(lab: CurrentLab, client: CurrentClient) -> dict[str, Any]:
    """Role of this client, version of the server, and the path of the link with which others may only watch.

    `watch_link` is empty for who only watches, and where the server was started without such a link.
    """
    token = lab.settings.watch_token if client.role is Role.COMMAND else ""
    return {
        "role": client.role,
        "version": __version__,
        "watch_link": f"/?token={token}" if token else "",
        "clients": len(lab.audience),
    }
