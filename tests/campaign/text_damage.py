"""Damage to text: extreme or invalid numbers; repeated, moved or removed lines and words."""

from __future__ import annotations

import random
import re
from collections.abc import Callable

# Each word is a trap: overflow, non-finite values, or more digits than Python converts.
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
# Repeated in a long line, each text can be matched in several ways by some pattern.
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


def replace_number(text: str, draw: random.Random) -> str:
    return _replace_match(_NUMBER, text, draw)


def replace_word(text: str, draw: random.Random) -> str:
    return _replace_match(_WORD, text, draw)


def move_lines(text: str, draw: random.Random) -> str:
    """Repeat, remove or swap lines."""
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


def insert_line(text: str, draw: random.Random) -> str:
    lines = text.splitlines(keepends=True)
    made = " ".join(draw.choice(WORDS) for _ in range(draw.choice((1, 3, 8))))
    lines.insert(draw.randint(0, len(lines)), made + "\n")
    return "".join(lines)


def change_line_ends(text: str, draw: random.Random) -> str:
    """Change line ends or spaces, or insert a byte order mark, as other programs and systems do."""
    return draw.choice(
        (text.replace("\n", "\r\n"), text.replace("\n", "\r"), "\ufeff" + text, text.replace(" ", "\t"))
    )


def insert_brackets(text: str, draw: random.Random) -> str:
    """Insert nested brackets, closed or not."""
    opening, closing = draw.choice((("[", "]"), ("{", "}"), ("(", ")"), ("- ", "")))
    depth = draw.choice((70, 2000, 100_000))
    at = draw.randint(0, len(text))
    return text[:at] + opening * depth + draw.choice(("", closing * depth)) + text[at:]


def lengthen_line(text: str, draw: random.Random, length: int = 1 << 18) -> str:
    """Insert a long run of one character or word after a word."""
    run = draw.choice(RUNS)
    ends = [found.end() for found in _WORD.finditer(text)] or [0]
    at = draw.choice(ends)
    return (
        text[:at] + draw.choice(("", " ")) + run * (length // len(run)) + draw.choice(("", "!")) + text[at:]
    )


_ALL: tuple[Callable[[str, random.Random], str], ...] = (
    replace_number,
    replace_number,
    replace_number,
    replace_word,
    move_lines,
    move_lines,
    insert_line,
    change_line_ends,
    insert_brackets,
    lengthen_line,
)


def damage_text(data: bytes, draw: random.Random) -> bytes:
    """Apply one random damage to a text file."""
    text = data.decode("utf-8", "surrogateescape")
    return draw.choice(_ALL)(text, draw).encode("utf-8", "surrogateescape")


def _replace_match(pattern: re.Pattern[str], text: str, draw: random.Random) -> str:
    found = list(pattern.finditer(text))
    if not found:
        return text + draw.choice(WORDS)
    # Counts and versions are at the start; without this, lists of coordinates would get most damage.
    one = draw.choice(found[:12] if draw.random() < 0.4 else found)
    return text[: one.start()] + draw.choice(WORDS) + text[one.end() :]
