"""Whether frames that were to be joined are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def unmet(figures: Mapping[str, Any]) -> tuple[str, ...]:
    """Return a sentence if the frames fall into pieces; a frame that is one of its own is only skipped.

    Parameters
    ----------
    figures : of the poses, as `Registration.figures` returns them.
    """
    if sum(size > 1 for size in figures["pieces"]) < 2:
        return ()
    # Said as a warning already: that of the pieces comes first.
    return tuple(figures["warnings"][:1])
