"""Pictures of depth, in colours, which programs leave beside depth maps under names like theirs."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.images import read_stored
from scanloom.stages.files.noting import only_looking


def without_pictures(depths: Sequence[Path]) -> list[Path]:
    """Return the files of a stream of depth that are not pictures of it, in the same order.

    Parameters
    ----------
    depths : where their names, numbers aside, are of several kinds, one of each kind is read.
    """
    kinds = defaultdict(list)
    for path in depths:
        kinds[re.sub(r"\d+", "#", path.stem)].append(path)
    if len(kinds) < 2:
        return list(depths)
    with only_looking():
        pictures = {kind for kind, files in kinds.items() if _is_picture(files[len(files) // 2])}
    if len(pictures) == len(kinds):
        # Whoever reads them tells what they are.
        return list(depths)
    return [path for path in depths if re.sub(r"\d+", "#", path.stem) not in pictures]


def _is_picture(path: Path) -> bool:
    try:
        return read_stored(path).ndim > 2
    except InputError:
        return False
