"""Move the packages of a wheel into the package `scanloom`.

The sources have `stages/`, `pipeline/` and `cli/` at the top. In site-packages such plain names would clash
with modules of users, and maturin cannot rename packages. So the packages move in the finished wheel.

`python packaging/one_package.py FOLDER WHEEL...` takes wheels that maturin built, and writes changed copies.
"""

from __future__ import annotations

import csv
import io
import sys
import zipfile
from pathlib import Path

PACKAGE = "scanloom"


def in_one_package(wheel: bytes) -> bytes:
    """Return a wheel whose only top-level package is `scanloom`."""
    written = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(wheel)) as old, zipfile.ZipFile(written, "w") as new:
        for entry in old.infolist():
            content = old.read(entry)
            if entry.filename.endswith(".dist-info/RECORD"):
                content = renamed_record(content)
            entry.filename = renamed(entry.filename)
            new.writestr(entry, content)
    return written.getvalue()


def renamed_record(record: bytes) -> bytes:
    """Return the list of files of a wheel with the new names."""
    written = io.StringIO()
    rows = csv.reader(io.StringIO(record.decode()))
    csv.writer(written, lineterminator="\n").writerows([renamed(name), *rest] for name, *rest in rows)
    return written.getvalue().encode()


def renamed(name: str) -> str:
    """Return the new name of a file of the wheel."""
    top = name.partition("/")[0]
    if top.endswith(".libs"):
        raise SystemExit(f"{name}: the kernels load this library by a relative path, which would be wrong.")
    return name if top == PACKAGE or top.endswith((".dist-info", ".data")) else f"{PACKAGE}/{name}"


def main() -> None:
    """Write changed copies of wheels."""
    folder, *wheels = map(Path, sys.argv[1:])
    folder.mkdir(parents=True, exist_ok=True)
    for wheel in wheels:
        (folder / wheel.name).write_bytes(in_one_package(wheel.read_bytes()))


if __name__ == "__main__":
    main()
