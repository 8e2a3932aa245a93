"""Codes of the diagnostics of pictures and pages, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

RENDER_NOTHING_TO_DRAW = Code(
    "render.nothing-to-draw",
    "Nothing to draw",
    """
The mesh has no triangles. `render` takes the meshes first and the picture last.
""",
    "the mesh has no triangles; there is nothing to draw.",
)
REPORT_INCOMPLETE = Code(
    "report.incomplete",
    "The page of a run",
    """
The page is made of the files in OUT. If something there is missing or changed, run again: cached results
are only copied.
""",
    "out/photos/12.jpg: this photo is missing; run once more.",
)
REPORT_REDUCED = Code(
    "report.reduced",
    "A page that is larger than asked, or without some photos",
    """
A warning. Photos and triangles are left out until the page fits `report.page_size`. A larger size keeps
more; the complete result is a file of its own.
""",
    "40 of the photos are left out of the page, which may take 20,000,000 bytes.",
)
RENDER_ENCODER_MISSING = Code(
    "render.encoder-missing",
    "Encoders of videos that are missing",
    """
Not every build of OpenCV has every encoder: `turntable.codec=mpeg4` is in nearly all, and pictures always
work.
""",
    "turn.mp4: OpenCV has no encoder for vp9 here; write pictures (.png).",
)
MACHINE_PORT_TAKEN = Code(
    "machine.port-taken",
    "A port that is taken",
    """
`scanloom view` listens on 127.0.0.1; without `--port` it takes any that is free.
""",
    "port 8080 cannot be listened on: Address already in use.",
)
