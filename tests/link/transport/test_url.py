"""Addresses: the forms users know, and what else is refused with a remedy."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twodof.errors import LinkError
from twodof.link.transport.url import Address, parse


@pytest.mark.parametrize(
    ("url", "address"),
    [
        ("udp://192.168.4.1:14550", Address("udp", "192.168.4.1", 14550)),
        ("udpout://drone.local:14550", Address("udp", "drone.local", 14550)),
        ("udp://:14540", Address("udpin", "127.0.0.1", 14540)),
        ("udpin://:0", Address("udpin", "127.0.0.1", 0)),
        ("udpin://0.0.0.0:14550", Address("udpin", "0.0.0.0", 14550)),
        ("udp://[::1]:14550", Address("udp", "::1", 14550)),
        ("tcp://localhost:5760", Address("tcp", "localhost", 5760)),
        ("tcp://:5760", Address("tcpin", "127.0.0.1", 5760)),
        ("tcpin://0.0.0.0:5760/", Address("tcpin", "0.0.0.0", 5760)),
        ("serial:///dev/ttyACM0", Address("serial", "/dev/ttyACM0", baud=921600)),
        ("serial:///dev/ttyACM0?baud=57600", Address("serial", "/dev/ttyACM0", baud=57600)),
        ("serial:///dev/ttyACM0:57600", Address("serial", "/dev/ttyACM0", baud=57600)),
        ("serial:///dev/bus:1?baud=57600", Address("serial", "/dev/bus:1", baud=57600)),
        ("/dev/ttyUSB0,115200", Address("serial", "/dev/ttyUSB0", baud=115200)),
        ("udpin:0.0.0.0:14550", Address("udpin", "0.0.0.0", 14550)),
        ("udp:127.0.0.1:14550", Address("udpin", "127.0.0.1", 14550)),
        ("udpout:10.0.0.2:14550", Address("udp", "10.0.0.2", 14550)),
        ("tcp:127.0.0.1:5760", Address("tcp", "127.0.0.1", 5760)),
        ("udp://127.0.0.1:14540?bind=14580", Address("udp", "127.0.0.1", 14540, 0, "127.0.0.1", 14580)),
        ("udp://localhost:1?bind=0", Address("udp", "localhost", 1, 0, "127.0.0.1", 0)),
        ("udp://[::1]:14540?bind=14580", Address("udp", "::1", 14540, 0, "::1", 14580)),
        ("udpout://10.0.0.2:1?bind=0.0.0.0:14580", Address("udp", "10.0.0.2", 1, 0, "0.0.0.0", 14580)),
        ("udp://[fe80::2]:1?bind=[::]:2", Address("udp", "fe80::2", 1, 0, "::", 2)),
        ("udpbcast://192.168.1.255:14550", Address("udpbcast", "192.168.1.255", 14550)),
        ("udpbcast://10.0.0.255:1?bind=0.0.0.0:2", Address("udpbcast", "10.0.0.255", 1, 0, "0.0.0.0", 2)),
        ("udpbcast:10.0.0.255:14550", Address("udpbcast", "10.0.0.255", 14550)),
        ("mem://drone-1", Address("mem", "drone-1")),
        ("memin://drone-1", Address("memin", "drone-1")),
    ],
)
def test_forms(url: str, address: Address) -> None:
    assert parse(url) == address
    assert parse(str(address)) == address  # an address's text is a URL of the same


@pytest.mark.parametrize(
    ("url", "complaint"),
    [
        ("", "is not a kind of link"),
        ("127.0.0.1:14580", "did you mean udp://127.0.0.1:14580"),
        ("rig.local:5760", "did you mean udp://rig.local:5760"),
        ("[::1]:5790", r"did you mean udp://\[::1\]:5790"),
        ("http://host:80", "'http' is not a kind of link"),
        ("udp://host", "has no port"),
        ("udp://host:0", "has no port"),
        ("udp://host:99999", "out of range"),
        ("udp://0.0.0.0:14550", "udpin://0.0.0.0:14550"),
        ("tcp://user@host:5760", "does not take"),
        ("udp://host:1?key=secret", "does not take"),
        ("serial://ttyACM0", "is not a serial line"),
        ("serial:ttyACM0", "is not a serial line"),
        ("serial:&//600", "is not a serial line"),
        ("serial:///dev/ttyACM0#1", "is not a serial line"),
        ("serial:///dev/ttyACM0?a&b&c&d&e", "more options"),
        ("udp://127.0.0.1:1?bind=1&b&c&d&e", "more options"),
        ("serial:///dev/ttyACM0?baud=12345", "use one of 9600"),
        ("serial:///dev/ttyACM0?parity=odd", "is not a serial line"),
        ("udp://10.0.0.2:14540?bind=14580", r"bind=0\.0\.0\.0:14580"),  # this machine only cannot reach that one
        ("udp://127.0.0.1:1?bind=x", "bind=PORT"),
        ("udp://127.0.0.1:1?bind=99999", "out of range"),
        ("udp://127.0.0.1:1?bind=1&bind=2", "does not take"),
        ("udp://127.0.0.1:1?bind=", "not a place to listen"),
        ("udp://127.0.0.1:1?bind=a@b:1", "not a place to listen"),
        ("udpin://127.0.0.1:1?bind=2", "does not take"),
        ("tcp://127.0.0.1:1?bind=2", "does not take"),
        ("udpbcast://:14550", "has no host"),
        ("udpbcast://10.0.0.255", "has no port"),
        ("udpbcast://0.0.0.0:1", "not a host to send to"),
        ("mem://", "has no name"),
        ("mem://a/b", "does not take"),
        ("udp://a\nb:1", "is not a URL"),
        ("x" * 5000, "is not a URL"),
    ],
)
def test_the_rest_is_refused_with_a_remedy(url: str, complaint: str) -> None:
    with pytest.raises(LinkError, match=complaint) as caught:
        parse(url)
    assert caught.value.remedy
    assert len(str(caught.value)) < 1600


@given(st.text(max_size=60))
def test_any_text_at_all(text: str) -> None:
    for url in (text, "udp:" + text, "serial:///dev/" + text, "tcp://" + text):
        try:
            address = parse(url)
        except LinkError:
            continue
        assert parse(str(address)) == address
