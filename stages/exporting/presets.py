"""Named presets of export parameters for common target programs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from scanloom.stages.diagnostics.codes import USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.exporting.export import GLTF_SUFFIXES, Y_UP_METRE_SUFFIXES, ExportParams

if TYPE_CHECKING:
    from scanloom.stages.params.keywords import ExportKeywords

PRESETS: dict[str, ExportKeywords] = {
    "web": {
        "compress": "meshopt",
        "position_bits": 14,
        "texel_steps": 2,
        "shading": "unlit",
        "images": "webp",
        "quality": 75,
        "image_size": 2048,
    },
    "unity": {"axes": "y-up", "shading": "keep", "images": "jpeg", "quality": 90},
    "blender": {"axes": "z-up", "shading": "keep"},
    "print": {"axes": "z-up", "unit": "mm", "on_floor": True, "watertight": True},
}
# Written by `export_simulation`, which has its own parameters.
SIMULATION_PRESET = "sim"

# Parameters without effect on other formats than glTF, and without effect on glTF and USD.
_GLTF_ONLY_PARAMS = ("compress", "position_bits", "texel_steps", "shading")
_NON_GLTF_PARAMS = ("axes", "unit", "on_floor")


def preset(name: str, suffix: str = ".glb") -> ExportParams:
    """Return the export parameters of a preset for a file format.

    WebP becomes JPEG for formats other than glTF, because few programs read WebP there.

    Parameters
    ----------
    name : key of PRESETS.
    suffix : extension of the output file. Values that this format does not support are dropped from the
        preset.

    Raises
    ------
    UsageError
        If no preset has this name.
    """
    if name not in PRESETS:
        raise UsageError(
            USAGE_VALUE_INVALID,
            "unknown preset {name!r}; the presets are {presets}.",
            name=name,
            presets=", ".join(PRESETS),
        )
    suffix = suffix.lower()
    left_out = (
        *(() if suffix in GLTF_SUFFIXES else _GLTF_ONLY_PARAMS),
        *(_NON_GLTF_PARAMS if suffix in Y_UP_METRE_SUFFIXES else ()),
    )
    kept: Any = {key: value for key, value in PRESETS[name].items() if key not in left_out}
    if kept.get("images") == "webp" and suffix not in GLTF_SUFFIXES:
        kept["images"] = "jpeg"
    if name == "blender" and suffix == ".obj":
        # Blender imports OBJ as y-up by default, but PLY and STL as z-up.
        kept["axes"] = "y-up"
    return ExportParams(**kept)
