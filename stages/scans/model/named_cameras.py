"""Nominal intrinsics of common depth cameras and phones, by name and image size.

Focal lengths follow from the fields of view in the manufacturers' data sheets: Intel RealSense D400 (document
337029) and L515, Microsoft Kinect for Windows and Azure Kinect DK, Orbbec Astra, Femto Bolt and Gemini 335.
A pinhole with a field of view α has the focal length w / (2 tan(α / 2)). The Azure Kinect's colour camera is
the exception: its 90° include lens distortion, and factory calibrations have 0.475 image widths. Phones state
the equivalent focal length for 35 mm film, whose diagonal is 43.27 mm.

Single devices differ by a few percent from these values.
"""

from __future__ import annotations

import difflib
import math
import re
from dataclasses import dataclass

from scanloom.stages.scans.model.scan import Camera

_FILM_DIAGONAL_MM = 43.27
# Full sensor of phone cameras, pixels; only its aspect ratio matters.
_PHONE_SIZE = (4032, 3024)
_DEPTH, _COLOR = "depth", "color"


@dataclass(frozen=True)
class _Sensor:
    """Focal length in pixels of the full image; smaller images are scaled and centrally cropped."""

    width: int
    height: int
    focal_px: float

    def scale(self, width: int, height: int) -> float:
        """Return the focal length in pixels for an image size, in either orientation."""
        if (width < height) != (self.width < self.height):
            width, height = height, width
        return self.focal_px * max(width / self.width, height / self.height)


@dataclass(frozen=True)
class _Device:
    """Colour and depth camera of a device.

    Attributes
    ----------
    depth_sizes : image sizes that only the depth camera has.
    """

    color: _Sensor
    depth: _Sensor
    depth_sizes: tuple[tuple[int, int], ...] = ()


def _from_fov(width: int, height: int, fov_deg: float) -> _Sensor:
    """Create a sensor from its horizontal field of view."""
    return _Sensor(width, height, width / 2 / math.tan(math.radians(fov_deg / 2)))


def _from_film(focal_mm: float) -> _Device:
    """Create a phone from the equivalent focal length; its LiDAR depth has the field of view of the photo."""
    sensor = _Sensor(*_PHONE_SIZE, focal_mm / _FILM_DIAGONAL_MM * math.hypot(*_PHONE_SIZE))
    return _Device(sensor, sensor)


_AZURE_DEPTH = _Sensor(640, 576, 504.0)
_AZURE_DEPTH_SIZES = ((640, 576), (320, 288))

_DEVICES = {
    # Depth of the first Kinect and of PrimeSense cameras is usually registered to colour.
    "kinect1": _Device(_Sensor(640, 480, 525.0), _from_fov(640, 480, 58.5)),
    "kinect2": _Device(_from_fov(1920, 1080, 84.1), _Sensor(512, 424, 365.0), ((512, 424),)),
    "azure": _Device(_Sensor(4096, 3072, 0.475 * 4096), _AZURE_DEPTH, _AZURE_DEPTH_SIZES),
    "d415": _Device(_from_fov(1920, 1080, 69.4), _from_fov(1280, 720, 69.4)),
    "d435": _Device(_from_fov(1920, 1080, 69.4), _from_fov(1280, 800, 91.2)),
    "d455": _Device(_from_fov(1280, 800, 90.0), _from_fov(1280, 800, 90.0)),
    "l515": _Device(_from_fov(1920, 1080, 70.0), _from_fov(1024, 768, 70.0), ((1024, 768),)),
    "orbbec-astra": _Device(_from_fov(640, 480, 63.1), _from_fov(640, 480, 58.4)),
    "orbbec-femto-bolt": _Device(_from_fov(3840, 2160, 80.0), _AZURE_DEPTH, _AZURE_DEPTH_SIZES),
    "orbbec-gemini-335": _Device(_from_fov(1920, 1080, 86.0), _from_fov(1280, 800, 90.0)),
    "iphone-12-pro": _from_film(26),
    "iphone-13-pro": _from_film(26),
    "iphone-14-pro": _from_film(24),
    "iphone-15-pro": _from_film(24),
    "iphone-16-pro": _from_film(24),
    "ipad-pro": _from_film(29),
}
# Other names of the same optics.
_ALIASES = {
    "kinect": "kinect1",
    "primesense": "kinect1",
    "xtion": "kinect1",
    "kinectv1": "kinect1",
    "kinectv2": "kinect2",
    "azurekinect": "azure",
    "kinectazure": "azure",
    "k4a": "azure",
    "d435i": "d435",
    "d455i": "d455",
    "orbbec": "orbbecastra",
    "astra": "orbbecastra",
    "femtobolt": "orbbecfemtobolt",
    "orbbecfemtomega": "orbbecfemtobolt",
    "gemini335": "orbbecgemini335",
    "iphone": "iphone13pro",
    "ipad": "ipadpro",
}
NAMES = tuple(_DEVICES)


def _normalise(name: str) -> str:
    """Drop case, spaces and punctuation, and the manufacturer's series."""
    return re.sub(r"[^a-z0-9]|realsense|max$", "", name.lower())


_BY_NAME = {_normalise(name): device for name, device in _DEVICES.items()}


def create_named_camera(text: str, width: int, height: int) -> Camera | None:
    """Return the nominal camera of a device for an image size; None if the name is unknown.

    Parameters
    ----------
    text : name of a device, such as `d435`. `-depth` or `-color` selects one of its cameras. By default it is
        the colour camera, because depth is usually aligned to colour, or the depth camera if only that has
        images of this size.
    width, height : pixels.
    """
    found = _find_device(text)
    if found is None:
        return None
    device, stream = found
    if not stream:
        stream = _DEPTH if (width, height) in device.depth_sizes else _COLOR
    focal = (device.depth if stream == _DEPTH else device.color).scale(width, height)
    # Frames refine the focal length of a guess.
    return Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2, is_guess=True)


def suggest_names(text: str) -> str:
    """Return the most similar camera name, or all names, as part of a sentence."""
    near = difflib.get_close_matches(_normalise(text), _BY_NAME, n=1)
    if near:
        return next(name for name in NAMES if _normalise(name) == near[0])
    return ", ".join(NAMES)


def _find_device(text: str) -> tuple[_Device, str] | None:
    """Return the device of a name, and the selected stream or an empty string."""
    name, stream = _normalise(text), ""
    for one in (_DEPTH, _COLOR):
        if name.endswith(one):
            name, stream = name.removesuffix(one), one
    device = _BY_NAME.get(_ALIASES.get(name, name))
    return None if device is None else (device, stream)
