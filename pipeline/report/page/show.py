"""Page of a mesh for notebooks, which can be saved as a file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from scanloom.pipeline.report.page.packing import PageModelSource, compute_page_rotation, make_packed_page
from scanloom.pipeline.report.page.page_header import describe_mesh, make_page_header
from scanloom.stages.diagnostics.codes import USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import MeshError, UsageError
from scanloom.stages.files.atomic_files import write_file_atomically
from scanloom.stages.printing import format_line
from scanloom.stages.rendering.codes import RENDER_NOTHING_TO_DRAW
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_conversion import MeshLike, as_mesh
from scanloom.stages.surface.up_direction import parse_up_direction

# Minimum megabytes of a page: size without models, plus a small model.
_MIN_MB = 1.2


@dataclass(frozen=True, eq=False, kw_only=True)
class Page:
    """Self-contained HTML page that notebooks display inline.

    Attributes
    ----------
    title : page title.
    html : HTML file.
    width, height : size of the frame in a notebook: CSS length, and pixels.
    diagnostics : warnings, such as parts omitted to limit the size.
    """

    title: str
    html: bytes
    width: str
    height: int
    diagnostics: tuple[Diagnostic, ...] = ()

    def __repr__(self) -> str:
        size = f"{len(self.html) / 1e6:.1f} MB"
        return format_line(self, (self.title, size, "displayed in a notebook", 'or save("FILE.html")'))

    def _repr_html_(self) -> str:
        # A sandboxed iframe: the page cannot access the notebook. Downloads are for the buttons of the page.
        return (
            f'<iframe title="{escape(self.title)}" sandbox="allow-scripts allow-downloads" '
            f'style="width:{escape(self.width)};height:{self.height}px;border:0" '
            f'srcdoc="{escape(self.html.decode())}"></iframe>'
        )

    def save(self, path: Path | str) -> None:
        """Write the page to a file, which opens in any browser without a network.

        Raises
        ------
        StageError
            If the file cannot be written.
        """
        with write_file_atomically(Path(path)) as draft:
            draft.write_bytes(self.html)


def show(
    thing: MeshLike | Any,
    *,
    beside: Mapping[str, MeshLike | Any] | None = None,
    title: str = "mesh",
    up: str | None = None,
    width: str = "100%",
    height: int = 480,
    page_size: float = 3.0,
) -> Page:
    """Make an interactive page of a mesh, with rotation, measuring and cutting planes.

    This is a function instead of a method of `Mesh`, because the page depends on higher-level packages.

    Parameters
    ----------
    thing : Mesh, Open3D or trimesh mesh, (vertices, triangles), or a result with the attribute `mesh`.
    beside : further meshes by name, in the same frame, to compare with a movable divider.
    title : page title.
    up : up direction: an axis (+x, -x, +y, -y, +z, -z) or three numbers; None uses `mesh.up`.
    width, height : size of the frame in a notebook: CSS length, and pixels.
    page_size : maximum size of the page in megabytes; models are simplified to fit.

    Raises
    ------
    MeshError
        If the input is not a mesh, or has no triangles.
    UsageError
        If `up` is not a direction, or a size is too small.
    """
    if page_size < _MIN_MB:
        raise UsageError(
            USAGE_VALUE_INVALID,
            "page_size is {page_size:g} MB; it must be at least {least_mb:g} MB.",
            page_size=page_size,
            least_mb=_MIN_MB,
        )
    if height < 1:
        raise UsageError(
            USAGE_VALUE_INVALID, "height is {height} px; it must be at least 1 px.", height=height
        )
    models = {title: thing, **(beside or {})}
    with collecting() as diagnostics:
        meshes = {name: _get_mesh(one, name) for name, one in models.items()}
        page_up = meshes[title].up if up is None else _parse_direction(up)
        sources = {name: PageModelSource(mesh.with_(up=page_up)) for name, mesh in meshes.items()}
        mesh = sources[title].mesh
        header = make_page_header(describe_mesh(mesh, compute_page_rotation(mesh)))
        html = make_packed_page(title, sources, int(1e6 * page_size), {"header": header})
    return Page(title=title, html=html, width=width, height=height, diagnostics=tuple(diagnostics))


def _get_mesh(thing: Any, name: str) -> Mesh:
    own = getattr(thing, "mesh", None)
    mesh = as_mesh(own if isinstance(own, Mesh) else thing, name)
    if not len(mesh.triangles):
        raise MeshError(RENDER_NOTHING_TO_DRAW, "the mesh has no triangles.", name)
    return mesh


def _parse_direction(up: str) -> tuple[float, float, float] | None:
    direction = parse_up_direction(up)
    if direction is None:
        return None
    x, y, z = direction.tolist()
    return x, y, z
