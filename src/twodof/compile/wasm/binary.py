"""The binary form of a WebAssembly module, as far as it takes to know that one is closed, and to bound its memory."""

from collections.abc import Iterator, Sequence

from twodof.errors import CompileError

PAGE = 65536  # bytes
IMPORT, MEMORY, GLOBAL, EXPORT, START, DATA = 2, 5, 6, 7, 8, 11
_HEAD = b"\0asm\1\0\0\0"
_KINDS = ("function", "table", "memory", "global")


def closed(module: bytes, functions: Sequence[str], name: str, reserved: tuple[int, int] = (0, 0)) -> tuple[bytes, int]:
    """The module with a memory that cannot grow and contains `reserved`, and the pages it has.

    Raises CompileError, with `name` as its place, if the module is malformed, or imports or starts anything. It must
    export exactly "memory" and `functions`, and keep its stack and constants out of the `reserved` (from, to)
    addresses.
    """
    try:
        return _closed(module, functions, name, *reserved)
    except IndexError as error:
        raise _refused("it ends within a section", name) from error


def _closed(module: bytes, functions: Sequence[str], name: str, start: int, end: int) -> tuple[bytes, int]:
    if module[: len(_HEAD)] != _HEAD:
        raise _refused("it does not begin as one of version 1", name)
    made, pages = [_HEAD], 0
    exports: set[str] = set()
    for kind, body in _sections(module):
        if kind in (IMPORT, START):
            raise _refused("it imports something" if kind == IMPORT else "it runs something by itself", name)
        content = body
        if kind == MEMORY:
            pages = max(_pages(body, name), -(-end // PAGE))
            content = b"\1\1" + 2 * _encoded(pages)  # one memory, with a limit: at least and at most `pages`
        elif kind in (GLOBAL, DATA) and end:
            inside = _stack(body) > start if kind == GLOBAL else any(a < end for a in _constants(body))
            if inside:
                raise CompileError(
                    "its linker puts the stack or the constants where the structs stand",
                    name,
                    "take the wheel ziglang, or a newer wasm-ld",
                )
        elif kind == EXPORT:
            exports = set(_exports(body))
        made.append(bytes([kind]) + _encoded(len(content)) + content)
    expected = {"memory memory", *(f"function {f}" for f in functions)}
    if exports != expected:
        raise _refused(f"it exports {', '.join(sorted(exports ^ expected))} wrongly or not at all", name)
    return b"".join(made), pages


def _sections(module: bytes) -> Iterator[tuple[int, bytes]]:
    at = len(_HEAD)
    while at < len(module):
        kind = module[at]
        size, at = _decoded(module, at + 1)
        if at + size > len(module):
            raise IndexError
        yield kind, module[at : at + size]
        at += size


def _pages(body: bytes, name: str) -> int:
    count, at = _decoded(body, 0)
    if count != 1 or body[at] not in (0, 1):  # 32-bit, not shared
        raise _refused("it does not have exactly one plain memory", name)
    return _decoded(body, at + 1)[0]


def _exports(body: bytes) -> Iterator[str]:
    count, at = _decoded(body, 0)
    for _ in range(count):
        size, at = _decoded(body, at)
        name, kind = body[at : at + size].decode("utf-8", "replace"), body[at + size]
        yield f"{_KINDS[kind] if kind < len(_KINDS) else 'unknown'} {name}"
        at = _decoded(body, at + size + 1)[1]


def _stack(body: bytes) -> int:
    """Where the stack begins, which grows down: the value of the first global, which is of type i32 and mutable."""
    return _address(body, _decoded(body, 0)[1] + 2)[0]


def _constants(body: bytes) -> Iterator[int]:
    """The addresses of the data segments."""
    count, at = _decoded(body, 0)
    for _ in range(count):
        kind, at = _decoded(body, at)
        address, at = _address(body, at) if kind == 0 else (0, at)
        yield address
        size, at = _decoded(body, at)
        at += size


def _address(body: bytes, at: int) -> tuple[int, int]:
    """The value of the expression `i32.const value` (a signed LEB128 number), and where it ends; else address 0."""
    if body[at] != 0x41:
        return 0, at + 1
    value, end = _decoded(body, at + 1)
    if body[end - 1] & 0x40 and end - at < 6:
        value -= 1 << 7 * (end - at - 1)
    return value % (1 << 32), end + 1


def _decoded(data: bytes, at: int) -> tuple[int, int]:
    """An unsigned LEB128 number of at most 32 bits, and where it ends."""
    value = shift = 0
    while shift < 35:
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
        shift += 7
    raise IndexError


def _encoded(value: int) -> bytes:
    made = bytearray()
    while value >= 0x80:
        made.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*made, value])


def _refused(what: str, name: str) -> CompileError:
    return CompileError(f"this is no module that the sandbox takes: {what}", name, "report this as a fault")
