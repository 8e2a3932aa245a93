"""Software renderer for meshes, without window, GPU or OpenGL.

Rays are cast by Open3D and shaded in NumPy.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from scanloom.stages._opencv import require_opencv
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.atomic_files import write_file_atomically
from scanloom.stages.rendering.codes import RENDER_NOTHING_TO_DRAW
from scanloom.stages.rendering.viewpoints import Viewpoint, viewpoints
from scanloom.stages.scans.model.scan import ColorImage
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_conversion import MeshLike, as_mesh
from scanloom.stages.surface.raycasting import Floats, RaycastingSurface, RayHits, iterate_chunks
from scanloom.stages.surface.surface_color import compute_surface_colors, has_color
from scanloom.stages.surface.topology import require_measurable
from scanloom.stages.surface.vertex_normals import compute_vertex_normals, interpolate_normals
from scanloom.stages.texturing.shading_normals import NormalMaps, has_normal_map

__all__ = ["RenderModel", "Shading", "Viewpoint", "render", "viewpoints", "write_png"]

Shading = Literal["color", "unlit", "plain", "edges"]
# float32 suffices for 8-bit images, and halves memory and time.
_Floats = NDArray[np.float32]

# Antialiasing: a pixel that differs from a neighbour by more than _CONTRAST levels becomes the mean of its
# centre ray and four more rays at these offsets, in pixels. The grid is rotated, so that no edge is aligned
# with it.
_ANTIALIASING_CONTRAST = 20
_ANTIALIASING_OFFSETS = np.array(((-3, -1), (-1, 3), (1, -3), (3, 1)), np.float32) / 8
_CLAY = np.array((214, 212, 207), np.float32)
_CLAY_BEHIND = np.array((150, 165, 190), np.float32)
_EDGE = np.array((38, 52, 74), np.float32)
# Cool grey: scans contain much white paper and many white walls, which must contrast with the background.
_BACKGROUND_TOP, _BACKGROUND_BOTTOM = np.array(((242, 244, 247), (212, 217, 224)), np.float32)
# Direction towards the light in camera axes: behind the viewer's left shoulder.
_LIGHT = np.array((-0.35, -0.55, -0.75)) / np.linalg.norm((-0.35, -0.55, -0.75))
# Relative offset at which a ray restarts behind a culled surface, and maximum number of culled surfaces.
_RESTART_OFFSET_RATIO = 1e-5
_MAX_CULLED = 16
# Minimum near-to-far depth ratio of a box for its projection. Closer boxes are treated as filling the image.
_MIN_DEPTH_RATIO = 1e-3
_TINY = np.finfo(np.float32).tiny


def render(mesh: MeshLike, viewpoint: Viewpoint, *, shading: Shading = "color") -> ColorImage:
    """Render a mesh from one viewpoint.

    Parameters
    ----------
    mesh : Mesh, Open3D or trimesh mesh, or (vertices, triangles), in metres.
    viewpoint : see Viewpoint and `viewpoints`.
    shading : "color" for texture or vertex colours under soft light (clay without colours), "unlit" for
        colours without light, "plain" for clay, which shows the shape, "edges" for flat-shaded clay with
        triangle edges. In "plain" and "edges", back faces are bluish.

    Returns
    -------
    (h, w, 3) uint8 RGB, of the viewpoint's size, on a light background.

    Raises
    ------
    InputError
        If the mesh has no triangles.
    """
    mesh = as_mesh(mesh)
    require_measurable(mesh, "mesh")
    if len(mesh.triangles) == 0:
        raise InputError(RENDER_NOTHING_TO_DRAW, "the mesh has no triangles; there is nothing to draw.")
    return RenderModel(RaycastingSurface(mesh)).draw(viewpoint, shading)


def write_png(path: Path, image: ColorImage) -> None:
    """Write an RGB image as PNG, atomically.

    Raises
    ------
    StageError
        If the file cannot be written.
    """
    require_opencv()
    import cv2

    _, data = cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
    with write_file_atomically(Path(path)) as part:
        part.write_bytes(data.tobytes())


class RenderModel:
    """Surface prepared for rendering from any number of viewpoints.

    Parameters
    ----------
    surface : of a mesh with at least one triangle.
    normals : (n, 3) float32 vertex normals, for a chunk of a larger surface; computed from the mesh by
        default.
    """

    def __init__(self, surface: RaycastingSurface, normals: _Floats | None = None) -> None:
        self.surface = surface
        self._normals = (
            compute_vertex_normals(surface.mesh).astype(np.float32) if normals is None else normals
        )
        self._is_colored = has_color(surface.mesh)
        self._normal_maps = NormalMaps(surface.mesh) if has_normal_map(surface.mesh) else None

    def replace_colors(self, mesh: Mesh) -> RenderModel:
        """Return the model with the colours of another mesh with the same vertices and triangles."""
        other = copy.copy(self)
        other.surface = self.surface.replace_mesh(mesh)
        other._is_colored = has_color(mesh)
        return other

    def draw(self, viewpoint: Viewpoint, shading: Shading = "color") -> ColorImage:
        """Render with one ray per pixel, and antialias where contrast is high; see `render`."""
        picture = RenderedPicture(viewpoint, shading)
        picture.add(self)
        picture.refine()
        picture.add(self)
        return picture.image()

    def measure_depths(self, viewpoint: Viewpoint, positions: NDArray[np.floating]) -> _Floats:
        """Return the surface depths at image positions.

        Parameters
        ----------
        positions : (k, 2) pixel coordinates.

        Returns
        -------
        (j,) depths in metres, only of positions that show the surface.
        """
        u, v = np.asarray(positions, np.float32).T
        depths_of_hits = [
            hits.distances for hits in self._cast_rays(viewpoint, _compute_ray_directions(viewpoint, u, v))
        ]
        return np.concatenate(depths_of_hits)

    def draw_on(self, canvas: Canvas, pixel_indices: NDArray[np.intp] | slice = slice(None)) -> None:
        """Draw the surface on a canvas with depth test, optionally at some pixels."""
        u, v = canvas.u[pixel_indices], canvas.v[pixel_indices]
        numbers = np.arange(len(canvas.u))[pixel_indices]
        for rows in iterate_chunks(len(u)):
            directions = _compute_ray_directions(canvas.viewpoint, u[rows], v[rows])
            for hits in self._cast_rays(canvas.viewpoint, directions):
                at = numbers[rows][hits.rays]
                is_nearer = hits.distances < canvas.depths[at]
                if not is_nearer.all():
                    hits, at = hits[is_nearer], at[is_nearer]
                canvas.levels[at] = self._shade_hits(hits, directions, canvas.viewpoint, canvas.shading)
                canvas.depths[at] = hits.distances

    def _cast_rays(self, viewpoint: Viewpoint, directions: _Floats) -> Iterator[RayHits]:
        """Yield the first hits of rays, with or without back-face culling."""
        origin = viewpoint.world_from_camera[:3, 3]
        hits = self.surface.cast_rays(origin, directions)
        if not viewpoint.cull:
            yield hits
            return
        # Continuing the rays is faster than building a second surface without the culled triangles.
        for _ in range(_MAX_CULLED):
            is_back_face = _dot(hits.normals, directions[hits.rays]) > 0
            yield hits[~is_back_face]
            rays, starts = (
                hits.rays[is_back_face],
                hits.distances[is_back_face] * np.float32(1 + _RESTART_OFFSET_RATIO),
            )
            if len(rays) == 0:
                break
            hits = self.surface.cast_rays(origin, directions[rays], starts)
            hits = replace(hits, rays=rays[hits.rays])

    def _compute_normals(self, hits: RayHits, corners: NDArray[np.int32]) -> _Floats:
        """Compute shading normals: from normal maps, else interpolated within the smooth parts."""
        normals = interpolate_normals(self._normals, corners, hits.weights, hits.normals)
        if self._normal_maps is not None:
            self._normal_maps.apply(normals, hits.triangles, hits.weights)
        return normals

    def _shade_hits(
        self, hits: RayHits, directions: _Floats, viewpoint: Viewpoint, shading: Shading
    ) -> _Floats:
        mesh = self.surface.mesh
        corners = mesh.triangles.take(hits.triangles, axis=0)
        view_directions = _normalize(directions.take(hits.rays, axis=0))
        is_back_face = _dot(hits.normals, view_directions) > 0
        normals = hits.normals
        if shading != "edges":
            normals = self._compute_normals(hits, corners)
        normals = np.asarray(np.where(is_back_face[:, None], -normals, normals))
        to_light = np.asarray(viewpoint.world_from_camera[:3, :3] @ _LIGHT, np.float32)
        light = _dot(normals, to_light).clip(0, 1)
        headlight = np.abs(_dot(normals, view_directions))
        if shading in ("color", "unlit") and self._is_colored:
            colors = compute_surface_colors(mesh, hits.triangles, hits.weights)
            if shading == "unlit":
                return np.asarray(colors, np.float32)
            # Scanned colours already contain the room's light, so only a little shading is added.
            return np.asarray(colors * (0.84 + 0.12 * light + 0.12 * headlight)[:, None], np.float32)
        tint = np.where(is_back_face[:, None], _CLAY_BEHIND, _CLAY)
        clay = np.asarray(tint * (0.44 + 0.48 * light + 0.26 * headlight)[:, None], np.float32)
        if shading == "edges":
            # Relative to the camera, so that float32 is precise enough.
            origin = viewpoint.world_from_camera[:3, 3]
            relative_corners = [
                np.asarray(mesh.vertices.take(i, axis=0) - origin, np.float32) for i in corners.T
            ]
            line = _compute_edge_opacity(relative_corners, hits, viewpoint)[:, None]
            clay += line * (_EDGE - clay)
        return clay


class Canvas:
    """Colour and depth buffer for a set of image positions.

    Attributes
    ----------
    viewpoint, shading : parameters of the image.
    u, v : (k,) float32, pixel coordinates.
    levels : (k, 3) float32, 0 to 255.
    depths : (k,) float32, metres; infinite for the background.
    """

    def __init__(self, viewpoint: Viewpoint, shading: Shading, u: _Floats, v: _Floats) -> None:
        self.viewpoint, self.shading, self.u, self.v = viewpoint, shading, u, v
        down = ((v + np.float32(0.5)) / np.float32(viewpoint.camera.height))[:, None]
        self.levels: _Floats = _BACKGROUND_TOP + (_BACKGROUND_BOTTOM - _BACKGROUND_TOP) * down
        self.depths = np.full(len(u), np.inf, np.float32)


class RenderedPicture:
    """Image of one or more models.

    All models are added once, then once more after `refine`, which adds rays for antialiasing.
    """

    def __init__(self, viewpoint: Viewpoint, shading: Shading = "color") -> None:
        self.viewpoint = viewpoint
        v, u = np.indices((viewpoint.camera.height, viewpoint.camera.width), np.float32).reshape(2, -1)
        self._pixels = Canvas(viewpoint, shading, u, v)
        self._contrast_pixels = np.zeros(0, np.intp)
        self._extra_canvases: list[Canvas] = []

    def add(self, model: RenderModel, box: Floats | None = None) -> None:
        """Draw a model, optionally limited to its bounding box (2, 3), metres."""
        for canvas in self._extra_canvases or [self._pixels]:
            if box is None:
                model.draw_on(canvas)
            else:
                model.draw_on(canvas, _select_pixels(canvas, box))

    def refine(self) -> None:
        """Start the antialiasing pass at pixels with high contrast."""
        import cv2

        contrast = cv2.morphologyEx(self._get_levels(), cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
        is_rough = np.logical_or.reduce([channel > _ANTIALIASING_CONTRAST for channel in cv2.split(contrast)])
        self._contrast_pixels = np.flatnonzero(is_rough)  # silhouettes and fine patterns
        of = self._pixels
        u, v = of.u[self._contrast_pixels], of.v[self._contrast_pixels]
        self._extra_canvases = [
            Canvas(of.viewpoint, of.shading, u + du, v + dv) for du, dv in _ANTIALIASING_OFFSETS
        ]

    def image(self) -> ColorImage:
        """Return the image (h, w, 3) uint8, averaged over all rays."""
        levels = self._pixels.levels
        finer = levels[self._contrast_pixels]
        for canvas in self._extra_canvases:
            finer += canvas.levels
        levels[self._contrast_pixels] = finer / (1 + len(self._extra_canvases))
        return np.asarray(np.rint(self._get_levels()).clip(0, 255), np.uint8)

    def _get_levels(self) -> _Floats:
        return self._pixels.levels.reshape(self.viewpoint.camera.height, self.viewpoint.camera.width, 3)


def is_box_visible(viewpoint: Viewpoint, box: Floats) -> bool:
    """Return True if a box (2, 3) may be visible from a viewpoint."""
    u, v = _project_box(viewpoint, box)
    camera = viewpoint.camera
    return u[0] <= camera.width and u[1] >= -1 and v[0] <= camera.height and v[1] >= -1


def _select_pixels(canvas: Canvas, box: Floats) -> NDArray[np.intp]:
    """Return the canvas positions (j,) that may show a box (2, 3)."""
    u, v = _project_box(canvas.viewpoint, box)
    inside = (canvas.u >= u[0]) & (canvas.u <= u[1]) & (canvas.v >= v[0]) & (canvas.v <= v[1])
    return np.flatnonzero(inside)


def _project_box(viewpoint: Viewpoint, box: Floats) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the image rectangle of a box (2, 3), pixels.

    Returns
    -------
    Minimum and maximum of u, and of v.
    """
    corners = np.stack(np.meshgrid(*box.T), axis=-1).reshape(-1, 3)
    pose, camera = viewpoint.world_from_camera, viewpoint.camera
    x, y, z = ((corners - pose[:3, 3]) @ pose[:3, :3]).T
    everywhere = (-np.inf, np.inf)
    if z.max() <= 0:
        return (np.inf, -np.inf), everywhere
    if z.min() <= _MIN_DEPTH_RATIO * z.max():
        return everywhere, everywhere
    u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    # One pixel of margin for rounding errors.
    return (float(u.min()) - 1, float(u.max()) + 1), (float(v.min()) - 1, float(v.max()) + 1)


