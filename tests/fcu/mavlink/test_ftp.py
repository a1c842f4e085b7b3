"""MAVLink FTP: pymavlink's own client, every operation and error by hand, no way out of the tree."""

import struct
import zlib
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
from pymavlink.mavftp import MAVFTP

from tests.fcu.mavlink.world import CLIENT, World
from tests.patience import PATIENCE_S, patiently
from twodof.fcu.command.command_lease import rejected
from twodof.fcu.mavlink.file_tree import MAX_UPLOAD, MOST_UPLOADS, FileTree, mavlink_crc32
from twodof.fcu.mavlink.ftp import BURST_BYTES, MOST_CLIENTS, MOST_SESSIONS, UPLOAD_S, FileTransfer, burst_packets
from twodof.link.mavlink.ftp import FtpError, FtpOperation, FtpPacket, read_packet
from twodof.link.mavlink.messages import message

pytestmark = pytest.mark.slow

ALL = bytes(range(256)) * 300
MADE = {"all.bin": ALL, "empty.json": b"", "small.json": b"{}"}


class Server(World):
    """A vehicle with a file server, and a client that speaks in packets."""

    def __init__(self, folder: Path, lockstep: bool = True) -> None:
        super().__init__(lockstep=lockstep)
        self.controllers = folder / "state" / "controllers"
        self.made = dict(MADE)
        tree = FileTree(lambda: self.made, self.controllers)
        self.now = 100.0
        self.ftp = FileTransfer(self.px4.vehicle, tree, clock=lambda: self.now)
        self.services.append(self.ftp)
        self.sequence = 0

    def ask(self, op: int, data: bytes = b"", session: int = 0, offset: int = 0, **options: Any) -> list[FtpPacket]:
        """A request; its answers."""
        self.sequence += 1
        size = options.pop("size", len(data))
        head = struct.pack("<HBBBBBxI", self.sequence & 0xFFFF, session, op, size, 0, 0, offset)
        return self.raw(head + data, **options)

    def raw(self, payload: bytes, **options: Any) -> list[FtpPacket]:
        """A payload as it is; the answers."""
        self.say(message("FILE_TRANSFER_PROTOCOL", target_system=1, target_component=1, payload=payload), **options)
        return self.answers()

    def answers(self) -> list[FtpPacket]:
        """What it has said since."""
        return [read_packet(bytes(one.payload)) for one in self.taken("FILE_TRANSFER_PROTOCOL")]

    def one(self, *arguments: Any, **options: Any) -> FtpPacket:
        """A request with one answer."""
        (answer,) = self.ask(*arguments, **options)
        assert answer.sequence == (self.sequence + 1) & 0xFFFF
        return answer

    def fault(self, *arguments: Any, **options: Any) -> int:
        """The error with which a request is refused."""
        answer = self.one(*arguments, **options)
        assert answer.op == FtpOperation.NAK
        return answer.data[0]

    def opened(self, path: str) -> tuple[int, int]:
        """Session and size of a file that was opened."""
        answer = self.one(FtpOperation.OPEN_RO, path.encode())
        assert answer.op == FtpOperation.ACK
        return answer.session, struct.unpack_from("<I", answer.data)[0]


class Master:
    """Connection of pymavlink's client to a vehicle in memory.

    It is its clock too: time passes where it listens in vain, so that a slow computer is not taken for a dead link.
    """

    target_system, target_component = 1, 1
    source_system, source_component = CLIENT

    def __init__(self, server: Server) -> None:
        self.server, self.mav = server, self
        self.messages: list[Any] = []
        self.now = 0.0

    def time(self) -> float:
        return self.now

    def file_transfer_protocol_send(self, network: int, system: int, component: int, payload: Any) -> None:
        fields = {"target_system": system, "target_component": component, "payload": bytes(payload)}
        self.server.say(message("FILE_TRANSFER_PROTOCOL", target_network=network, **fields))

    def recv_match(self, timeout: float = 0.0, **_: Any) -> Any:
        self.messages += self.server.taken("FILE_TRANSFER_PROTOCOL")
        if not self.messages:
            self.server.ftp.send_bursts()
            self.messages += self.server.taken("FILE_TRANSFER_PROTOCOL")
        self.now += 0.001 if self.messages else timeout
        return self.messages.pop(0) if self.messages else None


