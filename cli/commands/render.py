"""The command `render`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from scanloom import stages
from scanloom.cli.mesh_arguments import read_file
from scanloom.cli.options import Changes
from scanloom.cli.output import Output
from scanloom.cli.paths import require_new_file
from scanloom.cli.scan_argument import read_scan
from scanloom.stages import Frame, Mesh, ScanParams, UsageError, Viewpoint
from scanloom.stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT, USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.params import check, param
from scanloom.stages.picturing.codes import RENDER_NOTHING_TO_DRAW
from scanloom.stages.picturing.lettering import ScaleBar
from scanloom.stages.picturing.panels import Panels
from scanloom.stages.picturing.render import write_png
from scanloom.stages.picturing.turntable import turntable
from scanloom.stages.picturing.video import CODECS, write_video
from scanloom.stages.picturing.viewpoints import looking_at, up_or_own
from scanloom.stages.progress import Progress
from scanloom.stages.scans.model.prefetch import read_ahead, workers
from scanloom.stages.scans.model.scan import ColorImage
from scanloom.stages.surface.upright import direction_of

_PICTURE, _VIDEO = ".png", ".mp4"
_SUFFIXES = (_PICTURE, _VIDEO)
_FIELD = 40.0
Point = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class PictureParams:
    """How a picture of a mesh is taken."""

    viewpoint: int = param(1, "Which of the viewpoints around the mesh, counted from 1.", low=1, high=8)
    width: int = param(
        1200, "Width of the picture; of each, if there are several.", unit="px", low=16, high=8192
    )
    height: int | None = param(
        None,
        "Height of the picture; by default it is 4:3, or has the shape of the scan's camera.",
        unit="px",
        low=16,
        high=8192,
    )
    shading: str = param(
        "color",
        "Colours under a soft light, colours as they are, plain clay that shows the shape, or clay with the "
        "edges of the triangles.",
        choices=("color", "unlit", "plain", "edges"),
    )
    up: str | None = param(
        None,
        "What is up in the mesh: an axis (+x, -x, +y, -y, +z, -z), or a direction as three numbers. By "
        "default what its file says, else +y.",
    )
    inside: bool = param(
        False, "Leave out triangles that are seen from behind, so that one looks into a room."
    )
    labels: bool | None = param(
        None,
        "Write the file's name and its triangles into each picture; by default, if there are several.",
    )
    scale_bar: bool = param(
        False,
        "Draw a bar of a round length, in metres as the mesh is. It holds at the distance that stands beside "
        "it, of what is in the middle of the picture: nearer things are drawn larger.",
    )

    def __post_init__(self) -> None:
        check(self)
        if self.up == "none":
            raise UsageError(
                USAGE_VALUE_INVALID, "up is none, but a picture has an upper side", remedy="give an axis."
            )
        if self.up is not None:
            direction_of(self.up)


@dataclass(frozen=True, kw_only=True)
class TurntableParams:
    """How a video goes once around a mesh."""

    frames: int = param(180, "Pictures of a video, for one turn.", low=2, high=10_000)
    fps: float = param(24.0, "Pictures a second.", low=1, high=240)
    elevation: float = param(25.0, "From how far above a video looks down.", unit="degrees", low=-89, high=89)
    codec: str = param(
        "mpeg4",
        "How a video is encoded: MPEG-4 is known to players and presentations, VP9 to browsers.",
        choices=tuple(CODECS),
    )

    def __post_init__(self) -> None:
        check(self)


def render(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="IN... OUT",
            help="Mesh files, and the picture (.png) or the video (.mp4), once around, to write. Several "
            "meshes are drawn beside one another, from where the first is looked at.",
            show_default=False,
        ),
    ],
    params: PictureParams,
    reading: ScanParams,
    video: Changes[TurntableParams],
    out: Output,
    scan: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER", help="Scan the mesh was made from: look from its cameras.", show_default=False
        ),
    ] = None,
    eye: Annotated[
        Point | None,
        typer.Option(metavar="X Y Z", help="Look from here, in m; asks for --look.", show_default=False),
    ] = None,
    look: Annotated[
        Point | None,
        typer.Option(metavar="X Y Z", help="What is in the middle of the picture, in m.", show_default=False),
    ] = None,
    field: Annotated[
        float | None,
        typer.Option(
            metavar="DEGREES",
            help="The angle that the height of the picture spans, with --eye; 40 if not given.",
            show_default=False,
        ),
    ] = None,
    label: Annotated[
        list[str] | None,
        typer.Option(
            metavar="TEXT", help="Words for a picture, once for each mesh, in order.", show_default=False
        ),
    ] = None,
) -> None:
    """Draw a mesh, or several side by side, as a picture or a video, without a window or a GPU.

    Example: scanloom render clean.ply simplified.ply both.png --shading edges --scale-bar
    """
    *sources, target = files
    if not sources:
        raise UsageError(
            RENDER_NOTHING_TO_DRAW, "give one or more mesh files, and last the picture or the video to write."
        )
    require_new_file(target, _SUFFIXES)
    is_video = target.suffix.lower() == _VIDEO
    free = _free_view(eye, look)
    _require_effect(
        params, video, field, is_video=is_video, has_scan=scan is not None, is_free=free is not None
    )
    if scan is None and reading != ScanParams():
        raise UsageError(
            USAGE_OPTIONS_CONFLICT,
            "how to read a scan is said, but no scan is given",
            remedy="name it with --scan.",
        )
    frames = read_scan(scan, reading).frames if scan is not None else ()
    meshes = [read_file(source) for source in sources]
    texts = _texts(sources, meshes, params, label)
    if is_video:
        views = _around(meshes[0], params, TurntableParams(**video))
    elif free is not None:
        size = (params.width, params.height or round(params.width * 3 / 4))
        view = looking_at(*free, up_or_own(meshes[0], _up(params)), *size, field=field or _FIELD)
        views = [replace(view, cull=params.inside)]
    else:
        views = [_chosen(meshes[0], params, frames)]
    panels = Panels(meshes, texts)
    bar = panels.scale_bar(views[0]) if params.scale_bar else None
    if params.scale_bar and bar is None:
        emit(RENDER_NOTHING_TO_DRAW.warning("there is no scale bar: nothing is seen in the picture"))
    target.parent.mkdir(parents=True, exist_ok=True)
    figures: dict[str, Any] = {"output": str(target), "viewpoint": views[0].name}
    camera, shading = views[0].camera, params.shading
    if is_video:
        _write_video(target, panels, views, shading, bar, TurntableParams(**video), out)
        figures |= {"frames": len(views)}
    else:
        write_png(target, panels.draw(views[0], shading, bar))  # type: ignore[arg-type]
    figures |= {"width_px": camera.width, "height_px": camera.height}
    if bar is not None:
        figures |= {"scale_bar_m": bar.length, "scale_bar_at_m": bar.depth}
    out.result(figures)


def _free_view(eye: Point | None, look: Point | None) -> tuple[Point, Point] | None:
    if (eye is None) != (look is None):
        raise UsageError(USAGE_OPTIONS_CONFLICT, "a free view needs both --eye and --look.")
    return None if eye is None or look is None else (eye, look)


def _require_effect(
    params: PictureParams,
    video: Mapping[str, Any],
    field: float | None,
    *,
    is_video: bool,
    has_scan: bool,
    is_free: bool,
) -> None:
    """Refuse what would have no effect on what is asked for."""
    if video and not is_video:
        named = ", ".join(f"--{name}" for name in video)
        raise UsageError(
            USAGE_OPTIONS_CONFLICT,
            "{named} is of videos",
            remedy="name an OUT that ends in {video}.",
            named=named,
            video=_VIDEO,
        )
    if is_video and (has_scan or is_free or params.viewpoint != 1):
        raise UsageError(
            USAGE_OPTIONS_CONFLICT,
            "a video goes once around: leave out --viewpoint, --scan, --eye and --look.",
        )
    if is_free and (has_scan or params.viewpoint != 1):
        raise UsageError(
            USAGE_OPTIONS_CONFLICT,
            "--eye and --look say where to look from: leave out --viewpoint and --scan.",
        )
    if field is not None and not is_free:
        raise UsageError(USAGE_OPTIONS_CONFLICT, "--field is of a free view", remedy="give --eye and --look.")
    if has_scan and (params.height is not None or params.up is not None):
        raise UsageError(
            USAGE_OPTIONS_CONFLICT, "--scan has cameras of its own: leave out --height and --up."
        )
    sizes = [params.width, params.height or 0]
    if is_video and any(size % 2 for size in sizes):
        raise UsageError(USAGE_VALUE_INVALID, "a video has an even width and height.")


def _texts(
    sources: Sequence[Path], meshes: Sequence[Mesh], params: PictureParams, given: Sequence[str] | None
) -> list[str]:
    """Return the words for each picture: those given, or else what its file is."""
    if given:
        if len(given) != len(meshes):
            raise UsageError(
                USAGE_OPTIONS_CONFLICT,
                "--label is given {given_count} times for {meshes_count} meshes",
                remedy="give one for each.",
                given_count=len(given),
                meshes_count=len(meshes),
            )
        return list(given)
    wanted = len(meshes) > 1 if params.labels is None else params.labels
    return [
        f"{source.name} · {len(mesh.triangles):,} triangles" if wanted else ""
        for source, mesh in zip(sources, meshes, strict=True)
    ]


def _up(params: PictureParams) -> list[float] | None:
    direction = None if params.up is None else direction_of(params.up)
    return None if direction is None else direction.tolist()


def _chosen(mesh: Mesh, params: PictureParams, frames: Sequence[Frame]) -> Viewpoint:
    around = stages.viewpoints(
        mesh,
        max(params.viewpoint, 4),
        frames=frames,
        width=params.width,
        height=params.height,
        up=_up(params),
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


def _around(mesh: Mesh, params: PictureParams, turning: TurntableParams) -> Sequence[Viewpoint]:
    return turntable(
        mesh,
        turning.frames,
        width=params.width,
        height=params.height or 2 * round(params.width * 3 / 8),
        up=_up(params),
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
    def told(progress: Progress) -> Iterator[ColorImage]:
        images = read_ahead(
            lambda view: panels.draw(view, shading, bar), views, threads=workers(), ahead=2 * workers()
        )
        for number, image in enumerate(images, 1):
            yield image
            progress(number, len(views))

    with out.progress("render", "frames") as progress:
        write_video(target, told(progress), turning.fps, turning.codec)
