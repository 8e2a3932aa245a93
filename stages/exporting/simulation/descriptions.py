"""Descriptions of bodies for simulators: MJCF (MuJoCo), URDF and SDF (Gazebo)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

from scanloom.stages.exporting.simulation.body import BodyFiles, VisualFile
from scanloom.stages.exporting.simulation.mass import MassProperties
from scanloom.stages.files.atomic_files import write_file_atomically

# Collision geometry is in its own group, which the viewer of MuJoCo hides by default.
_VISUAL_GROUP, _COLLISION_GROUP = "2", "3"


def write_mjcf(path: Path, name: str, bodies: Sequence[BodyFiles]) -> None:
    """Write an MJCF file with all bodies."""
    root = Xml.Element("mujoco", model=name)
    default = Xml.SubElement(root, "default")
    # Mass is stated per body. Scanned meshes are often open, for which MuJoCo computes no volume.
    Xml.SubElement(default, "mesh", inertia="shell")
    visual = Xml.SubElement(default, "default", {"class": "visual"})
    Xml.SubElement(visual, "geom", type="mesh", contype="0", conaffinity="0", group=_VISUAL_GROUP)
    collision = Xml.SubElement(default, "default", {"class": "collision"})
    Xml.SubElement(collision, "geom", type="mesh", group=_COLLISION_GROUP)
    asset = Xml.SubElement(root, "asset")
    world = Xml.SubElement(root, "worldbody")
    images: dict[str, str] = {}
    for files in bodies:
        body = files.body
        element = Xml.SubElement(world, "body", name=body.name)
        if not body.is_static:
            Xml.SubElement(element, "freejoint")
        _add_mjcf_inertia(element, body.mass)
        for one in files.visuals:
            mesh = Path(one.file).stem
            Xml.SubElement(asset, "mesh", name=mesh, file=one.file)
            geom = Xml.SubElement(element, "geom", {"class": "visual", "mesh": mesh})
            _add_mjcf_material(asset, geom, one, images)
        for file in files.collisions:
            mesh = Path(file).stem
            Xml.SubElement(asset, "mesh", name=mesh, file=file)
            Xml.SubElement(element, "geom", {"class": "collision", "mesh": mesh})
    _write_xml(path, root)


def _add_mjcf_material(asset: Any, geom: Any, visual: VisualFile, images: dict[str, str]) -> None:
    material = visual.material
    if material is None:
        return
    attributes = {"name": f"{Path(visual.file).stem}_material", "specular": "0"}
    if material.image is not None:
        file = f"{Path(visual.file).parent.as_posix()}/{material.image.name}"
        if file not in images:
            images[file] = Path(file).stem
            Xml.SubElement(asset, "texture", name=images[file], type="2d", file=file)
        attributes["texture"] = images[file]
    if material.base_color is not None:
        attributes["rgba"] = _format(material.base_color)
    Xml.SubElement(asset, "material", attributes)
    geom.set("material", attributes["name"])


def _add_mjcf_inertia(element: Any, mass: MassProperties) -> None:
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = mass.inertia.tolist()
    Xml.SubElement(
        element,
        "inertial",
        pos=_format(mass.center_m.tolist()),
        mass=_format([mass.mass_kg]),
        fullinertia=_format([xx, yy, zz, xy, xz, yz]),
    )


def write_urdf(path: Path, files: BodyFiles) -> None:
    """Write a URDF file with one link."""
    root = Xml.Element("robot", name=files.body.name)
    # Read by MuJoCo only, which otherwise drops folders from file names.
    mujoco = Xml.SubElement(root, "mujoco")
    Xml.SubElement(mujoco, "compiler", strippath="false", balanceinertia="true")
    link = Xml.SubElement(root, "link", name=files.body.name)
    inertial = Xml.SubElement(link, "inertial")
    Xml.SubElement(inertial, "origin", xyz=_format(files.body.mass.center_m.tolist()))
    Xml.SubElement(inertial, "mass", value=_format([files.body.mass.mass_kg]))
    Xml.SubElement(inertial, "inertia", _list_moments(files.body.mass))
    for kind, meshes in (("visual", [one.file for one in files.visuals]), ("collision", files.collisions)):
        for file in meshes:
            element = Xml.SubElement(link, kind, name=Path(file).stem)
            Xml.SubElement(Xml.SubElement(element, "geometry"), "mesh", filename=file)
    _write_xml(path, root)


def write_sdf(path: Path, files: BodyFiles) -> None:
    """Write an SDF file with one model of one link."""
    root = Xml.Element("sdf", version="1.9")
    model = Xml.SubElement(root, "model", name=files.body.name)
    Xml.SubElement(model, "static").text = "true" if files.body.is_static else "false"
    link = Xml.SubElement(model, "link", name=files.body.name)
    inertial = Xml.SubElement(link, "inertial")
    Xml.SubElement(inertial, "pose").text = _format([*files.body.mass.center_m.tolist(), 0, 0, 0])
    Xml.SubElement(inertial, "mass").text = _format([files.body.mass.mass_kg])
    inertia = Xml.SubElement(inertial, "inertia")
    for key, value in _list_moments(files.body.mass).items():
        Xml.SubElement(inertia, key).text = value
    for kind, meshes in (("visual", [one.file for one in files.visuals]), ("collision", files.collisions)):
        for file in meshes:
            element = Xml.SubElement(link, kind, name=Path(file).stem)
            mesh = Xml.SubElement(Xml.SubElement(element, "geometry"), "mesh")
            Xml.SubElement(mesh, "uri").text = file
    _write_xml(path, root)


def write_gazebo_config(path: Path, name: str, sdf: str) -> None:
    """Write the file that makes a folder a model of Gazebo."""
    root = Xml.Element("model")
    Xml.SubElement(root, "name").text = name
    Xml.SubElement(root, "version").text = "1.0"
    Xml.SubElement(root, "sdf", version="1.9").text = sdf
    Xml.SubElement(root, "description").text = "Scanned with scanloom."
    _write_xml(path, root)


def _list_moments(mass: MassProperties) -> dict[str, str]:
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = mass.inertia.tolist()
    return {
        key: _format([value])
        for key, value in zip(
            ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), (xx, xy, xz, yy, yz, zz), strict=True
        )
    }


def _format(values: Sequence[float]) -> str:
    return " ".join(f"{value:.9g}" for value in values)


def _write_xml(path: Path, root: Any) -> None:
    Xml.indent(root)
    text = Xml.tostring(root, encoding="unicode")
    with write_file_atomically(path) as draft:
        draft.write_text(f'<?xml version="1.0"?>\n{text}\n', encoding="utf-8", newline="\n")
