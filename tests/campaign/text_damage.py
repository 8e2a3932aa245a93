"""Damage to text: numbers that are extreme or none, lines and words that are doubled, moved or left out."""

from __future__ import annotations

import random
import re
from collections.abc import Callable

# Each stands for a trap: overflows, values that are not finite, digits beyond what Python converts.
WORDS = (
    "0",
    "-0",
    "-1",
    "1",
    "2147483647",
    "2147483648",
    "-2147483649",
    "4294967296",
    "9223372036854775808",
    "1e9",
    "1e300",
    "-1e300",
    "1e-300",
    "1e400",
    "nan",
    "NaN",
    "-inf",
    "Infinity",
    "0x10",
    "1_000",
    "1.5.2",
    "1e",
    "",
    "9" * 5000,
    "1." + "0" * 5000 + "1",
    "null",
    "true",
    "x",
    "\0",
    "é" * 200,
    "../../../etc/none",
    "a" * 300,
)
# Repeated to a long line, each keeps a pattern busy that may match its parts in several ways.
RUNS = (
    *(
        " ",
        "\t",
        "\n",
        "\r",
        "a",
        "9",
        "1 ",
        "1,",
        ", ",
        ";",
        "= ",
        ": ",
        ".",
        "a.",
        "#",
        "(",
        "[",
        "<a>",
        '"',
        "'",
    ),
    *(
        "cam",
        "intrinsic ",
        "frame",
        "x.mtl",
        ".mtl ",
        "P1_roi",
        "\nP1_roi",
        "\n---",
        "\n-",
        "a=",
        "left",
        "bounding box",
    ),
)
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_WORD = re.compile(r"[^\s,;:{}\[\]()=]+")


def number_replaced(text: str, draw: random.Random) -> str:
    return _replaced(_NUMBER, text, draw)


def word_replaced(text: str, draw: random.Random) -> str:
    return _replaced(_WORD, text, draw)


def lines_moved(text: str, draw: random.Random) -> str:
    """Double, repeat, remove or exchange lines."""
    lines = text.splitlines(keepends=True) or ["\n"]
    a, b = draw.randrange(len(lines)), draw.randrange(len(lines))
    match draw.randrange(5):
        case 0:
            lines.insert(b, lines[a])
        case 1:
            lines[a:a] = [lines[a]] * draw.choice((2, 100, 5000))
        case 2:
            del lines[a]
        case 3:
            lines[a], lines[b] = lines[b], lines[a]
        case _:
            del lines[min(a, b) : max(a, b)]
    return "".join(lines)


def line_inserted(text: str, draw: random.Random) -> str:
    lines = text.splitlines(keepends=True)
    made = " ".join(draw.choice(WORDS) for _ in range(draw.choice((1, 3, 8))))
    lines.insert(draw.randint(0, len(lines)), made + "\n")
    return "".join(lines)


def ends_changed(text: str, draw: random.Random) -> str:
    """Change line ends or lead with a mark of byte order: what other programs and systems write."""
    return draw.choice(
        (text.replace("\n", "\r\n"), text.replace("\n", "\r"), "\ufeff" + text, text.replace(" ", "\t"))
    )


def opened_deep(text: str, draw: random.Random) -> str:
    """Open brackets that nobody closes, or all of them."""
    opening, closing = draw.choice((("[", "]"), ("{", "}"), ("(", ")"), ("- ", "")))
    depth = draw.choice((70, 2000, 100_000))
    at = draw.randint(0, len(text))
    return text[:at] + opening * depth + draw.choice(("", closing * depth)) + text[at:]


def line_lengthened(text: str, draw: random.Random, length: int = 1 << 18) -> str:
    """Insert a long run of one character or word behind a word."""
    run = draw.choice(RUNS)
    ends = [found.end() for found in _WORD.finditer(text)] or [0]
    at = draw.choice(ends)
    return (
        text[:at] + draw.choice(("", " ")) + run * (length // len(run)) + draw.choice(("", "!")) + text[at:]
    )


_ALL: tuple[Callable[[str, random.Random], str], ...] = (
    number_replaced,
    number_replaced,
    number_replaced,
    word_replaced,
    lines_moved,
    lines_moved,
    line_inserted,
    ends_changed,
    opened_deep,
    line_lengthened,
)


def damaged_text(data: bytes, draw: random.Random) -> bytes:
    """Return a text file's content with one damage of any of these kinds."""
    text = data.decode("utf-8", "surrogateescape")
    return draw.choice(_ALL)(text, draw).encode("utf-8", "surrogateescape")


def _replaced(pattern: re.Pattern[str], text: str, draw: random.Random) -> str:
    found = list(pattern.finditer(text))
    if not found:
        return text + draw.choice(WORDS)
    # Counts and versions stand first; without this, long lists of coordinates would be hit alone.
    one = draw.choice(found[:12] if draw.random() < 0.4 else found)
    return text[: one.start()] + draw.choice(WORDS) + text[one.end() :]
