"""A serial line: raw, exclusive, without flow control, as a flight controller's telemetry port is."""

import asyncio
import errno
import fcntl
import os
import termios
import tty
from collections.abc import Hashable
from contextlib import suppress

from twodof.errors import LinkError
from twodof.link.transport.base import MOST_OUT_BYTES, READ_BYTES, Packet, Transport
from twodof.link.transport.url import BAUDS, Address


class SerialTransport(Transport):
    """One serial device. Made by `open_serial`."""

    def __init__(self, address: Address, descriptor: int) -> None:
        super().__init__(str(address))
        self._peer = address.name
        self._descriptor = descriptor
        self._out = bytearray()
        self._loop = asyncio.get_running_loop()
        self._inbox.on_taken = self._resume
        self._reading = False
        self._resume(self._peer)

    @property
    def peers(self) -> tuple[Hashable, ...]:
        """The device."""
        return (self._peer,)

    @property
    def backlog(self) -> int:
        """Bytes that still wait for the line's driver."""
        return len(self._out)

    def _resume(self, _: Hashable) -> None:
        if not self._reading and not self.closed and not self._inbox.full:
            self._reading = True
            self._loop.add_reader(self._descriptor, self._readable)

    def _readable(self) -> None:
        # A pseudo-terminal whose other end is closed says EIO, a pulled USB adapter EIO or ENXIO.
        data, broke = b"", "the device is gone"
        try:
            data = os.read(self._descriptor, READ_BYTES)
        except (BlockingIOError, InterruptedError):
            return
        except OSError as error:
            broke = str(error.strerror)
        if not data:
            self._lose(f"the line broke: {broke}", "check the cable and open it again")
            return
        self._inbox.put(Packet(data, self._peer))
        if self._inbox.full:
            self._reading = False
            self._loop.remove_reader(self._descriptor)

    def _send(self, data: bytes, peer: Hashable) -> bool:
        if len(self._out) + len(data) > MOST_OUT_BYTES:
            return False
        idle = not self._out
        self._out += data
        if idle:
            self._writable()
            if self._out and not self.closed:
                self._loop.add_writer(self._descriptor, self._writable)
        return True

    def _writable(self) -> None:
        try:
            sent = os.write(self._descriptor, self._out)
        except (BlockingIOError, InterruptedError):
            return
        except OSError as error:
            self._lose(f"the line broke: {error.strerror}", "check the cable and open it again")
            return
        del self._out[:sent]
        if not self._out:
            self._loop.remove_writer(self._descriptor)

    def _release(self) -> None:
        self._loop.remove_reader(self._descriptor)
        self._loop.remove_writer(self._descriptor)
        with suppress(OSError):
            os.close(self._descriptor)


def open_serial(address: Address) -> SerialTransport:
    """Open the serial device at `address` for this process alone. Raises LinkError if the system refuses."""
    try:
        descriptor = os.open(address.name, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        remedies = {
            errno.ENOENT: "plug it in, or name another device",
            errno.EACCES: "let the user into the group that owns the device (Debian: adduser USER dialout)",
            errno.EBUSY: "end the program that uses it",
        }
        remedy = remedies.get(error.errno or 0, "check the device")
        raise LinkError(f"cannot be opened: {error.strerror}", str(address), remedy) from error
    try:
        tty.setraw(descriptor, termios.TCSANOW)
        settings = termios.tcgetattr(descriptor)
        settings[2] = (settings[2] | termios.CLOCAL | termios.CREAD) & ~(termios.CSTOPB | termios.CRTSCTS)
        settings[4] = settings[5] = BAUDS[address.baud]
        termios.tcsetattr(descriptor, termios.TCSANOW, settings)
        fcntl.ioctl(descriptor, termios.TIOCEXCL)
    except (termios.error, OSError) as error:
        os.close(descriptor)
        raise LinkError(f"is not a serial line: {error}", str(address), "name a serial device") from error
    return SerialTransport(address, descriptor)
