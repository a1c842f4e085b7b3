"""A ground station made with pymavlink's own mavutil: `python mavutil_client.py URL [KEY]`; prints what came back."""

import sys

from pymavlink import mavutil


def main(url: str, key: str = "") -> None:
    """Heartbeats, a command, and the wait for its acknowledgement."""
    link = mavutil.mavlink_connection(url, source_system=255, source_component=190)
    if key:
        link.setup_signing(bytes.fromhex(key), sign_outgoing=True)
    for _ in range(5):
        link.mav.heartbeat_send(6, 8, 0, 0, 0)
    link.mav.command_long_send(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
    answer = link.recv_match(type="COMMAND_ACK", blocking=True, timeout=100)
    sys.stdout.write(f"{answer.get_type()} {answer.command} {answer.result} {answer.get_signed()} {link.mav_loss}\n")
    link.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