@pytest.fixture
def server(tmp_path: Path) -> Server:
    return Server(tmp_path)


def test_the_whole_tree_is_seen(server: Server) -> None:
    def names(path: str) -> list[bytes]:
        found, at = [], 0
        while (answer := server.one(FtpOperation.LIST, path.encode(), offset=at)).op == FtpOperation.ACK:
            lines = answer.data[: answer.size].rstrip(b"\0").split(b"\0")
            found, at = found + lines, at + len(lines)
        assert answer.data[0] == FtpError.END
        return found

    assert names("/") == [b"Dcontrollers", b"Detc"]
    assert names("/etc") == names("etc/") == [b"Dextras"]
    assert names("/etc/extras") == [b"Fall.bin\t76800", b"Fempty.json\t0", b"Fsmall.json\t2"]
    assert names("/controllers") == []


def test_a_long_list_comes_in_parts(server: Server) -> None:
    server.made |= {f"{k:03d}{'n' * 40}": b"" for k in range(100)}
    found, at = b"", 0
    while (answer := server.one(FtpOperation.LIST, b"/etc/extras", offset=at)).op == FtpOperation.ACK:
        found, at = found + answer.data[: answer.size], at + answer.data[: answer.size].count(b"\0")
    assert at == 100 + len(MADE) == found.count(b"\0")


def test_reading_in_pieces_and_in_bursts_gives_the_file(server: Server) -> None:
    session, size = server.opened("/etc/extras/all.bin")
    assert size == len(ALL)
    pieces = [server.one(FtpOperation.READ, session=session, offset=at, size=100) for at in range(0, size, 100)]
    assert b"".join(piece.data[: piece.size] for piece in pieces) == ALL
    assert server.fault(FtpOperation.READ, session=session, offset=size) == FtpError.END


def burst(server: Server, session: int, offset: int, chunk: int) -> list[FtpPacket]:
    """The answers to a burst request; in lockstep without an event loop each look sends a portion."""
    answers = server.ask(FtpOperation.BURST, session=session, offset=offset, size=chunk)
    while not (answers[-1].complete or answers[-1].op == FtpOperation.NAK):
        server.ftp.send_bursts()
        answers += server.answers()
    return answers


