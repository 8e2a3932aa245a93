"""What is up in a mesh: as it is said, or from where most of the surface looks and how cameras were held."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scanloom.stages.diagnostics.codes import USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import Where
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.surface.codes import SCALE_UP_CONTRADICTED
from scanloom.stages.surface.mesh import Mesh

Floats = NDArray[np.float64]

# Directions that are tried, about 3° apart.
_TRIED = 4000
# Normals as near as this to a direction count for it, degrees: a scanned floor is not flat.
_NEAR = 8.0
# A guess is off by no more than this, degrees.
_WITHIN = 60.0
# Less surface than this share does not tell.
_LEAST_SHARE = 0.03
# As many triangles tell it.
_ENOUGH = 40_000
# An axis as near as this to what is up is up, degrees.
_SAME = 1.0
# What is known to be up and what is seen to be may be so far apart, degrees: rooms are tidy, hands are not.
_DOUBTFUL = 30.0
# The mean of a camera's side that is up is at least so long where cameras were held alike.
_HELD_ALIKE = 0.5
# Cameras on their side go around what they show: their upper sides look all about, and the mean of them is
# no longer than the first, and this share of their x axes' squares lies along one axis, of 30° above it, too.
# A camera that is only tilted comes near that by more than 200°.
_UPPER_SIDES, _ALONG = 0.6, 0.7
_AXES = {
    "+x": (1.0, 0.0, 0.0),
    "-x": (-1.0, 0.0, 0.0),
    "+y": (0.0, 1.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "+z": (0.0, 0.0, 1.0),
    "-z": (0.0, 0.0, -1.0),
}
# The turns that bring an axis up, along z.
_TURNS = {
    "+x": ((0, 0, -1), (0, 1, 0), (1, 0, 0)),
    "-x": ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
    "+y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "-y": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "+z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "-z": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
}
_Y_UP_FROM_Z_UP = np.array(((1, 0, 0), (0, 0, 1), (0, -1, 0)), np.float64)


def direction_of(up: str) -> Floats | None:
    """Return the direction (3,) of length 1 that words tell, an axis or three numbers; None for `none`.

    Raises
    ------
    UsageError
        If it is none of these, or the numbers are no direction.
    """
    if up == "none":
        return None
    if up in _AXES:
        return np.array(_AXES[up])
    try:
        direction = np.array([float(word) for word in up.split()])
    except ValueError:
        raise UsageError(
            USAGE_VALUE_INVALID,
            "is {up!r}; it must be one of {names}.",
            Where(parameter="up"),
            up=up,
            names=", ".join((*_AXES, "none")),
        ) from None
    length = float(np.linalg.norm(direction))
    if len(direction) != 3 or not 0 < length < math.inf:
        raise UsageError(
            USAGE_VALUE_INVALID,
            "is {up!r}; a direction is three numbers, not all of them 0.",
            Where(parameter="up"),
            up=up,
        )
    return direction / length


def turn_along_z(up: Floats | None) -> Floats:
    """Return the rotation (3, 3) that brings a direction (3,) of length 1 along z; None turns nothing."""
    if up is None:
        return np.eye(3)
    for name, axis in _AXES.items():
        if np.array_equal(up, axis):
            return np.array(_TURNS[name], np.float64)
    # What is farthest from up gives the other axes.
    across = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    across /= np.linalg.norm(across)
    return np.stack([across, np.cross(up, across), up])


def turn_along_y(up: Floats) -> Floats:
    """Return the rotation (3, 3) that brings a direction (3,) of length 1 along y, which is up in glTF."""
    if np.array_equal(up, _AXES["+y"]):
        return np.eye(3)
    # Not by a product where there are axes alone, so that no zero becomes a negative one.
    return np.asarray(_Y_UP_FROM_Z_UP @ turn_along_z(up) + 0.0)


@dataclass(frozen=True, eq=False)
class PlaceUp:
    """What is up in a scan of a place.

    Attributes
    ----------
    direction : (3,) float64 of length 1.
    source : what told it: `surface`, `plane`, `cameras`, or how it is known.
    """

    direction: Floats
    source: str


def up_of_place(
    mesh: Mesh,
    poses: Floats,
    known: tuple[ArrayLike, str] | None = None,
    plane: ArrayLike | None = None,
) -> PlaceUp:
    """Return what is up in a scan of a place.

    What is known counts; where neither the surface nor the cameras agree with it, that is reported. Else the
    surface tells it, else the cameras. An axis of the poses' world that is within a degree of it is taken for
    it: worlds that know of gravity have one there, and a floor is not known better.

    Parameters
    ----------
    mesh : of the place, in the poses' world.
    poses : (n, 4, 4) camera-to-world, one or more.
    known : a direction (3,) of length 1, and how it is known.
    plane : up (3,), of length 1, from a table or floor that was left out of the mesh; says what else the
        surface would.
    """
    held = up_of_held(poses)
    found = up_of_surface(mesh, held) if plane is None else np.asarray(plane, np.float64)
    if known is None:
        told = "surface" if plane is None else "plane"
        direction, source = (held, "cameras") if found is None else (found, told)
        return PlaceUp(_or_axis(direction), source)
    up = np.asarray(known[0], np.float64)
    _report_doubts(up, known[1], found, poses)
    return PlaceUp(_or_axis(up), known[1])


def _or_axis(up: Floats) -> Floats:
    nearest = max(_AXES.values(), key=lambda axis: float(np.dot(axis, up)))
    return np.array(nearest) if np.dot(nearest, up) > math.cos(math.radians(_SAME)) else up


def _report_doubts(up: Floats, source: str, found: Floats | None, poses: Floats) -> None:
    """Warn if neither the surface nor the cameras agree with the known up direction."""
    by_cameras = min(_degrees(up, held) for held in _up_of_cameras_on_any_side(poses))
    by_surface = math.inf if found is None else _degrees(up, found)
    if min(by_cameras, by_surface) <= _DOUBTFUL:
        return
    surface = "" if found is None else f", and most of the surface near that looks {by_surface:.0f}° off it"
    emit(
        SCALE_UP_CONTRADICTED.warning(
            "what is up is taken from {source}, but cameras were held as if it were {off:.0f}° off that"
            "{surface}",
            remedy="upright.up=AXIS states it",
            source=source,
            off=by_cameras,
            surface=surface,
        )
    )


def _degrees(first: Floats, second: Floats) -> float:
    return math.degrees(math.acos(float(np.clip(first @ second, -1, 1))))


def _up_of_cameras_on_any_side(poses: Floats) -> list[Floats]:
    """Return what `up_of_cameras` says, and what it says of cameras held on another side, if all may be.

    Phones are: in portrait, what is up is the left or right side of their images, the same in all. That all
    were taken upside down is no excuse: then it is more likely that an axis is.
    """
    sides = [up_of_cameras(poses)]
    for sine in (1, -1):
        turned = poses[:, :3, :3] @ np.array(((0, -sine, 0), (sine, 0, 0), (0, 0, 1)), np.float64)
        if np.linalg.norm(turned[:, :, 1].mean(axis=0)) > _HELD_ALIKE:
            sides.append(up_of_cameras(turned))
    return sides


def up_of_cameras(poses: Floats) -> Floats:
    """Return the direction (3,) that is up: square to the cameras' x axes, on the side of their -y axes.

    People hold cameras level, so x axes are horizontal; where all point the same way, as from a car, they
    leave the direction open and the mean -y axis, weighted less, decides.

    Parameters
    ----------
    poses : (n, 4, 4) camera-to-world, one or more, or their turns (n, 3, 3).
    """
    sideways = poses[:, :3, 0]
    upward = -poses[:, :3, 1].mean(axis=0)
    spread = sideways.T @ sideways / len(poses) - 0.1 * np.outer(upward, upward)
    up = np.linalg.eigh(spread)[1][:, 0]
    return np.asarray(up if up @ upward >= 0 else -up)


def up_of_held(poses: Floats) -> Floats:
    """Return the direction (3,) that is up as `up_of_cameras`, also of cameras on their side around a thing.

    Telephones are held so, and arms that go around. Which end of their axis is up no side tells then, for
    they may have been turned either way; but they rather look down.

    Parameters
    ----------
    poses : (n, 4, 4) camera-to-world, one or more.
    """
    sideways = poses[:, :3, 0]
    along, axes = np.linalg.eigh(sideways.T @ sideways / len(poses))
    upper = np.linalg.norm(poses[:, :3, 1].mean(axis=0))
    if along[2] < _ALONG or upper > _UPPER_SIDES:
        return up_of_cameras(poses)
    axis = axes[:, 2]
    return np.asarray(-axis if axis @ poses[:, :3, 2].mean(axis=0) > 0 else axis)


def up_of_surface(mesh: Mesh, guess: Floats) -> Floats | None:
    """Return the direction (3,) of length 1 that floors and tops of tables look to; None if there is none.

    Of the directions within 60° of the guess it is the one that most of the surface looks to, the more so the
    nearer it is to the guess.

    Parameters
    ----------
    guess : (3,) of length 1, what is roughly up.
    """
    chosen = mesh.triangles[:: 1 + len(mesh.triangles) // _ENOUGH]
    corners = mesh.vertices[chosen]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normals, axis=1)
    normals = normals[area > 0] / area[area > 0, None]
    area = area[area > 0] / max(float(area.sum()), np.finfo(np.float64).tiny)
    tried = _all_around(_TRIED)
    tried = tried[tried @ guess >= math.cos(math.radians(_WITHIN))]
    share = np.array([_near(normals, direction) @ area for direction in tried])
    best = int(np.argmax(share * (tried @ guess)))
    if share[best] < _LEAST_SHARE:
        return None
    mean = (_near(normals, tried[best]) * area) @ normals
    return np.asarray(mean / np.linalg.norm(mean))


def _near(normals: Floats, direction: Floats) -> NDArray[np.bool_]:
    return np.asarray(normals @ direction >= math.cos(math.radians(_NEAR)))


def _all_around(count: int) -> Floats:
    """Return directions (n, 3) spread evenly: a spiral of golden angles."""
    z = 1 - (2 * np.arange(count) + 1) / count
    angle = np.arange(count) * math.pi * (3 - math.sqrt(5))
    across = np.sqrt(1 - z**2)
    return np.stack([across * np.cos(angle), across * np.sin(angle), z], axis=1)
