"""What a person reads on stderr is one line a message, whatever a file is called."""

from __future__ import annotations

import re

# Controls, among them the line breaks and what begins a terminal's commands, and Unicode's own line breaks.
_CONTROLS = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029]")


# What is longer quotes a damaged file.
_MOST = 2000


def one_line(text: str) -> str:
    r"""Return text as one line, controls written out (a line break as \n), without its middle if long."""
    line = _CONTROLS.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), text.rstrip())
    return line if len(line) <= _MOST else f"{line[: _MOST // 2]} … {line[-_MOST // 2 :]}"
