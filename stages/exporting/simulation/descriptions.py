"""Descriptions of bodies for simulators: MJCF (MuJoCo), URDF and SDF (Gazebo)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.exporting.simulation.body import BodyFiles, CollisionShape, VisualFile
from scanloom.stages.exporting.simulation.convex_part import OrientedBox
from scanloom.stages.exporting.simulation.mass import MassProperties
from scanloom.stages.files.atomic_files import write_file_atomically
from scanloom.stages.surface.up_direction import rotate_to_z

Floats = NDArray[np.float64]

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
        if any(body.position):
            element.set("pos", _format(body.position))
        if not body.is_static:
            Xml.SubElement(element, "freejoint")
        _add_mjcf_inertia(element, body.mass)
        for one in files.visuals:
            mesh = Path(one.file).stem
            Xml.SubElement(asset, "mesh", name=mesh, file=one.file)
            geom = Xml.SubElement(element, "geom", {"class": "visual", "mesh": mesh})
            _add_mjcf_material(asset, geom, one, images)
        if body.floor is not None:
            # A plane extends without limit whatever its size is.
            shape = {"class": "collision", "type": "plane", "size": "0 0 1"}
            turn = _compute_quaternion(rotate_to_z(body.floor.normal))
            pose = {"pos": _format_exactly(body.floor.point), "quat": _format_exactly(turn)}
            Xml.SubElement(element, "geom", {**shape, **pose})
        for part in files.collisions:
            if not part.is_floor:
                _add_mjcf_shape(asset, element, part)
    _write_xml(path, root)


def _add_mjcf_shape(asset: Any, element: Any, shape: CollisionShape) -> None:
    if shape.file is not None:
        Xml.SubElement(asset, "mesh", name=shape.name, file=shape.file)
        Xml.SubElement(element, "geom", {"class": "collision", "mesh": shape.name})
        return
    box = _get_box(shape)
    attributes = {
        "class": "collision",
        "type": "box",
        "size": _format_exactly(box.half_sizes),
        "pos": _format_exactly(box.center),
        "quat": _format_exactly(_compute_quaternion(box.axes)),
    }
    Xml.SubElement(element, "geom", attributes)


def _get_box(shape: CollisionShape) -> OrientedBox:
    assert shape.part.box is not None
    return shape.part.box


def _compute_quaternion(axes: Floats) -> Floats:
    """Return the quaternion w, x, y, z that turns the coordinate axes to the axes in rows."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(axes.T).as_quat().tolist()
    return np.array([w, x, y, z])


def _compute_angles(axes: Floats) -> Floats:
    """Return roll, pitch and yaw in radians, about fixed axes, of the axes in rows."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(axes.T).as_euler("xyz"), np.float64)


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
    for visual in files.visuals:
        element = Xml.SubElement(link, "visual", name=Path(visual.file).stem)
        Xml.SubElement(Xml.SubElement(element, "geometry"), "mesh", filename=visual.file)
    for shape in files.collisions:
        element = Xml.SubElement(link, "collision", name=shape.name)
        if shape.file is not None:
            Xml.SubElement(Xml.SubElement(element, "geometry"), "mesh", filename=shape.file)
            continue
        box = _get_box(shape)
        angles = _format_exactly(_compute_angles(box.axes))
        Xml.SubElement(element, "origin", xyz=_format_exactly(box.center), rpy=angles)
        geometry = Xml.SubElement(element, "geometry")
        Xml.SubElement(geometry, "box", size=_format_exactly(2 * box.half_sizes))
    _write_xml(path, root)


def write_sdf(path: Path, name: str, bodies: Sequence[BodyFiles]) -> None:
    """Write an SDF file: a model of one link, or a world with a model for each of several bodies."""
    root = Xml.Element("sdf", version="1.9")
    parent = root if len(bodies) == 1 else Xml.SubElement(root, "world", name=name)
    for files in bodies:
        _add_sdf_model(parent, files)
    _write_xml(path, root)


def _add_sdf_model(parent: Any, files: BodyFiles) -> None:
    body = files.body
    model = Xml.SubElement(parent, "model", name=body.name)
    Xml.SubElement(model, "static").text = "true" if body.is_static else "false"
    if any(body.position):
        Xml.SubElement(model, "pose").text = _format([*body.position, 0, 0, 0])
    link = Xml.SubElement(model, "link", name=body.name)
    inertial = Xml.SubElement(link, "inertial")
    Xml.SubElement(inertial, "pose").text = _format([*body.mass.center_m.tolist(), 0, 0, 0])
    Xml.SubElement(inertial, "mass").text = _format([body.mass.mass_kg])
    inertia = Xml.SubElement(inertial, "inertia")
    for key, value in _list_moments(body.mass).items():
        Xml.SubElement(inertia, key).text = value
    for visual in files.visuals:
        _add_sdf_mesh(link, "visual", Path(visual.file).stem, visual.file)
    if body.floor is not None:
        element = Xml.SubElement(link, "collision", name=f"{body.name}_floor")
        Xml.SubElement(element, "pose").text = _format_exactly([*body.floor.point.tolist(), 0, 0, 0])
        plane = Xml.SubElement(Xml.SubElement(element, "geometry"), "plane")
        Xml.SubElement(plane, "normal").text = _format_exactly(body.floor.normal)
    for shape in files.collisions:
        if shape.is_floor:
            continue
        if shape.file is not None:
            _add_sdf_mesh(link, "collision", shape.name, shape.file)
            continue
        box = _get_box(shape)
        element = Xml.SubElement(link, "collision", name=shape.name)
        pose = [*box.center.tolist(), *_compute_angles(box.axes).tolist()]
        Xml.SubElement(element, "pose").text = _format_exactly(pose)
        size = Xml.SubElement(Xml.SubElement(Xml.SubElement(element, "geometry"), "box"), "size")
        size.text = _format_exactly(2 * box.half_sizes)


def _add_sdf_mesh(link: Any, kind: str, name: str, file: str) -> None:
    element = Xml.SubElement(link, kind, name=name)
    mesh = Xml.SubElement(Xml.SubElement(element, "geometry"), "mesh")
    Xml.SubElement(mesh, "uri").text = file


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


def _format_exactly(values: Iterable[float]) -> str:
    """Format values so that they read back equal: the proof is about these numbers."""
    return " ".join(repr(float(value)) for value in values)


def _write_xml(path: Path, root: Any) -> None:
    Xml.indent(root)
    text = Xml.tostring(root, encoding="unicode")
    with write_file_atomically(path) as draft:
        draft.write_text(f'<?xml version="1.0"?>\n{text}\n', encoding="utf-8", newline="\n")
