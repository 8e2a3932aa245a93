"""Frames with their final poses and cameras: inputs of most stages."""

from __future__ import annotations

from dataclasses import dataclass

from scanloom.pipeline.artifacts.adjusted_cameras import AdjustedCameras
from scanloom.pipeline.artifacts.depth_maps import DepthMaps
from scanloom.pipeline.artifacts.poses import Poses
from scanloom.stages.scans.model.scan import Scan


def load_frames(frames: Scan | DepthMaps) -> Scan:
    """Load frames that are a scan already, or that the stage `depth` has written."""
    return frames if isinstance(frames, Scan) else frames.load()


@dataclass(frozen=True, kw_only=True)
class PosedFrames:
    """Inputs of a stage that reads frames.

    Attributes
    ----------
    frames : RGB-D scan, or the depth maps computed for a scan.
    poses : if registration has run.
    adjusted_cameras : if adjustment has run.
    """

    frames: Scan | DepthMaps | None = None
    poses: Poses | None = None
    adjusted_cameras: AdjustedCameras | None = None

    def load_scan(self) -> Scan:
        """Load the frames with the poses of the scan."""
        assert self.frames is not None
        return load_frames(self.frames)

    def load_posed(self) -> Scan:
        """Load the frames with their final poses and cameras."""
        return self.apply_to(self.load_scan())

    def apply_to(self, scan: Scan) -> Scan:
        """Return a scan of these frames with their final poses and cameras."""
        if self.poses is not None:
            scan = self.poses.apply_to(scan)
        return scan if self.adjusted_cameras is None else self.adjusted_cameras.apply_to(scan)
