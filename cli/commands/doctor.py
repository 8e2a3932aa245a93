"""Command `doctor`."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from scanloom.cli.output import Output, format_size, format_table
from scanloom.cli.paths import require_new_file
from scanloom.pipeline.report.file_names import REPORT
from scanloom.stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.files.atomic_files import write_file_atomically
from scanloom.stages.files.codes import FILE_PATH_INVALID
from scanloom.stages.files.input_files import read_input_text
from scanloom.stages.inspecting.machine_report import describe_machine


def doctor(
    out: Output,
    bundle: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Zip file for a bug report: this and report.json of a run, without images or meshes. Your "
            "home folder is written as ~.",
            show_default=False,
        ),
    ] = None,
    of_run: Annotated[
        Path | None,
        typer.Option(
            "--run", metavar="OUT", help="Output folder of the run for --bundle.", show_default=False
        ),
    ] = None,
) -> None:
    """Print versions, hardware and extras for a bug report.

    Example: scanloom doctor --bundle report.zip --run my_mesh
    """
    found = describe_machine()
    if bundle is None:
        if of_run is not None:
            raise UsageError(USAGE_OPTIONS_CONFLICT, "--run needs --bundle: it names the run to include.")
    else:
        require_new_file(bundle, (".zip",))
        _write(bundle, found, of_run)
        out.remark(f"{bundle}: check the content before you send it")
    out.result(found, None if out.as_json else _text(found))


def _write(path: Path, found: Mapping[str, Any], of_run: Path | None) -> None:
    texts = {"doctor.json": json.dumps(found, indent=1)}
    if of_run is not None:
        report = of_run / REPORT
        if not report.is_file():
            raise InputError(
                FILE_PATH_INVALID,
                "contains no {report}",
                of_run,
                remedy="give the output folder of a run.",
                report=REPORT,
            )
        texts[REPORT] = read_input_text(report, "utf-8")
    path.parent.mkdir(parents=True, exist_ok=True)
    home = str(Path.home())
    # Plain, and escaped as in JSON: backslashes of Windows paths and non-ASCII characters differ.
    homes = dict.fromkeys((json.dumps(home)[1:-1], json.dumps(home, ensure_ascii=False)[1:-1], home))
    with write_file_atomically(path) as draft, zipfile.ZipFile(draft, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, text in texts.items():
            # A home of "/" would make every path start with ~.
            for written in homes if len(home) > 1 else ():
                text = text.replace(written, "~")
            packed.writestr(name, text)


def _text(found: Mapping[str, Any]) -> str:
    rows = [["", ""]]
    for name, value in found.items():
        if name == "platform_notes":
            continue
        if isinstance(value, dict):
            rows += [[key, "not installed" if version is None else version] for key, version in value.items()]
        elif value is None:
            rows.append([name.removesuffix("_bytes").replace("_", " "), "unknown"])
        elif name.endswith("_bytes"):
            rows.append([name.removesuffix("_bytes").replace("_", " "), format_size(value)])
        else:
            words = ", ".join(value) if isinstance(value, list) else str(value)
            rows.append([name.replace("_", " "), words])
    return "\n".join([format_table(rows), *(f"note: {sentence}" for sentence in found["platform_notes"])])
