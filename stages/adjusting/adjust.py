"""Adjustment: poses and the colour camera made better by points that several frames show and measure."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.adjusted import Adjusted, Transfer
from scanloom.stages.adjusting.anchor import Anchor, anchor_of
from scanloom.stages.adjusting.bundle import Bundle, bundle
from scanloom.stages.adjusting.cameras import FREE, STILL, Cameras, camera_of, motion_apart
from scanloom.stages.adjusting.codes import ADJUST_IMAGES_MISMATCH
from scanloom.stages.adjusting.key_frames import key_frames
from scanloom.stages.adjusting.look import Look, look, usable
from scanloom.stages.adjusting.matching import match
from scanloom.stages.adjusting.offset import Offset, Sight, offset, sights
from scanloom.stages.adjusting.partners import overlaps, partners
from scanloom.stages.adjusting.problem import Frees
from scanloom.stages.adjusting.resection import Placed, placed_between
from scanloom.stages.adjusting.view import (
    BLACK,
    OVER_EXPOSED,
    View,
    color_camera,
    exposure_of,
    has_one_camera,
    place_of_color,
    view_or_none,
)
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.params import check, param, resolve
from scanloom.stages.printing import counted
from scanloom.stages.progress import Progress, silent
from scanloom.stages.scans.model.prefetch import read_ahead, workers
from scanloom.stages.scans.model.scan import Frame, Scan, SkippedFrame

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import AdjustKeywords

RESULT_VERSION = 7

# Where outlines say that photos lie elsewhere, points may land farther from their matches by this share.
_NO_WORSE = 0.05
# Points of outlines that hold the colour camera.
_ANCHORS = 1000
# Colour and depth agree where points land this near, pixels: nothing is to be gained.
_GOOD_PX = 0.5
# What is found is taken where the median error falls by more than this share, and by more pixels than this.
_BETTER_SHARE, _BETTER_PX = 0.2, 0.3
# Views that are adjusted together; of longer scans, frames between them are placed to these.
_MOST_KEYS = 200
# Fewer observations leave a view where it was given.
_LEAST_SEEN = 12
# Parts that the adjustment itself is told to be done in, at most.
_PARTS = 5
# Poses that move by more than so many standard deviations are not the scan's.
_FAR = 8.0
# A turn that goes with a shift of a metre in the given poses, radians: 20 mm go with 0.6 degrees.
_TURN_PER_M = float(np.radians(30))


@dataclass(frozen=True, kw_only=True)
class AdjustParams:
    """How poses and the colour camera are adjusted."""

    enabled: bool | None = param(
        None,
        "Adjust poses and the colour camera: by default where frames have colour and depth; what is not "
        "better is not used.",
        # It decides whether the stage is there, not what comes out of it.
        invalidates=False,
    )
    camera: bool | None = param(
        None,
        "Look for one colour camera of the whole scan (focal length, centre, k1, its place beside the depth "
        "camera): by default used where it is clearly better than poses alone, and moved to where outlines "
        "of things say that photos are; true asks for it, false keeps the given one.",
    )
    shutter: bool | None = param(
        None,
        "Look for how cameras turn while the rows of their images are read (a rolling shutter): by default "
        "used where it is clearly better; true asks for it, false takes all rows as read at once.",
    )
    pose_deviation: float = param(
        0.02,
        "Standard deviation of the given poses, with 0.3° for each 10 mm.",
        unit="m",
        low=0,
        low_open=True,
    )

    def __post_init__(self) -> None:
        check(self)


def adjust(
    scan: Scan | Sequence[Frame],
    params: AdjustParams | None = None,
    *,
    progress: Progress = silent,
    **changes: Unpack[AdjustKeywords],
) -> Adjusted:
    """Make poses better, and the colour camera where that is wrong; what is not better is not used.

    Outlines of things say where photos lie beside the depth maps; where that is clearly elsewhere than the
    scan says, the colour camera is moved there. A few couples of frames say next whether more is to be
    gained. If so, points that three frames or more show are recognised, and poses, points and one colour
    camera are fitted to where they are seen and how deep they are measured (bundle adjustment), held to the
    poses given; so is how cameras turn while the rows of their images are read, where that leaves less. Every
    fifth point is held out: by these it is judged. Equal input gives equal bits, on any number of threads.

    Parameters
    ----------
    scan : frames with colour, depth and poses; others stay as they are.
    params : AdjustParams; single fields can be given by name instead.
    progress : called with steps of the work that are done, and their number.

    References
    ----------
    Triggs, McLauchlan, Hartley and Fitzgibbon, "Bundle adjustment – a modern synthesis", 2000; Hedborg,
    Forssén, Felsberg and Ringaby, "Rolling shutter bundle adjustment", 2012; Levinson and Thrun, "Automatic
    online calibration of cameras and lasers", 2013; features and fundamental matrices are OpenCV's, the
    sparse algebra SciPy's.
    """
    params = resolve(AdjustParams, params, changes)
    with collecting() as diagnostics:
        found = _looked_over(tuple(scan.frames if isinstance(scan, Scan) else scan), params, progress)
    return replace(found, diagnostics=tuple(diagnostics))


def _looked_over(frames: tuple[Frame, ...], params: AdjustParams, progress: Progress) -> Adjusted:
    """Adjust frames unless a few of them show that nothing is to be gained."""
    start = time.perf_counter()
    places = usable(frames)
    if len(places) < 2:
        begun = _Begun(frames, frames, (), None, start)
        why = "fewer than two frames have colour, depth and a pose"
        return _left(begun, why, (), None)
    seen = look(frames, places)
    if seen.trouble:
        if seen.is_of_another:
            _report_mismatch(seen.trouble)
        begun = _Begun(frames, frames, (), None, start)
        return _left(begun, seen.trouble, seen.skipped, None)
    before = Transfer.of(seen.errors)
    begun, seen = _moved_to_outlines(frames, places, seen, params, start)
    if seen.median < _GOOD_PX:
        why = f"colour, depth and poses agree to {seen.median:.2f} px already"
        return _left(begun, why, seen.skipped, before)
    return _adjusted(begun, places, seen, params, progress)


@dataclass(frozen=True, eq=False)
class _Begun:
    """What there is before poses are adjusted.

    Attributes
    ----------
    given : the frames of the scan.
    frames : these, with the colour camera where outlines say that it is, if that is elsewhere.
    sights : the outlines of some frames; none where the colour camera is to stay.
    offset : what they say of the given camera.
    start : of the work, seconds.
    """

    given: tuple[Frame, ...]
    frames: tuple[Frame, ...]
    sights: Sequence[Sight]
    offset: Offset | None
    start: float

    @property
    def has_camera(self) -> bool:
        """Say whether the colour camera is another one."""
        return self.frames is not self.given

    def offset_after(self, frame: Frame) -> Offset | None:
        """Return what outlines say of the colour camera of a frame."""
        return offset(self.sights, color_camera(frame), place_of_color(frame))


def _moved_to_outlines(
    frames: tuple[Frame, ...], places: Sequence[int], seen: Look, params: AdjustParams, start: float
) -> tuple[_Begun, Look]:
    """Move the colour camera where outlines clearly say so; return that, and what frames then show."""
    first = frames[places[0]]
    may_move = params.camera is not False and has_one_camera([frames[place] for place in places])
    shown = sights(frames, places) if may_move else []
    found = offset(shown, color_camera(first), place_of_color(first))
    as_given = _Begun(frames, frames, shown, found, start)
    if found is None or not found.is_clear:
        return as_given, seen
    given = color_camera(first)
    right, down = found.centre * given.width / shown[0].full_size[0]
    camera = replace(given, cx=given.cx + right, cy=given.cy + down)
    apart = np.array(place_of_color(first))
    apart[:2, 3] += found.place
    moved = list(frames)
    for place in places:
        moved[place] = replace(moved[place], color_camera=camera, color_from_depth=apart)
    again = look(moved, places)
    if again.trouble or again.median > (1 + _NO_WORSE) * seen.median:
        # Nor is a camera that is fitted moved by outlines that points contradict.
        return replace(as_given, sights=()), seen
    return _Begun(frames, tuple(moved), shown, found, start), again


def _adjusted(
    begun: _Begun, places: Sequence[int], seen: Look, params: AdjustParams, progress: Progress
) -> Adjusted:
    frames = begun.frames
    poses = np.stack([_pose(frames[place]) for place in places])
    chosen = [places[n] for n in key_frames(poses, _MOST_KEYS)]
    matching = len(chosen) // 2
    steps = _Steps(progress, len(places) + matching + _PARTS)
    skipped: list[SkippedFrame] = []
    views: dict[int, View] = {}
    threads = workers()

    def read(place: int) -> View | SkippedFrame:
        return seen.views.get(place) or view_or_none(frames[place])

    for place, view in zip(chosen, read_ahead(read, chosen, threads=threads, ahead=threads + 2), strict=True):
        if isinstance(view, View):
            views[place] = view
        else:
            skipped.append(view)
        steps.done(1)
    keys = list(views)
    key_views = list(views.values())
    if len(keys) < 2:
        why = f"{len(keys)} frames can be used"
        return _left(begun, why, skipped, Transfer.of(seen.errors))
    start = Cameras.given([frames[place] for place in keys], [view.lens for view in key_views])
    couples = partners(overlaps(key_views, start))
    found = match(key_views, couples, lambda done, of: steps.at(len(chosen) + done * matching // of))
    prior = params.pose_deviation * np.array([1.0] * 3 + [_TURN_PER_M] * 3)
    camera = params.camera if _share_a_camera([frames[place] for place in places], key_views) else False
    made = bundle(
        key_views,
        start,
        found,
        prior,
        camera,
        params.shutter,
        lambda cameras: _held_by_outlines(begun, key_views[0], cameras),
        lambda: steps.done(1),
    )
    if made is None:
        why = "too few points are seen by three frames"
        return _left(begun, why, skipped, Transfer.of(seen.errors))
    before, after = Transfer.of(made.before), Transfer.of(made.after)
    better, why = _judged(before, after)
    if not better:
        steps.end()
        return _left(begun, why, skipped, before, after)
    strays = _strays(start, made.cameras, prior)
    if strays:
        steps.end()
        _report_mismatch(strays)
        return _left(begun, strays, skipped, before, after)
    cameras = made.cameras
    found_poses = {
        place: Placed(pose, turn)
        for place, pose, turn, count in zip(keys, cameras.poses, cameras.turns, made.seen, strict=True)
        if count >= _LEAST_SEEN
    }
    between = sorted(set(places) - set(chosen))
    frees = Frees(made.has_camera, made.has_turns)
    for place, one in placed_between(frames, between, views, start, cameras, prior, frees):
        if isinstance(one, SkippedFrame):
            skipped.append(one)
        elif one is not None:
            found_poses[place] = one
        steps.done(1)
    steps.end()
    result = list(frames)
    for place in places:
        result[place] = _with(frames[place], found_poses.get(place), made, views, keys)
    moved = np.array([motion_apart(_pose(frames[place]), one.pose) for place, one in found_poses.items()])
    turns = np.degrees([np.linalg.norm(one.turn) for one in found_poses.values()])
    has_camera = made.has_camera or begun.has_camera
    return Adjusted(
        frames=tuple(result),
        places=tuple(sorted(found_poses)),
        accepted=True,
        why=f"{_what(begun, made)} adjusted: {why}{_said_of(skipped)}",
        has_camera=has_camera,
        has_turns=made.has_turns,
        offset_before=begun.offset,
        offset_after=begun.offset_after(result[keys[0]]) if has_camera else None,
        before=before,
        after=after,
        key_frames=len(keys),
        points=made.points,
        unplaced=len(frames) - len(found_poses),
        skipped=tuple(skipped),
        camera_before=color_camera(begun.given[keys[0]]),
        camera_after=color_camera(result[keys[0]]),
        moved_mm=(1000 * float(np.median(moved[:, 0])), 1000 * float(moved[:, 0].max())),
        moved_deg=(float(np.median(moved[:, 1])), float(moved[:, 1].max())),
        turns_deg=(float(np.median(turns)), float(turns.max())),
        seconds=time.perf_counter() - begun.start,
    )


def _held_by_outlines(begun: _Begun, view: View, cameras: Cameras) -> tuple[Cameras, Anchor | None]:
    """Move a colour camera that was fitted to where outlines say that it is, and hold it there."""
    camera = camera_of(cameras.lenses[0], view.size, view.full_size)
    found = offset(begun.sights, camera, cameras.color_from_depth[0])
    if found is None or not found.is_clear:
        return cameras, None
    step = np.zeros(FREE)
    step[1:3] = found.centre * view.size[0] / view.full_size[0]
    step[4:6] = found.place
    moved = cameras.moved(np.zeros((len(cameras.poses), STILL)), step)
    points = np.concatenate([one.ends for one in begun.sights])
    return moved, anchor_of(points[:: max(len(points) // _ANCHORS, 1)], moved)


def _what(begun: _Begun, made: Bundle) -> str:
    what = "poses and colour camera" if made.has_camera or begun.has_camera else "poses"
    return f"{what}, and turns while rows are read (rolling shutter)," if made.has_turns else what


def _strays(given: Cameras, found: Cameras, prior: NDArray[np.float64]) -> str:
    """Return why poses cannot have been what was given, as the end of a sentence; empty if they can."""
    moved = np.array([motion_apart(a, b) for a, b in zip(given.poses, found.poses, strict=True)])
    metres, degrees = np.median(moved, axis=0)
    if metres < _FAR * prior[0] and degrees < _FAR * np.degrees(prior[3]):
        return ""
    return (
        f"poses would move by {1000 * metres:.0f} mm and {degrees:.1f}° (median), far more than "
        "pose_deviation allows: they are of another scan, or taken the wrong way round"
    )


def _share_a_camera(frames: Sequence[Frame], views: Sequence[View]) -> bool:
    """Say whether one colour camera took all images, of a lens that can be adjusted."""
    return all(view.size == views[0].size for view in views) and has_one_camera(frames)


def _pose(frame: Frame) -> NDArray[np.float64]:
    return np.asarray(frame.world_from_camera, np.float64)


def _judged(before: Transfer | None, after: Transfer | None) -> tuple[bool, str]:
    """Say whether what was found is better, and why."""
    if before is None or after is None:
        return False, "no held-out point is measured before and after"
    gained = before.median - after.median
    told = f"held-out points land {after.median:.2f} px from their matches, {before.median:.2f} px before"
    if gained > _BETTER_SHARE * before.median and gained > _BETTER_PX:
        return True, told
    return False, f"{told}: not better by {_BETTER_SHARE:.0%} and {_BETTER_PX} px"


def _with(
    frame: Frame,
    placed: Placed | None,
    made: Bundle,
    views: dict[int, View],
    keys: Sequence[int],
) -> Frame:
    """Return a frame with what was found of it: pose and turn, and the colour camera if there is another."""
    if placed is not None:
        turn = placed.turn if made.has_turns else frame.shutter_turn
        frame = replace(frame, world_from_camera=placed.pose, shutter_turn=turn)
    if not made.has_camera:
        return frame
    first = views[keys[0]]
    return replace(
        frame,
        color_camera=camera_of(made.cameras.lenses[0], first.size, first.full_size),
        color_from_depth=made.cameras.color_from_depth[0],
    )


def _left(
    begun: _Begun,
    why: str,
    skipped: Sequence[SkippedFrame],
    before: Transfer | None,
    after: Transfer | None = None,
) -> Adjusted:
    """Return frames whose poses are left as given."""
    with_color = [n for n, frame in enumerate(begun.given) if frame.color is not None]
    # What has no depth or pose keeps its camera.
    moved = [n for n in with_color if begun.frames[n] is not begun.given[n]]
    which = next(iter(moved or with_color), None)
    was, now = (
        None if which is None else color_camera(frames[which]) for frames in (begun.given, begun.frames)
    )
    why = f"left as given: {why}{_said_of(skipped)}"
    if begun.has_camera and begun.offset is not None:
        why = f"colour camera moved {begun.offset.said}, to where outlines are in photos; poses {why}"
    return Adjusted(
        frames=begun.frames,
        places=(),
        accepted=begun.has_camera,
        why=why,
        has_camera=begun.has_camera,
        has_turns=False,
        offset_before=begun.offset,
        offset_after=None
        if not begun.has_camera or which is None
        else begun.offset_after(begun.frames[which]),
        before=before,
        after=after,
        key_frames=0,
        points=0,
        unplaced=0,
        skipped=tuple(skipped),
        camera_before=was,
        camera_after=now,
        moved_mm=(0.0, 0.0),
        moved_deg=(0.0, 0.0),
        turns_deg=(0.0, 0.0),
        seconds=time.perf_counter() - begun.start,
    )


def _report_mismatch(why: str) -> None:
    emit(ADJUST_IMAGES_MISMATCH.warning("not adjusted: {why}", why=why))


def _said_of(skipped: Sequence[SkippedFrame]) -> str:
    """Return the end of a sentence about frames that cannot be used; empty without any."""
    said = ""
    for what in (BLACK, OVER_EXPOSED):
        count = sum(exposure_of(one) == what for one in skipped)
        said += f"; {counted(count, 'colour image')} {what}" if count else ""
    unread = sum(exposure_of(one) is None for one in skipped)
    return said + (f"; {counted(unread, 'frame')} cannot be read" if unread else "")


class _Steps:
    """Counts steps of the work towards a total that is known before."""

    def __init__(self, progress: Progress, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0

    def done(self, count: int) -> None:
        self.at(self._done + count)

    def at(self, done: int) -> None:
        self._done = min(max(done, self._done), self._total)
        self._progress(self._done, self._total)

    def end(self) -> None:
        self.at(self._total)
