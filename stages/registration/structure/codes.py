"""Diagnostic codes of structure from motion, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

STRUCTURE_TOO_FEW_PHOTOS = Code(
    "structure.too-few-photos",
    "Too few photos for camera poses",
    """
Exit code 3. At least three photos are required that can be read and have the same scene in view. For a mesh
of an object take 20 to 60, all around it.
""",
    "2 of 9 photos can be read; camera poses require at least 3.",
)
STRUCTURE_NOT_CONNECTED = Code(
    "structure.not-connected",
    "Photos that do not connect",
    """
Exit code 3. Camera poses follow from features that several photos have in common, seen from different
positions. The message lists groups of photos that have features in common, and photos without any partner.

- Neighbouring photos must overlap by two thirds, and differ by at most 15 to 20° in viewing direction.
- Move the camera between photos. Photos from one position, such as a panorama, show no depth.
- Surfaces must have texture: print, wood, stone. Blank, transparent and mirroring surfaces have no features.
  Put a newspaper below the object.
- Keep the camera still while it exposes: motion blur removes features.
- Move only the camera, not the object in front of a background.
""",
    (
        "photos: no camera poses can be computed, because no two of the 12 photos have enough features in "
        "common. Take photos that overlap by two thirds, from positions that differ by at most 20°."
    ),
)
STRUCTURE_PHOTOS_LEFT_OUT = Code(
    "structure.photos-left-out",
    "Photos without a pose",
    """
A warning. The photos that connect to the largest group are used; the message names the others. Some of them
may form other groups: parts of the scene without a connection to the largest, or another scene. Take more
photos between the groups ([how](#photos-that-do-not-connect)), or give each scene a separate folder. The
message names consecutive photos of which only one is used.
""",
    "3 of 24 photos have too few features in common with the others and are not used: 0007, 0012, 0013",
)
STRUCTURE_VIDEO_TOO_FAST = Code(
    "structure.video-too-fast",
    "Videos with too much motion for the number of frames",
    """
A warning. A video is reduced to `structure.max_frames` frames, so neighbouring frames of a long video may
not overlap. Increase the number, which takes longer, or process parts of the video (`scan.first`,
`scan.last`).
""",
    "walk.mp4: the camera moves far for 120 frames, so neighbouring frames may not overlap",
)
