"""Frames with their final poses and cameras: inputs of most stages."""

from __future__ import annotations

from dataclasses import dataclass

from scanloom.pipeline.artifacts.adjusted_cameras import AdjustedCameras
from scanloom.pipeline.artifacts.depth_maps import DepthMaps
from scanloom.pipeline.artifacts.poses import Poses
from scanloom.stages.scans.model.scan import Scan


def load_frames(frames: Scan | DepthMaps) -> Scan:
    """Load frames from a scan or from the depth maps of the stage `depth`."""
    return frames if isinstance(frames, Scan) else frames.load()


@dataclass(frozen=True, kw_only=True)
class PosedFrames:
    """Inputs of a stage that reads frames.

    Attributes
    ----------
    frames : RGB-D scan, or depth maps computed for a scan.
    poses : poses estimated by `register`, if it ran.
    adjusted_cameras : poses and cameras refined by `adjust`, if it ran.
    """

    frames: Scan | DepthMaps | None = None
    poses: Poses | None = None
    adjusted_cameras: AdjustedCameras | None = None

    def load_scan(self) -> Scan:
        """Load the frames with the input poses of the scan."""
        assert self.frames is not None
        return load_frames(self.frames)

    def load_posed(self) -> Scan:
        """Load the frames with their final poses and cameras."""
        return self.apply_to(self.load_scan())

    def apply_to(self, scan: Scan) -> Scan:
        """Apply the final poses and cameras to a scan with these frames."""
        if self.poses is not None:
            scan = self.poses.apply_to(scan)
        return scan if self.adjusted_cameras is None else self.adjusted_cameras.apply_to(scan)