def _compute_ray_directions(viewpoint: Viewpoint, u: _Floats, v: _Floats) -> _Floats:
    """Return ray directions in the world through image positions, with unit depth."""
    camera = viewpoint.camera
    x_axis, y_axis, z_axis = viewpoint.world_from_camera[:3, :3].T.astype(np.float32)
    x = ((u - np.float32(camera.cx)) / np.float32(camera.fx))[:, None]
    y = ((v - np.float32(camera.cy)) / np.float32(camera.fy))[:, None]
    return np.asarray(x * x_axis + y * y_axis + z_axis)


def _compute_edge_opacity(corners: list[_Floats], hits: RayHits, viewpoint: Viewpoint) -> _Floats:
    """Compute the opacity of triangle edges at hits, 0 to 1.

    Parameters
    ----------
    corners : three arrays (k, 3), corners of the hit triangles.
    """
    a, b, c = corners
    ab, bc, ca = b - a, c - b, a - c
    pixel = hits.distances / np.float32(viewpoint.camera.fx)
    doubled_area = _dot(hits.normals, np.cross(ca, ab)) / pixel
    # Triangle heights in pixels; times a barycentric weight, they are distances from the opposite edge.
    heights = [doubled_area / np.maximum(np.sqrt(_dot(side, side)), _TINY) for side in (bc, ca, ab)]
    distances = [hits.weights[:, i] * heights[i] for i in range(3)]
    line = (np.float32(1.2) - np.minimum.reduce(distances)).clip(0, 1)
    # Fade edges of triangles that are only a few pixels high, which would otherwise become dark.
    return np.asarray(line * 0.75 * ((np.minimum.reduce(heights) - 1) / 6).clip(0.08, 1), np.float32)


def _interpolate(values: _Floats, corners: NDArray[np.int32], weights: _Floats) -> _Floats:
    """Interpolate vertex values (n, d) at points in triangles with vertices (k, 3)."""
    blended: _Floats = values.take(corners[:, 0], axis=0) * weights[:, :1]
    for i in (1, 2):
        blended += values.take(corners[:, i], axis=0) * weights[:, i : i + 1]
    return blended


def _dot(a: _Floats, b: _Floats) -> _Floats:
    return np.asarray(np.einsum("kx,kx->k" if b.ndim == 2 else "kx,x->k", a, b))


def _normalize(vectors: _Floats) -> _Floats:
    return np.asarray(vectors / np.maximum(np.sqrt(_dot(vectors, vectors)), _TINY)[:, None])
