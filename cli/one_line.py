"""What a person reads on stderr is one line a message, whatever a file is called."""

from __future__ import annotations

import re

# Controls, among them the line breaks and what begins a terminal's commands, and Unicode's own line breaks.
_CONTROLS = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029]")


def one_line(text: str) -> str:
    r"""Return text with its controls written out, a line break as \n."""
    return _CONTROLS.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), text.rstrip())
