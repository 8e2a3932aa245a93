"""Camera models: distortion, blur, vignetting, noise, quantisation and depth holes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from lit_scene import LitScene
from numpy.typing import NDArray
from paints import Floats

from scanloom.stages.scans.model.scan import Camera, Pose

_RAYS_PER_PIXEL = 2  # rays per pixel and direction, against aliasing of fine texture
_BLUR = 0.55  # standard deviation of the lens blur, pixels
_FULL_WELL = 9000.0  # electrons at white; shot noise is their square root
_READ_NOISE = 12.0  # electrons
_CORNER_BRIGHTNESS = 0.82  # relative brightness in the corners of the image (vignetting)


@dataclass(frozen=True)
class DepthSensor:
    """Errors of a structured-light sensor.

    Attributes
    ----------
    constant, quadratic, offset : the axial noise is constant + quadratic · (z - offset)², metres.
    disparity_step : disparity times depth of one quantisation step, metres; 0 for no quantisation other than
        to millimetres. Depth steps are then disparity_step · z².
    """

    constant: float = 0.0008
    quadratic: float = 0.0016
    offset: float = 0.0
    disparity_step: float = 0.0


SAMPLE_SENSOR = DepthSensor()


def photograph(
    scene: LitScene,
    camera: Camera,
    world_from_camera: Pose,
    rng: np.random.Generator,
    *,
    rays_per_pixel: int = _RAYS_PER_PIXEL,
) -> NDArray[np.uint8]:
    """Simulate a photo (h, w, 3) uint8 RGB.

    Parameters
    ----------
    rays_per_pixel : along each image axis.
    """
    import cv2

    height, width = camera.height, camera.width
    fine_u, fine_v = (
        (np.arange(size * rays_per_pixel) + 0.5) / rays_per_pixel - 0.5 for size in (width, height)
    )
    rays = _compute_rays(camera, *np.meshgrid(fine_u, fine_v))
    distance, normals, parts = scene.cast(world_from_camera[:3, 3], rays @ world_from_camera[:3, :3].T)
    hit = np.flatnonzero(np.isfinite(distance))
    # Outside the scene there is a uniform grey background, without texture to match.
    color = np.full((len(rays), 3), 0.36)
    points = world_from_camera[:3, 3] + distance[hit, None] * (rays[hit] @ world_from_camera[:3, :3].T)
    color[hit] = scene.color(points, normals[hit], parts[hit])
    linear = (color**2.2).reshape(height, rays_per_pixel, width, rays_per_pixel, 3).mean(axis=(1, 3))
    linear = cv2.GaussianBlur(linear, (0, 0), _BLUR)
    u, v = np.meshgrid(np.linspace(-1, 1, width), np.linspace(-1, 1, height))
    linear *= (1 - (1 - _CORNER_BRIGHTNESS) * (u * u + v * v) / 2)[:, :, None]
    electrons = rng.poisson(linear * _FULL_WELL) + rng.normal(0, _READ_NOISE, linear.shape)
    return np.asarray(np.rint(255 * (electrons / _FULL_WELL).clip(0, 1) ** (1 / 2.2)), np.uint8)


def measure_depth(
    scene: LitScene,
    camera: Camera,
    world_from_camera: Pose,
    rng: np.random.Generator,
    *,
    sensor: DepthSensor = SAMPLE_SENSOR,
    scale: Floats | float = 1.0,
) -> NDArray[np.uint16]:
    """Simulate a depth map (h, w) uint16 of a structured-light sensor.

    Values are in millimetres, 0 where missing. Axial and lateral noise follow Nguyen, Izadi and Lovell,
    "Modeling Kinect sensor noise for improved 3D reconstruction and tracking" (2012): σ_z grows with the
    square of the distance, edges shift by about half a pixel. Depth is missing at grazing angles and at many
    depth discontinuities.

    Parameters
    ----------
    scale : factor on the depth of each pixel (h, w), an error of calibration.
    """
    import cv2

    height, width = camera.height, camera.width
    u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    rays = _compute_rays(camera, *(a + 0.4 * rng.standard_normal(a.shape) for a in (u, v)))
    directions = rays @ world_from_camera[:3, :3].T
    distance, normals, _ = scene.cast(world_from_camera[:3, 3], directions)
    z = np.where(np.isfinite(distance), distance * rays[:, 2], 0).reshape(height, width)
    cosine = -np.einsum("kx,kx->k", normals, directions).reshape(height, width)

    # Neighbouring pixels share part of their matching window, so their errors are correlated.
    error = cv2.GaussianBlur(rng.standard_normal(z.shape), (0, 0), 0.7) * 2.2
    measured = z * scale + error * (sensor.constant + sensor.quadratic * (z - sensor.offset) ** 2)
    if sensor.disparity_step > 0:
        with np.errstate(divide="ignore", invalid="ignore"):
            measured = 1 / (np.rint(1 / (sensor.disparity_step * measured)) * sensor.disparity_step)
    lost = (z == 0) | (cosine < 0.14 + 0.06 * rng.random(z.shape)) | (rng.random(z.shape) < 0.004)
    jump = cv2.morphologyEx(np.where(z > 0, z, 9.0), cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > 0.03
    lost |= jump & (rng.random(z.shape) < 0.7)
    blotches = cv2.GaussianBlur(rng.standard_normal(z.shape), (0, 0), 3.0)
    lost |= blotches > 2.6 * blotches.std()
    return np.asarray(np.rint(np.where(lost, 0, measured) * 1000), np.uint16)


def _compute_rays(camera: Camera, u: Floats, v: Floats) -> Floats:
    """Compute unit viewing directions (k, 3) of pixels of a distorted image."""
    bent_x, bent_y = (u.ravel() - camera.cx) / camera.fx, (v.ravel() - camera.cy) / camera.fy
    k1, k2, p1, p2 = camera.distortion or (0.0, 0.0, 0.0, 0.0)
    x, y = bent_x, bent_y
    # Fixed-point inverse of OpenCV's lens model; converges for mild distortion.
    for _ in range(30 if camera.distortion else 0):
        r2 = x * x + y * y
        radial = 1 + k1 * r2 + k2 * r2 * r2
        x, y = (
            (bent_x - 2 * p1 * x * y - p2 * (r2 + 2 * x * x)) / radial,
            (bent_y - p1 * (r2 + 2 * y * y) - 2 * p2 * x * y) / radial,
        )
    rays = np.stack([x, y, np.ones_like(x)], axis=1)
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))
