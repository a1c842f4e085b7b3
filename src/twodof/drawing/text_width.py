"""Width of texts in Helvetica and in the fonts of the same letter widths (Arial, Liberation)."""

import unicodedata

# Thousandths of the font's size, from the public font metrics (AFM) of Helvetica.
_ROWS = {
    191: "'",
    222: "ijl",
    260: "|",
    278: " !,./:;I[\\]ft",
    333: "()-r`",
    334: "{}",
    355: '"',
    389: "*",
    469: "^",
    500: "Jckszvxy",
    556: "#$0123456789?L_abdeghnopqu",
    584: "+<=>~",
    611: "FTZ",
    667: "&ABEKPSVXY",
    722: "CDHNRUw",
    778: "GOQ",
    833: "Mm",
    889: "%",
    944: "W",
    1015: "@",
}
_WIDTHS = {letter: width for width, letters in _ROWS.items() for letter in letters}
_UNKNOWN, _WIDE = 620, 1000
_BOLD = 1.08


def text_width(text: str, size: float, bold: bool = False) -> float:
    """Return the width of `text` at the font size `size`, in its unit; unknown letters count as wide ones."""
    total = 0
    for letter in text:
        if unicodedata.combining(letter):
            continue
        known = _WIDTHS.get(letter)
        if known is None:
            known = _WIDE if unicodedata.east_asian_width(letter) in "WF" else _UNKNOWN
        total += known
    return total * size / 1000.0 * (_BOLD if bold else 1.0)


def shortened(text: str, size: float, most: float, bold: bool = False) -> str:
    """Return `text` on one line, cut and with an ellipsis if it is wider than `most`."""
    plain = " ".join("".join(c if c.isprintable() else " " for c in text[:1000]).split())
    if text_width(plain, size, bold) <= most:
        return plain
    while plain and text_width(plain + "…", size, bold) > most:
        plain = plain[:-1]
    return plain + "…"
