"""Posed views without depth, in layouts of which these are not read yet."""

from __future__ import annotations

from pathlib import Path

from stages.errors import InputError


def without_depth(place: Path, advice: str) -> InputError:
    """Return the error for a folder (or its list of frames) whose posed views have no depth maps.

    Parameters
    ----------
    place : what the message names.
    advice : a sentence: where this layout would keep its depth.
    """
    return InputError(
        f"its views have no depth, and views of this layout alone cannot be read yet. {advice}", place
    )
