"""Cases for readers: a specimen with one or two damages, to a file or to the folder as a whole."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

from tests.campaign.damage import damage_file
from tests.campaign.folder_damage import damage_folder
from tests.campaign.specimens import SPECIMENS

# Images are damaged rarely, because most images of a scan are alike, and few readers decode them.
_SELDOM = (".png", ".jpg")


def make_reader_case(seed: int, specimens: Path) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Make a case and its files by name, from the specimens in a folder."""
    draw = random.Random(seed)
    name = draw.choice(list(SPECIMENS))
    own = specimens / name
    files = {
        path.relative_to(own).as_posix(): path.read_bytes()
        for path in sorted(own.rglob("*"))
        if path.is_file()
    }
    for _ in range(draw.choice((1, 1, 1, 2))):
        if files and draw.random() < 0.2:
            files = damage_folder(files, draw)
            continue
        names = [n for n in files if not n.endswith(_SELDOM)]
        if len(names) < len(files) and draw.random() < 0.15:
            names = [n for n in files if n.endswith(_SELDOM)]
        if not names:
            break
        hit = draw.choice(names)
        files[hit] = damage_file(files[hit], draw)
    specimen = SPECIMENS[name]
    case = {"kind": "readers", "seed": seed, "specimen": name, "reader": specimen.reader}
    return {**case, "target": specimen.target}, files


def write_files(files: dict[str, bytes], folder: Path) -> None:
    """Write the files of a case into a folder."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
