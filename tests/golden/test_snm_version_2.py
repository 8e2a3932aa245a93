"""Files in version 2 of the format, which store the up direction, decode the same in all later versions."""

from __future__ import annotations

import base64
import hashlib

import pytest

from scanloom.stages.normal_meshes.normal_mesh import decode

ALONG = (
    "c25tAlAQse48VNEzO6+NR1qDgof1iaFosIwJpKHyRTpp6o28gIovIb4KTBUKYUPOATicgtri2Uq7c5PpP12B1S/epb2WQF8pRuRE"
    "tnRM4lDSfqnhwSXgOeGHAFNSDwiUSlV3XkDq+SyuELAeurApGYhKCBxzvuSqBoLOUC2VVXLBPtA9ueULQSf8N0Xjea15dcOP"
)
ASLANT = (
    "c25tAmdMJe48VNEzO6+NR1qDgogAiKeqJ2XzMzTMzMzL////+gCzMzYy2ZmOhGi1DMC4iDm6TUSCDOScYoIJAHvEwxF/N7f7UnZ1"
    "rfPAaz78aY1qBIvleu8szshIBJOrwlo4DfI3Z9SaZl3MiK05WKMAU1IPCJRKVXdeQOr5LK4QsB66sCkZiEoIHHO+5KoGgs5QLZVV"
    "csE+0D255QtBJ/w3ReN5rXl1w48="
)
READS = "56a41aadef538587981514493de04c2d1d488587b89f8d1a7ef6592587946f99"


@pytest.mark.parametrize(("file", "up"), [(ALONG, (0.0, -1.0, 0.0)), (ASLANT, (0.6, 0.0, -0.8))])
def test_a_version_2_file_decodes_as_before(file: str, up: tuple[float, float, float]) -> None:
    """Compare the coloured sheet in files with the up direction as an axis and as a vector."""
    found = decode(base64.b64decode(file))
    digest = hashlib.sha256()
    for level in found.levels:
        digest.update(level.vertices.tobytes() + level.triangles.tobytes() + level.colors.tobytes())
        assert level.up == up
    assert len(found.levels) == 2
    assert digest.hexdigest() == READS