@pytest.mark.parametrize("chunk", [0, 80, 239])
def test_a_burst_is_bounded_numbered_and_ends(server: Server, chunk: int) -> None:
    session, size = server.opened("/etc/extras/all.bin")
    found, rounds = b"", 0
    while len(found) < size:
        answers = burst(server, session, len(found), chunk)
        rounds += 1
        assert [one.sequence for one in answers] == [server.sequence + 1 + k for k in range(len(answers))]
        parts = [one for one in answers if one.op == FtpOperation.ACK]
        assert [one.offset for one in parts] == [len(found) + k * (chunk or 239) for k in range(len(parts))]
        assert sum(one.size for one in parts) <= BURST_BYTES
        found += b"".join(one.data[: one.size] for one in parts)
    assert found == ALL
    assert answers[-1].op == FtpOperation.NAK
    assert answers[-1].data[0] == FtpError.END
    assert rounds == -(-size // BURST_BYTES)
    (end,) = burst(server, session, size, chunk)
    assert (end.op, end.data[0]) == (FtpOperation.NAK, FtpError.END)


def test_a_burst_is_made_as_it_is_sent() -> None:
    class Counted(bytes):
        parts = 0

        def __getitem__(self, at: Any) -> Any:
            Counted.parts += 1
            return super().__getitem__(at)

    request = read_packet(bytes(251))._replace(sequence=0xFFFF)
    packets = burst_packets(request, Counted(BURST_BYTES), 1, ends=True)
    # A client that asks for packets of one byte must not hold up the control loop, which sends some in each period.
    assert [one.sequence for one in islice(packets, 3)] == [0, 1, 2]
    assert Counted.parts == 3
    *_, last, end = packets
    assert (last.offset, last.complete, end.offset) == (BURST_BYTES - 1, 0, BURST_BYTES)
    assert end.sequence == BURST_BYTES
    assert end.data[0] == FtpError.END


def test_pymavlinks_client_reads_checks_and_sends(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    master = Master(server)
    monkeypatch.setattr("pymavlink.mavftp.time", master)
    client = MAVFTP(master, 1, 1)
    assert client.cmd_list(["/etc/extras"]).error_code == 0
    assert [(one.name, one.size_b) for one in client.list_result] == [(name, len(MADE[name])) for name in sorted(MADE)]
    client.cmd_get(["/etc/extras/all.bin", str(tmp_path / "got.bin")])
    assert client.process_ftp_reply("OpenFileRO", timeout=PATIENCE_S).error_code == 0
    assert (tmp_path / "got.bin").read_bytes() == ALL
    (tmp_path / "mine.json").write_bytes(ALL[:5000])
    client.cmd_put([str(tmp_path / "mine.json"), "/controllers/mine.json"])
    assert client.process_ftp_reply("CreateFile", timeout=PATIENCE_S).error_code == 0
    assert (server.controllers / "mine.json").read_bytes() == ALL[:5000]
    assert client.cmd_crc(["/controllers/mine.json"]).error_code == 0
    assert server.ftp.sessions == 0


def test_the_checksum_is_the_one_that_clients_compute(server: Server) -> None:
    answer = server.one(FtpOperation.CRC32, b"/etc/extras/all.bin")
    crc = 0
    for byte in ALL:  # bit by bit, begun with 0, not inverted: MAVLink guide
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xEDB88320 if crc & 1 else 0)
    assert struct.unpack_from("<I", answer.data)[0] == crc == mavlink_crc32(ALL)
    assert crc != zlib.crc32(ALL)


def upload(server: Server, path: str, content: bytes) -> FtpPacket:
    created = server.one(FtpOperation.CREATE, path.encode())
    if created.op != FtpOperation.ACK:
        return created
    for at in range(0, len(content), 200):
        assert (
            server.one(FtpOperation.WRITE, content[at : at + 200], session=created.session, offset=at).op
            == FtpOperation.ACK
        )
    return server.one(FtpOperation.TERMINATE, session=created.session)


def test_an_upload_is_there_whole_when_its_session_ends_and_not_before(server: Server) -> None:
    created = server.one(FtpOperation.CREATE, b"/controllers/a.json")
    server.one(FtpOperation.WRITE, b"half", session=created.session)
    assert not server.controllers.exists()
    server.one(FtpOperation.WRITE, b"HA", session=created.session)
    server.one(FtpOperation.TERMINATE, session=created.session)
    assert (server.controllers / "a.json").read_bytes() == b"HAlf"
    upload(server, "/controllers/a.json", b"other")
    assert [path.read_bytes() for path in server.controllers.iterdir()] == [b"other"]
    server.one(FtpOperation.REMOVE, b"/controllers/a.json")
    assert [*server.controllers.iterdir()] == []


@pytest.mark.parametrize("ends", [FtpOperation.RESET, "gone"])
def test_an_upload_that_is_given_up_leaves_nothing(server: Server, ends: Any) -> None:
    created = server.one(FtpOperation.CREATE, b"/controllers/a.json")
    server.one(FtpOperation.WRITE, b"half", session=created.session)
    if ends == "gone":
        server.ftp.gone("client")
    else:
        server.one(ends)
    assert server.ftp.sessions == 0
    assert not server.controllers.exists()


def test_an_upload_with_a_hole_is_not_kept(server: Server) -> None:
    session = server.one(FtpOperation.CREATE, b"/controllers/a.json").session
    assert server.fault(FtpOperation.WRITE, b"x", session=session, offset=5) == FtpError.FAIL
    assert server.fault(FtpOperation.TERMINATE, session=session) == FtpError.FAIL
    assert not server.controllers.exists()


def test_uploads_are_bounded(server: Server) -> None:
    session = server.one(FtpOperation.CREATE, b"/controllers/a.json").session
    assert server.fault(FtpOperation.WRITE, b"x", session=session, offset=MAX_UPLOAD) == FtpError.FAIL
    assert server.one(FtpOperation.CREATE, b"/controllers/b.json").op == FtpOperation.ACK
    assert server.fault(FtpOperation.CREATE, b"/controllers/c.json") == FtpError.NO_SESSIONS
    server.one(FtpOperation.RESET)
    for k in range(MOST_UPLOADS):
        assert upload(server, f"/controllers/{k}.json", b"{}").op == FtpOperation.ACK
    assert upload(server, "/controllers/more.json", b"{}").op == FtpOperation.NAK
    assert upload(server, "/controllers/7.json", b"[]").op == FtpOperation.ACK


def test_uploads_that_nobody_goes_on_with_make_room(server: Server) -> None:
    """Over UDP a client that is gone says nothing: two of them stopped everybody's uploads for good."""
    for name in (b"a", b"b"):
        server.one(FtpOperation.CREATE, b"/controllers/%s.json" % name, source=(251, 190), peer="gone")
    server.now += UPLOAD_S / 2
    assert server.one(FtpOperation.WRITE, b"x", session=1, source=(251, 190), peer="gone").op == FtpOperation.ACK
    server.now += UPLOAD_S / 2
    assert server.fault(FtpOperation.CREATE, b"/controllers/c.json") == FtpError.NO_SESSIONS, "none is abandoned yet"
    server.now += 1.0
    session = server.one(FtpOperation.CREATE, b"/controllers/c.json").session
    assert server.fault(FtpOperation.CREATE, b"/controllers/d.json") == FtpError.NO_SESSIONS, "one was gone on with"
    server.now += UPLOAD_S - 1.0
    assert server.one(FtpOperation.WRITE, b"{}", session=session).op == FtpOperation.ACK
    server.now += UPLOAD_S - 1.0
    assert server.one(FtpOperation.TERMINATE, session=session).op == FtpOperation.ACK
    assert (server.controllers / "c.json").read_bytes() == b"{}"
    assert server.fault(FtpOperation.WRITE, b"x", session=0, source=(251, 190), peer="gone") == FtpError.SESSION


def test_writing_needs_the_lease_and_reading_does_not(server: Server) -> None:
    session = server.one(FtpOperation.CREATE, b"/controllers/a.json").session
    server.commander.verdict = rejected("another holds the lease")
    assert server.fault(FtpOperation.CREATE, b"/controllers/b.json") == FtpError.PROTECTED
    assert server.fault(FtpOperation.REMOVE, b"/controllers/a.json") == FtpError.PROTECTED
    assert server.fault(FtpOperation.TERMINATE, session=session) == FtpError.PROTECTED
    assert "lease" in server.texts()
    assert not server.controllers.exists()
    server.opened("/etc/extras/small.json")


OUTSIDE = [
    "/etc/passwd",
    "/etc/extras/../../etc/passwd",
    "../../etc/passwd",
    "/controllers/../secret.json",
    "/controllers/link.json",
    "/controllers/.json",
    "/controllers/a/b.json",
    "/controllers/a.py",
    "/controllers/" + "a" * 60 + ".json",
    "/controllers/.",
    "/controllers",
    "/",
    "",
    "/etc/extras/all.bin/",
    "//etc//passwd",
    "\\etc\\passwd",
    "/controllers/a.json\n",
    "/fs/microsd/../../etc/passwd",
]


@pytest.mark.parametrize("path", OUTSIDE)
def test_there_is_no_way_out(server: Server, tmp_path: Path, path: str) -> None:
    secret = tmp_path / "state" / "secret.json"
    server.controllers.mkdir(parents=True)
    secret.write_text("secret")
    (server.controllers / "link.json").symlink_to(secret)
    if path == "/etc/extras/all.bin/":  # the same file: a slash at the end says nothing
        return
    for op in (FtpOperation.OPEN_RO, FtpOperation.CRC32, FtpOperation.REMOVE):
        assert server.fault(op, path.encode()) in (FtpError.NOT_FOUND, FtpError.PROTECTED), op
    if upload(server, path, b"overwritten").op == FtpOperation.ACK:
        pytest.fail(f"{path!r} was written")
    assert secret.read_text() == "secret"
    assert (server.controllers / "link.json").is_symlink()


def test_what_does_not_exist_here_is_refused(server: Server) -> None:
    for op in (
        FtpOperation.CREATE_FOLDER,
        FtpOperation.REMOVE_FOLDER,
        FtpOperation.OPEN_WO,
        FtpOperation.TRUNCATE,
        FtpOperation.RENAME,
    ):
        assert server.fault(op, b"/controllers/x") == FtpError.PROTECTED
    assert server.fault(77) == FtpError.UNKNOWN
    assert server.fault(FtpOperation.READ, session=9) == FtpError.SESSION
    assert server.fault(FtpOperation.BURST, session=9) == FtpError.SESSION
    assert server.fault(FtpOperation.WRITE, b"x", session=9) == FtpError.SESSION
    assert server.fault(FtpOperation.TERMINATE, session=9) == FtpError.SESSION
    assert server.fault(FtpOperation.READ, size=240) == FtpError.DATA_SIZE
    assert server.one(FtpOperation.NONE).op == FtpOperation.ACK
    assert (
        server.ask(FtpOperation.ACK) == server.ask(FtpOperation.NAK) == []
    )  # no answer to an answer, or two servers never stop


def test_a_request_that_comes_again_is_not_carried_out_again(server: Server) -> None:
    request = struct.pack("<HBBBBBxI", 9, 0, FtpOperation.OPEN_RO, 22, 0, 0, 0) + b"/etc/extras/small.json"
    assert server.raw(request) == server.raw(request)
    assert server.ftp.sessions == 1
    ending = struct.pack("<HBBBBBxI", 10, 0, FtpOperation.TERMINATE, 0, 0, 0, 0)
    assert server.raw(ending)[0].op == server.raw(ending)[0].op == FtpOperation.ACK


def test_sessions_and_clients_are_bounded(server: Server) -> None:
    for _ in range(3 * MOST_SESSIONS):
        assert server.one(FtpOperation.OPEN_RO, b"/etc/extras/all.bin").op == FtpOperation.ACK
    assert server.ftp.sessions == MOST_SESSIONS
    for client in range(3 * MOST_CLIENTS):
        server.ask(FtpOperation.OPEN_RO, b"/etc/extras/all.bin", peer=f"client {client}")
    assert server.ftp.sessions <= MOST_CLIENTS + MOST_SESSIONS
    for client in range(3 * MOST_CLIENTS):
        server.ftp.gone(f"client {client}")
    server.ftp.gone("client")
    assert server.ftp.sessions == 0


def test_in_real_time_another_thread_reads_and_the_order_stays(tmp_path: Path) -> None:
    server = Server(tmp_path, lockstep=False)
    content = ALL[:2000]
    # pymavlink's client does not wait for the answer to CREATE before it writes.
    answers = server.ask(FtpOperation.CREATE, b"/controllers/a.json", session=3)
    for at in range(0, len(content), 200):
        answers += server.ask(FtpOperation.WRITE, content[at : at + 200], session=3, offset=at)
    answers += server.ask(FtpOperation.TERMINATE, session=3)
    assert not answers, "the folder is looked at by another thread, and the order is kept"
    for _ in patiently():
        server.run(1)
        answers += server.answers()
        if len(answers) == 12:
            break
    assert [one.asked for one in answers] == [FtpOperation.CREATE, *[FtpOperation.WRITE] * 10, FtpOperation.TERMINATE]
    assert all(one.op == FtpOperation.ACK for one in answers)
    assert (server.controllers / "a.json").read_bytes() == content
