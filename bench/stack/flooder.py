"""One process that floods a TCP port with sound frames: `python -m bench.stack.flooder HOST:PORT CONNECTIONS`.

Each connection sends heartbeats of a system of its own as fast as they are taken, and is opened again where it ends.
It says a line once all have been tried, and ends with standard input.
"""

import selectors
import socket
import sys
import time

from twodof.link.mavlink.framing import encode
from twodof.link.mavlink.messages import message

PIECE = 16 << 10
AGAIN_S = 0.05
"""Before a connection that ended is opened again."""


def heartbeats(system: int) -> bytes:
    """Return as many heartbeats as fit into a piece."""
    beat = message("HEARTBEAT", type=6, autopilot=8, system_status=4)
    return b"".join(encode(beat, system, 190, number & 255) for number in range(PIECE // 21))


def opened(host: str, port: int) -> socket.socket:
    """A connection that is on its way."""
    link = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    link.setblocking(False)
    link.connect_ex((host, port))
    return link


def flood(host: str, port: int, count: int) -> None:
    """Until standard input ends."""
    data = [heartbeats(2 + number % 190) for number in range(count)]
    selector = selectors.DefaultSelector()
    selector.register(sys.stdin, selectors.EVENT_READ, None)
    closed = [(0.0, number) for number in range(count)]
    said = False
    while True:
        while closed and closed[0][0] <= time.monotonic():
            _, number = closed.pop(0)
            selector.register(opened(host, port), selectors.EVENT_WRITE | selectors.EVENT_READ, number)
        if not said:
            said = True
            sys.stdout.write("floods\n")
            sys.stdout.flush()
        for key, events in selector.select(AGAIN_S):
            if key.data is None:
                return
            link = key.fileobj
            assert isinstance(link, socket.socket)
            try:
                if events & selectors.EVENT_READ and not link.recv(1 << 20):
                    raise ConnectionResetError
                if events & selectors.EVENT_WRITE:
                    link.send(data[key.data])
            except BlockingIOError:
                continue
            except OSError:
                selector.unregister(link)
                link.close()
                closed.append((time.monotonic() + AGAIN_S, key.data))


if __name__ == "__main__":
    where, _, there = sys.argv[1].rpartition(":")
    flood(where, int(there), int(sys.argv[2]))
