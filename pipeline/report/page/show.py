"""A mesh as a page that a notebook shows in place, and that can be kept as a file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from scanloom.pipeline.report.page.packing import Shown, packed_page
from scanloom.stages.diagnostics.codes import USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import MeshError, UsageError
from scanloom.stages.files.replacing import replacing
from scanloom.stages.picturing.codes import RENDER_NOTHING_TO_DRAW
from scanloom.stages.printing import line
from scanloom.stages.surface.convert import MeshLike, as_mesh
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.upright import direction_of

# What a page takes without any model, and a little for one.
_LEAST_MB = 1.2


@dataclass(frozen=True, eq=False, kw_only=True)
class Page:
    """A page of one file, which asks for nothing from anywhere; a notebook shows it as it is.

    Attributes
    ----------
    title : of the page.
    html : the file.
    width, height : of its frame in a notebook: in CSS, and pixels.
    diagnostics : what was left out to keep it small.
    """

    title: str
    html: bytes
    width: str
    height: int
    diagnostics: tuple[Diagnostic, ...] = ()

    def __repr__(self) -> str:
        size = f"{len(self.html) / 1e6:.1f} MB"
        return line(self, (self.title, size, "shows itself in a notebook", 'else save("FILE.html")'))

    def _repr_html_(self) -> str:
        # A page of its own inside of the notebook's, which cannot get at anything there.
        return (
            f'<iframe title="{escape(self.title)}" sandbox="allow-scripts" '
            f'style="width:{escape(self.width)};height:{self.height}px;border:0" '
            f'srcdoc="{escape(self.html.decode())}"></iframe>'
        )

    def save(self, path: Path | str) -> None:
        """Write the page to a file, `.html` by custom, which opens in any browser without a network.

        Raises
        ------
        StageError
            If the system refuses to write.
        """
        with replacing(Path(path)) as draft:
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
    """Return a page that turns a mesh, measures it and cuts it open, for a notebook or as a file.

    A function, not a method of meshes: to make the page takes rooms that know what a mesh is.

    Parameters
    ----------
    thing : Mesh, Open3D or trimesh mesh, (vertices, triangles), or a result that has a `mesh`.
    beside : others by their names, in the same place, to look at left of a line that is dragged.
    title : what the page calls it.
    up : what is up, an axis (+x, -x, +y, -y, +z, -z) or three numbers; that of the mesh if not given.
    width, height : of the frame, in CSS and pixels.
    page_size : megabytes that the page may take in the notebook's file; models are made lighter for it.

    Raises
    ------
    MeshError
        For what is no mesh, or has no triangles.
    UsageError
        If `up` is no direction, or a size is too small.
    """
    if page_size < _LEAST_MB:
        raise UsageError(
            USAGE_VALUE_INVALID,
            "page_size is {page_size:g} MB; it must be at least {least_mb:g} MB.",
            page_size=page_size,
            least_mb=_LEAST_MB,
        )
    if height < 1:
        raise UsageError(
            USAGE_VALUE_INVALID, "height is {height} px; it must be at least 1 px.", height=height
        )
    given = {title: thing, **(beside or {})}
    with collecting() as diagnostics:
        meshes = {name: _mesh_of(one, name) for name, one in given.items()}
        stands = meshes[title].up if up is None else _direction(up)
        shown = {name: Shown(mesh.with_(up=stands)) for name, mesh in meshes.items()}
        html = packed_page(title, shown, int(1e6 * page_size))
    return Page(title=title, html=html, width=width, height=height, diagnostics=tuple(diagnostics))


def _mesh_of(thing: Any, name: str) -> Mesh:
    own = getattr(thing, "mesh", None)
    mesh = as_mesh(own if isinstance(own, Mesh) else thing, name)
    if not len(mesh.triangles):
        raise MeshError(RENDER_NOTHING_TO_DRAW, "there are no triangles to show.", name)
    return mesh


def _direction(up: str) -> tuple[float, float, float] | None:
    direction = direction_of(up)
    if direction is None:
        return None
    x, y, z = direction.tolist()
    return x, y, z
