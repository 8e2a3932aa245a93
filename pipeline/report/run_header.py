"""Header of a run's page: facts of the result, and what each of them means."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.pipeline.artifacts.file_names import PICTURES
from scanloom.pipeline.report.page.page_header import (
    PageFact,
    describe_mesh,
    format_file_size,
    make_page_header,
)
from scanloom.pipeline.report.page.single_file_page import make_image_url
from scanloom.pipeline.report.report_summary import get_nested, get_surface_noise
from scanloom.stages.files.images import read_stored_image
from scanloom.stages.printing import format_count, format_upper_bound
from scanloom.stages.surface.mesh import Mesh

_MONTHS = (
    *("January", "February", "March", "April", "May", "June"),
    *("July", "August", "September", "October", "November", "December"),
)
# Size and JPEG quality of the picture; the page shows it at half of this size.
_PICTURE_WIDTH, _PICTURE_QUALITY = 304, 80


def make_run_header(
    file: Path,
    result: Mesh,
    rotation: NDArray[np.float64],
    report: Mapping[str, Any],
    warnings: Sequence[str],
    max_deviation: float | None,
) -> dict[str, Any]:
    """Make the header of a run's page; see `make_page_header`.

    Parameters
    ----------
    file, result : file of the result, and its mesh.
    rotation : (3, 3) rotation of the result to z up.
    report : content of report.json; empty without one.
    warnings : warnings of the run.
    max_deviation : largest sampled distance from the refined mesh in metres; None without deviations.
    """
    is_metric = get_nested(report, "scan", "metric", default=True)
    facts = [
        *describe_mesh(result, rotation, is_metric=is_metric),
        PageFact("File", format_file_size(file.stat().st_size), file.name),
        *_describe_accuracy(report, max_deviation, is_metric=is_metric),
    ]
    if report:
        link = "warnings" if warnings else ""
        facts.append(
            PageFact("Warnings", f"{len(warnings)}, listed below" if warnings else "none", link=link)
        )
    return make_page_header(facts, _describe_run(report), _read_picture(file))


def _describe_accuracy(
    report: Mapping[str, Any], max_deviation: float | None, *, is_metric: bool
) -> Iterator[PageFact]:
    factor, unit = (1000, "mm") if is_metric else (1, "units")
    noise = get_surface_noise(report)
    if noise is not None:
        yield PageFact(
            "Scan noise",
            f"{factor * noise:.2g} {unit}",
            "standard deviation of the surface; excludes scale and drift",
        )
    proven = get_nested(report, "stages", "simplify", "metrics", "details", "shape_bound_m")
    if proven is not None:
        yield PageFact(
            "Simplification error",
            f"≤ {format_upper_bound(factor * float(proven))} {unit}",
            "proven everywhere; distance from the mesh before simplification",
        )
    elif max_deviation is not None:
        yield PageFact(
            "Simplification error",
            f"{factor * max_deviation:.3g} {unit}",
            "largest of samples, not proven; distance from the mesh before simplification",
        )


def _describe_run(report: Mapping[str, Any]) -> str:
    """Describe input, date and program of a run."""
    frames, created, version = (
        get_nested(report, "scan", "frames"),
        report.get("created"),
        report.get("scanloom"),
    )
    parts = [format_count(int(frames or 0), "frame")]
    if created is not None:
        day = datetime.fromisoformat(str(created))
        parts.append(f"processed {day.day} {_MONTHS[day.month - 1]} {day.year}")
    if version is not None:
        parts.append(f"scanloom {version}")
    return " · ".join(filter(None, parts))


def _read_picture(file: Path) -> str | None:
    """Read the overview picture of a result; None if the run drew no pictures."""
    import cv2

    path = file.parent / PICTURES / f"{file.stem}-overview.png"
    if not path.is_file():
        return None
    image = read_stored_image(path)
    height, width = image.shape[:2]
    size = (_PICTURE_WIDTH, max(round(_PICTURE_WIDTH * height / width), 1))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return make_image_url(
        cv2.imencode(".jpg", small, (cv2.IMWRITE_JPEG_QUALITY, _PICTURE_QUALITY))[1].tobytes()
    )
