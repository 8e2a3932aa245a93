"""Relocation of a wheel's packages into the package `scanloom`.

The sources have `stages/`, `pipeline/` and `cli/` at the top level. In site-packages such names would clash
with modules of users, and maturin cannot rename packages. Therefore the packages are moved in the finished
wheel.

`python packaging/one_package.py FOLDER WHEEL...` writes changed copies of wheels that maturin built.
"""

from __future__ import annotations

import csv
import io
import sys
import zipfile
from pathlib import Path

PACKAGE = "scanloom"


def move_packages(wheel: bytes) -> bytes:
    """Move all packages of a wheel into `scanloom`; return the new wheel."""
    written = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(wheel)) as old, zipfile.ZipFile(written, "w") as new:
        for entry in old.infolist():
            content = old.read(entry)
            if entry.filename.endswith(".dist-info/RECORD"):
                content = rename_record(content)
            entry.filename = rename_path(entry.filename)
            new.writestr(entry, content)
    return written.getvalue()


def rename_record(record: bytes) -> bytes:
    """Rename the paths in a wheel's RECORD."""
    written = io.StringIO()
    rows = csv.reader(io.StringIO(record.decode()))
    csv.writer(written, lineterminator="\n").writerows([rename_path(name), *rest] for name, *rest in rows)
    return written.getvalue().encode()


def rename_path(name: str) -> str:
    """Return the new path of a file in the wheel."""
    top = name.partition("/")[0]
    if top.endswith(".libs"):
        raise SystemExit(f"{name}: cannot move this library, because the kernels load it by a relative path.")
    return name if top == PACKAGE or top.endswith((".dist-info", ".data")) else f"{PACKAGE}/{name}"


def main() -> None:
    """Write changed copies of wheels."""
    folder, *wheels = map(Path, sys.argv[1:])
    folder.mkdir(parents=True, exist_ok=True)
    for wheel in wheels:
        (folder / wheel.name).write_bytes(move_packages(wheel.read_bytes()))


if __name__ == "__main__":
    main()
