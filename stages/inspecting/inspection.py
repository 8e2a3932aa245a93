"""Result of `inspect`."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.fusion.scene_extent import SceneExtent, format_point
from scanloom.stages.inspecting.camera_path import CameraTrajectory
from scanloom.stages.inspecting.depth_range import DepthRange
from scanloom.stages.inspecting.resource_estimate import FusionEstimate
from scanloom.stages.inspecting.unused_files import UnusedFile
from scanloom.stages.printing import format_by_metrics, render_table
from scanloom.stages.registration.focal_length import FocalEstimate
from scanloom.stages.scans.codes import POSE_MISSING
from scanloom.stages.scans.model.scan import Camera, Scan
from scanloom.stages.scans.model.world import Scale, WorldUp

# Maximum number of unused files listed in the text for people.
_MAX_UNUSED_LINES = 12


@dataclass(frozen=True, eq=False)
class Inspection:
    """Contents and quality of a scan.

    Attributes
    ----------
    scan : inspected scan.
    color_size : (width, height) of the colour (left) images, pixels; None without colour.
    trajectory : camera trajectory; None without poses.
    depth : depth statistics of RGB-D scans; None if no sampled frame has depth.
    stereo_depth_m : for calibrated stereo: depth at the largest calibrated disparity (or None) and at one
        pixel.
    reprojection_error_px : median reprojection error between frames, pixels; None if not measured.
    pose_errors_m : median depth error after reprojection, by pose convention; empty if not measured.
    blurriest_frames : names and sharpness of the 5 % blurriest frames, the worst first. Sharpness is the
        variance
        of the Laplacian, relative to the median frame. Long scans are sampled.
    scene : extent of the scan in world coordinates; only for RGB-D scans with poses.
    fusion_estimate : estimated resources of fusion; only for RGB-D scans with poses.
    up : up direction in world coordinates; None if neither layout nor accelerometer provides it.
    subject : what registration will find poses for: `scene`, or the `object` that moves before a static
        camera. None if the scan has poses, or no depth maps.
    focal : focal length of the depth camera, estimated from the frames if the input does not state it.
    unused_files : files of the folder that were not used.
    diagnostics : all warnings, beginning with those from reading the scan.
    """

    scan: Scan
    color_size: tuple[int, int] | None
    trajectory: CameraTrajectory | None
    depth: DepthRange | None
    stereo_depth_m: tuple[float | None, float] | None
    reprojection_error_px: float | None
    pose_errors_m: dict[str, float]
    blurriest_frames: tuple[tuple[str, float], ...]
    scene: SceneExtent | None
    fusion_estimate: FusionEstimate | None
    up: WorldUp | None
    subject: str | None = None
    focal: FocalEstimate | None = None
    unused_files: tuple[UnusedFile, ...] = ()
    diagnostics: tuple[Diagnostic, ...] = ()

    __repr__ = format_by_metrics
    _repr_html_ = render_table

    def to_dict(self) -> dict[str, Any]:
        """Return all values for JSON, with units in the key names.

        If the scan is not `metric`, metres stand for the unit of its world.
        """
        scan = self.scan
        camera = scan.frames[0].camera
        rig = scan.rig
        return {
            "layout": scan.layout,
            "kind": "stereo" if scan.is_stereo else "views" if scan.is_views else "rgbd",
            "frames": len(scan.frames),
            "skipped": [one.to_dict() for one in scan.skipped_frames],
            "camera": dataclasses.asdict(camera) if camera.is_calibrated else None,
            "color_size_px": self.color_size,
            "subject": self.subject,
            "focal": self.focal and self.focal.to_dict(),
            "metric": scan.is_metric,
            "scale": scan.scale and scan.scale.to_dict(),
            **(self.up.to_dict() if self.up else {"up": None, "up_source": None}),
            "depth_scale_per_m": None if scan.is_stereo or scan.is_views else scan.frames[0].depth_scale,
            "rig": {
                "right_camera": dataclasses.asdict(rig.right),
                "baseline_m": rig.baseline,
                "rectified": rig.is_rectified,
                "disparities_px": rig.disparity_count,
            }
            if rig is not None and rig.left.is_calibrated
            else None,
            "path": self.trajectory and dataclasses.asdict(self.trajectory),
            "depth": self.depth and dataclasses.asdict(self.depth),
            "stereo_depth_m": self.stereo_depth_m
            and {"largest_disparity": self.stereo_depth_m[0], "one_pixel": self.stereo_depth_m[1]},
            "misfit_px": self.reprojection_error_px,
            "pose_errors_m": self.pose_errors_m,
            "blurriest_frames": [
                {"frame": name, "of_median": value} for name, value in self.blurriest_frames
            ],
            "scene": self.scene and dataclasses.asdict(self.scene),
            "fusion_estimate": self.fusion_estimate and dataclasses.asdict(self.fusion_estimate),
            "missing": [one.to_dict() for one in scan.missing],
            "unused": [dataclasses.asdict(one) for one in self.unused_files],
        }

    def format_lines(self) -> list[str]:
        """Return the inspection as lines of text for people."""
        scan, camera = self.scan, self.scan.frames[0].camera
        single = "single views" if scan.is_views else "colour and depth"
        kind = "stereo pairs" if scan.is_stereo else single
        unit = "m" if scan.is_metric else "units"
        lines = [
            f"layout    {scan.layout}: {kind}",
            f"frames    {len(scan.frames)}"
            + (f", {len(scan.skipped_frames)} skipped" if scan.skipped_frames else ""),
            f"camera    {_describe_camera(camera)}",
        ]
        if not scan.is_metric:
            lines.append("scale     unknown: lengths are in units of the scan's world")
        if scan.scale is not None:
            lines.append(f"scale     {_describe_scale(scan.scale)}")
        if self.up is not None:
            x, y, z = self.up.direction
            lines.append(f"up        {x:.3g} {y:.3g} {z:.3g}, from {self.up.source}")
        if self.color_size and self.color_size != (camera.width, camera.height):
            lines.append(f"colour    {self.color_size[0]}×{self.color_size[1]} px")
        if scan.rig is not None and camera.is_calibrated:
            state = "rectified" if scan.rig.is_rectified else "not rectified"
            lines.append(f"rig       baseline {scan.rig.baseline:.4f} {unit}, {state}")
        if self.trajectory is not None and len(scan.frames) > 1:
            box = " × ".join(f"{side:.2f}" for side in self.trajectory.box_m)
            lines.append(
                f"path      {self.trajectory.length_m:.2f} {unit} in a box of {box} {unit}; "
                f"largest step {self.trajectory.max_step_m:.3f} {unit}, "
                f"{self.trajectory.max_rotation_deg:.1f}°"
            )
        if self.depth is not None:
            lines.append(
                f"depth     {self.depth.near_m:.2f} to {self.depth.far_m:.2f} {unit} (2nd to 98th "
                "percentile), "
                f"median {self.depth.median_m:.2f} {unit}; {self.depth.missing_ratio:.0%} missing "
                f"(in {self.depth.sampled_frames} of {len(scan.frames)} frames)"
            )
        if self.stereo_depth_m is not None:
            near, far = self.stereo_depth_m
            start = "" if near is None else f"{near:.2f} {unit} at the largest disparity, "
            lines.append(f"depth     {start}{far:.1f} {unit} at a disparity of one pixel")
        if self.pose_errors_m:
            conventions = sorted(self.pose_errors_m.items(), key=lambda way: way[1])
            words = " and ".join(
                (f"{error * 1000:.0f} mm" if scan.is_metric else f"{error:.2g} units") + f" {name}"
                for name, error in conventions[:2]
            )
            lines.append(f"poses     overlapping depth maps agree to {words} (median, best two conventions)")
        if self.subject == "object":
            lines.append(
                "subject   an object that moves in front of a static camera: `scanloom run` registers only "
                "the object, or everything visible with register.subject=scene"
            )
        if self.reprojection_error_px is not None:
            lines.append(
                f"misfit    points seen in two frames are {self.reprojection_error_px:.2g} px apart (median)"
            )
        if self.blurriest_frames:
            words = ", ".join(f"{name} ({value:.0%})" for name, value in self.blurriest_frames[:5])
            lines.append(f"sharpness lowest in {words} of the median frame")
        if self.scene is not None:
            lines += [
                f"extent    {self.scene} {unit}, minimum to maximum corner (1st to 99th percentile)",
                f"looks at  {format_point(self.scene.center_m)} {unit}, the centre of view",
            ]
        if self.fusion_estimate is not None:
            needs = self.fusion_estimate
            lines.append(
                f"fusion    about {needs.triangles:,} triangles at voxels of {needs.voxel_size_m:g} {unit}; "
                f"{needs.volume_mb:.0f} MB of memory, {needs.disk_mb:.0f} MB on disk"
            )
        found = "" if scan.is_views else "; `scanloom run` estimates them"
        lines += [f"missing   {one}{found if one.code == POSE_MISSING.name else ''}" for one in scan.missing]
        lines += [f"skipped   {one.name}: {one.reason}" for one in scan.skipped_frames[:5]]
        if len(scan.skipped_frames) > 5:
            lines.append(f"skipped   and {len(scan.skipped_frames) - 5} more")
        lines += [f"{one.severity.value:<9} {one}" for one in self.diagnostics]
        lines += [f"unused    {one}" for one in self.unused_files[:_MAX_UNUSED_LINES]]
        if len(self.unused_files) > _MAX_UNUSED_LINES:
            lines.append(f"unused    and {len(self.unused_files) - _MAX_UNUSED_LINES} more")
        return lines


def _describe_scale(scale: Scale) -> str:
    spread = "" if scale.spread_ratio is None else f", which differ by up to {scale.spread_ratio:.1%}"
    return f"{scale.metres_per_unit:.6g} m per unit, {scale.source}{spread}"


def _describe_camera(camera: Camera) -> str:
    if not camera.is_calibrated:
        return f"{camera.width}×{camera.height} px"
    kind = "fisheye " if camera.fisheye else ""
    distortion = (
        f", {kind}distortion {' '.join(f'{k:g}' for k in camera.distortion)}" if camera.distortion else ""
    )
    return (
        f"{camera.width}×{camera.height} px, focal length {camera.fx:.2f} {camera.fy:.2f} px, "
        f"centre {camera.cx:.2f} {camera.cy:.2f} px{distortion}"
    )
