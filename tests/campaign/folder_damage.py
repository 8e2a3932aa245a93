"""Damage to the files of a folder as a whole: exchanged, missing, renamed, doubled, in another encoding."""

from __future__ import annotations

import random
from pathlib import PurePosixPath

_ENCODINGS = ("utf-16", "utf-16-le", "utf-32", "utf-8-sig", "utf-7")
_NAMES = ("9" * 200, "-1", "nan", "1e400", ".hidden", " ", "<b>", "é")
_SUFFIXES = ("", ".txt", ".json", ".png", ".jpg", ".ply", ".npy", ".PNG", ".yaml")


def damage_folder(files: dict[str, bytes], draw: random.Random) -> dict[str, bytes]:
    """Return the files of a folder, by their names, with one damage to the folder.

    A file may become a folder of its name, with the file in it.
    """
    files = dict(files)
    name, other = draw.choice([*files]), draw.choice([*files])
    content = files[name]
    match draw.randrange(9):
        case 0:
            files[name], files[other] = files[other], content
        case 1:
            files[other] = content
        case 2:
            del files[name]
        case 3:
            files[name] = b""
        case 4:
            files[name] = content.decode("utf-8", "replace").encode(draw.choice(_ENCODINGS), "replace")
        case 5:
            del files[name]
            files[f"{name}/{PurePosixPath(other).name}"] = content
        case 6:
            files[_rename(name, draw)] = content
        case 7:
            del files[name]
            files[_rename(name, draw)] = content
        case _:
            files[name] = content + content
    folders = {str(parent) for one in files for parent in PurePosixPath(one).parents}
    return {one: content for one, content in files.items() if one not in folders}


def _rename(name: str, draw: random.Random) -> str:
    path = PurePosixPath(name)
    if draw.random() < 0.5:
        return str(path.with_name((draw.choice(_NAMES) + path.suffix).strip("/")))
    return str(path.with_name(path.stem + draw.choice(_SUFFIXES)))
