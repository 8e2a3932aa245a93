"""Codes of the diagnostics of pictures and pages, with explanations."""

from __future__ import annotations

from stages.diagnostics.diagnostic import Code

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
The page is made of what lies in OUT. If something there is missing or changed, run again: what is cached
is only
placed. Photos and triangles are left out until the page fits `report.page_size`. A clean mesh of more than 5
million triangles is shown coarsely, what lies in a cell of a grid as one; for that the file must be as
the run wrote it.
""",
    "the page takes … bytes, more than …, as small as it gets.",
)
RENDER_LIBRARY_MISSING = Code(
    "render.library-missing",
    "Videos and plots",
    """
Not every build of OpenCV has every encoder: `--codec mpeg4` is in nearly all, and pictures always work.
Plots need `pip install
"scanloom[plot]"`.
""",
    "…: OpenCV has no encoder for … here; write pictures (.png).",
)
MACHINE_PORT_TAKEN = Code(
    "machine.port-taken",
    "A port that is taken",
    """
`scanloom view` listens on 127.0.0.1; without `--port` it takes any that is free.
""",
    "port … cannot be listened on: ….",
)
