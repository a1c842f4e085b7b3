"""Text files as other programs write them: byte order marks, UTF-16, separators of columns."""

import codecs

SEPARATORS = ",;\t"
"""What may stand between the columns of a table; with the last two, a comma may be the decimal mark."""


def text_of(data: bytes) -> str:
    """Return the text of a file: UTF-8, or UTF-16 behind a byte order mark, which is left out.

    Raises UnicodeDecodeError.
    """
    is_utf_16 = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    return data.decode("utf-16" if is_utf_16 else "utf-8-sig")


def separator_of(heading: str) -> str:
    """Return the separator of columns in a table's heading; a comma if there is none."""
    return max(SEPARATORS, key=heading.count)
