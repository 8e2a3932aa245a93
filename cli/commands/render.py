"""Command `render`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from scanloom import stages
from scanloom.cli.mesh_arguments import read_mesh_file
from scanloom.cli.options import SET_ONLY, Changes
from scanloom.cli.output import Output
from scanloom.cli.paths import require_new_file
from scanloom.cli.scan_argument import read_scan
from scanloom.stages import Frame, Mesh, ScanParams, UsageError, Viewpoint
from scanloom.stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT, USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.params import check_parameters, param
from scanloom.stages.progress import Progress
from scanloom.stages.rendering.annotations import ScaleBar
from scanloom.stages.rendering.codes import RENDER_NOTHING_TO_DRAW
from scanloom.stages.rendering.panels import Panels
from scanloom.stages.rendering.render import write_png
from scanloom.stages.rendering.turntable import choose_turntable_viewpoints as turntable_views
from scanloom.stages.rendering.video import CODECS, write_video
from scanloom.stages.rendering.viewpoints import look_at, resolve_up
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.scans.model.scan import ColorImage
from scanloom.stages.surface.up_direction import parse_up_direction

_PICTURE, _VIDEO = ".png", ".mp4"
_SUFFIXES = (_PICTURE, _VIDEO)
_FIELD_OF_VIEW = 40.0
Point = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class PictureParams:
    """Picture of a mesh."""

    viewpoint: int = param(
        1, "Index of the viewpoint around the mesh, counted from 1.", low=1, high=8, common=True
    )
    width: int = param(
        1200,
        "Width of the picture; of each, if there are several.",
        unit="px",
        low=16,
        high=8192,
        common=True,
    )
    height: int | None = param(
        None,
        "Height of the picture. Default: 3/4 of the width, or the aspect ratio of the scan's camera.",
        unit="px",
        low=16,
        high=8192,
    )
    shading: str = param(
        "color",
        "`color`: lit colours; `unlit`: colours as they are; `plain`: grey shape; `edges`: grey shape with "
        "the edges of the triangles.",
        choices=("color", "unlit", "plain", "edges"),
        common=True,
    )
    up: str | None = param(
        None,
        "Up axis of the mesh (+x, -x, +y, -y, +z, -z), or a direction as three numbers. Default: stated by "
        "the file, else +y.",
        common=True,
    )
    field_of_view: float | None = param(
        None,
        "Vertical angle of view with --eye. Default: 40.",
        unit="degrees",
        low=0,
        low_open=True,
        high=179,
    )
    inside: bool = param(False, "Hide triangles that face away, to look into a room.")
    labels: str = param(
        "auto",
        "Text in each picture: `files` (name and triangles), `off`, your own texts separated by `|`, or "
        "`auto`: files, if there are several.",
    )
    scale_bar: bool = param(
        False,
        "Draw a scale bar. Its length holds at the printed distance; nearer objects appear larger.",
        common=True,
    )

    def __post_init__(self) -> None:
        check_parameters(self)
        if self.up == "none":
            raise UsageError(
                USAGE_VALUE_INVALID,
                "is none, but a picture needs an up axis.",
                DiagnosticLocation(parameter="up"),
            )
        if self.up is not None:
            parse_up_direction(self.up)


@dataclass(frozen=True, kw_only=True)
class TurntableParams:
    """Video of a turntable."""

    frames: int = param(180, "Frames of one turn.", low=2, high=10_000)
    fps: float = param(24.0, "Frames per second.", low=1, high=240)
    elevation: float = param(25.0, "Elevation of the camera.", unit="degrees", low=-89, high=89)
    codec: str = param(
        "mpeg4",
        "Video codec: MPEG-4 for players and presentations, VP9 for browsers.",
        choices=tuple(CODECS),
    )

    def __post_init__(self) -> None:
        check_parameters(self)


def render(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="IN... OUT",
            help="Mesh files, then the picture (.png) or turntable video (.mp4) to write. Several meshes "
            "are drawn side by side, from the viewpoint of the first.",
            show_default=False,
        ),
    ],
    picture: PictureParams,
    scan: Annotated[ScanParams, SET_ONLY],
    turntable: Changes[TurntableParams],
    out: Output,
    scan_folder: Annotated[
        Path | None,
        typer.Option(
            "--scan", metavar="SCAN", help="Use the viewpoints of the scan's cameras.", show_default=False
        ),
    ] = None,
    eye: Annotated[
        Point | None,
        typer.Option(metavar="X Y Z", help="Position of the viewer, in m; needs --look.", show_default=False),
    ] = None,
    look: Annotated[
        Point | None,
        typer.Option(metavar="X Y Z", help="Point in the middle of the picture, in m.", show_default=False),
    ] = None,
) -> None:
    """Render meshes as a picture or a video.

    Needs no window and no GPU.

    Example: scanloom render clean.ply simplified.ply both.png --shading edges --scale-bar

    Example: scanloom render room.ply room.png --eye 0 0 1.5 --look 1 0 1.2 --set picture.inside=true

    Example: scanloom render model.glb turn.mp4 --set turntable.frames=120
    """
    *sources, target = files
    if not sources:
        raise UsageError(
            RENDER_NOTHING_TO_DRAW, "give one or more mesh files, then the picture or video to write."
        )
    require_new_file(target, _SUFFIXES)
    is_video = target.suffix.lower() == _VIDEO
    free = _free_view(eye, look)
    _require_effect(
        picture, turntable, is_video=is_video, has_scan=scan_folder is not None, is_free=free is not None
    )
    if scan_folder is None and scan != ScanParams():
        raise UsageError(
            USAGE_OPTIONS_CONFLICT, "parameters of scan need a scan", remedy="give its folder with --scan."
        )
    frames = () if scan_folder is None else read_scan(scan_folder, scan).frames
    meshes = [read_mesh_file(source) for source in sources]
    texts = _texts(sources, meshes, picture.labels)
    if is_video:
        views = _list_turntable_views(meshes[0], picture, TurntableParams(**turntable))
    elif free is not None:
        size = (picture.width, picture.height or round(picture.width * 3 / 4))
        angle = picture.field_of_view or _FIELD_OF_VIEW
        view = look_at(*free, resolve_up(meshes[0], _parse_up(picture)), *size, field=angle)
        views = [replace(view, cull=picture.inside)]
    else:
        views = [_choose_viewpoint(meshes[0], picture, frames)]
    panels = Panels(meshes, texts)
    bar = panels.choose_scale_bar(views[0]) if picture.scale_bar else None
    if picture.scale_bar and bar is None:
        emit(RENDER_NOTHING_TO_DRAW.warning("there is no scale bar, because the picture is empty."))
    target.parent.mkdir(parents=True, exist_ok=True)
    metrics: dict[str, Any] = {"output": str(target), "viewpoint": views[0].name}
    camera, shading = views[0].camera, picture.shading
    if is_video:
        _write_video(target, panels, views, shading, bar, TurntableParams(**turntable), out)
        metrics |= {"frames": len(views)}
    else:
        write_png(target, panels.draw(views[0], shading, bar))  # type: ignore[arg-type]
    metrics |= {"width_px": camera.width, "height_px": camera.height}
    if bar is not None:
        metrics |= {"scale_bar_m": bar.length, "scale_bar_at_m": bar.depth}
    out.result(metrics)


def _free_view(eye: Point | None, look: Point | None) -> tuple[Point, Point] | None:
    if (eye is None) != (look is None):
        raise UsageError(USAGE_OPTIONS_CONFLICT, "a viewpoint needs both --eye and --look.")
    return None if eye is None or look is None else (eye, look)


def _require_effect(
    params: PictureParams,
    video: Mapping[str, Any],
    *,
    is_video: bool,
    has_scan: bool,
    is_free: bool,
) -> None:
    """Refuse options that would have no effect."""
    if video and not is_video:
        named = ", ".join(f"turntable.{name}" for name in video)
        raise UsageError(
            USAGE_OPTIONS_CONFLICT,
            "{named} needs a video",
            remedy="name an OUT that ends in {video}.",
            named=named,
            video=_VIDEO,
        )
    if is_video and (has_scan or is_free or params.viewpoint != 1):
        raise UsageError(
            USAGE_OPTIONS_CONFLICT,
            "a video has no single viewpoint: omit --viewpoint, --scan, --eye and --look.",
        )
    if is_free and (has_scan or params.viewpoint != 1):
        raise UsageError(
            USAGE_OPTIONS_CONFLICT,
            "--eye and --look define the viewpoint: omit --viewpoint and --scan.",
        )
    if params.field_of_view is not None and not is_free:
        raise UsageError(USAGE_OPTIONS_CONFLICT, "picture.field_of_view needs --eye and --look.")
    if has_scan and (params.height is not None or params.up is not None):
        raise UsageError(
            USAGE_OPTIONS_CONFLICT, "the cameras of --scan have an up axis: omit picture.height and --up."
        )
    sizes = [params.width, params.height or 0]
    if is_video and any(size % 2 for size in sizes):
        raise UsageError(USAGE_VALUE_INVALID, "a video has an even width and height.")


def _texts(sources: Sequence[Path], meshes: Sequence[Mesh], labels: str) -> list[str]:
    """Return the text in each picture."""
    if labels == "off" or (labels == "auto" and len(meshes) == 1):
        return [""] * len(meshes)
    if labels in ("auto", "files"):
        return [
            f"{source.name} · {len(mesh.triangles):,} triangles"
            for source, mesh in zip(sources, meshes, strict=True)
        ]
    texts = [text.strip() for text in labels.split("|")]
    if len(texts) != len(meshes):
        raise UsageError(
            USAGE_OPTIONS_CONFLICT,
            "picture.labels has {texts} texts for {meshes} meshes",
            remedy="separate one text for each mesh by |.",
            texts=len(texts),
            meshes=len(meshes),
        )
    return texts


def _parse_up(params: PictureParams) -> list[float] | None:
    direction = None if params.up is None else parse_up_direction(params.up)
    return None if direction is None else direction.tolist()


def _choose_viewpoint(mesh: Mesh, params: PictureParams, frames: Sequence[Frame]) -> Viewpoint:
    around = stages.viewpoints(
        mesh,
        max(params.viewpoint, 4),
        frames=frames,
        width=params.width,
        height=params.height,
        up=_parse_up(params),
    )
    if params.viewpoint > len(around):
        raise UsageError(
            USAGE_VALUE_INVALID,
            "--viewpoint is {viewpoint}, but there are only {around_count} viewpoints.",
            viewpoint=params.viewpoint,
            around_count=len(around),
        )
    chosen = around[params.viewpoint - 1]
    return replace(chosen, cull=True) if params.inside else chosen


def _list_turntable_views(mesh: Mesh, params: PictureParams, turning: TurntableParams) -> Sequence[Viewpoint]:
    return turntable_views(
        mesh,
        turning.frames,
        width=params.width,
        height=params.height or 2 * round(params.width * 3 / 8),
        up=_parse_up(params),
        elevation=turning.elevation,
        cull=params.inside,
    )


def _write_video(
    target: Path,
    panels: Panels,
    views: Sequence[Viewpoint],
    shading: Any,
    bar: ScaleBar | None,
    turning: TurntableParams,
    out: Output,
) -> None:
    def draw(progress: Progress) -> Iterator[ColorImage]:
        images = map_ordered(
            lambda view: panels.draw(view, shading, bar),
            views,
            threads=get_worker_count(),
            max_pending=2 * get_worker_count(),
        )
        for number, image in enumerate(images, 1):
            yield image
            progress(number, len(views))

    with out.progress("render", "frames") as progress:
        write_video(target, draw(progress), turning.fps, turning.codec)
