import numpy as np
import pytest

from scanloom.pipeline.artifacts.depth_maps import write_depth_maps
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.model.scan import Camera, Frame, Scan, SkippedFrame

FRAME = Frame("a", Camera(8, 6, 5.0, 5.0, 3.5, 2.5), world_from_camera=np.eye(4))


def test_a_scan_with_all_pairs_skipped_is_refused_with_the_first_reason(tmp_path):
    measured = [(FRAME, SkippedFrame(name, f"right/{name}.png is no image")) for name in ("a", "b")]
    with pytest.raises(InputError, match=r"for any of 2 frames.*The first, a: right/a.png is no image"):
        write_depth_maps(tmp_path, measured, Scan("made", [FRAME] * 2))
    assert not (tmp_path / "scan.json").exists()


def test_no_pairs_at_all_is_refused(tmp_path):
    with pytest.raises(InputError, match="for any of 0 frames"):
        write_depth_maps(tmp_path, [], Scan("made", []))
