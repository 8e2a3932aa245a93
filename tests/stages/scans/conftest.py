"""A tiny world with one known point, written in the convention of each layout.

The camera is 32×24 pixels with fx = fy = 100, cx = 16, cy = 12. Pixel (26, 17) has the direction (0.1, 0.05,
1), so at a depth of 2 m it shows the camera point (0.2, 0.1, 2). Frame 0 is at the origin. Frame 1 is at (1,
2, 3) and faces world +x: its axes are x = -z, y = y, z = +x, so the same pixel shows the world point (1 + 2,
2 + 0.1, 3 - 0.2) = (3, 2.1, 2.8).
"""

from pathlib import Path

import cv2
import numpy as np
import pytest
from tiny_recordings import INTERVAL, START

from scanloom.stages.frames.aligned_color import read_color_aligned_to_depth
from scanloom.stages.scans.model.images import read_depth, read_pinhole
from scanloom.stages.scans.params import ScanParams

PIXEL = (26, 17)
INTRINSICS = (100.0, 100.0, 16.0, 12.0)
WORLD_POINTS = ((0.2, 0.1, 2.0), (3.0, 2.1, 2.8))


class TinyWorld:
    """Writer of images of the tiny world, and reader of its known points."""

    intrinsics = INTRINSICS
    option = "100,100,16,12"
    points = WORLD_POINTS
    identity = np.eye(4)
    second = np.array([[0, 0, 1, 1], [0, 1, 0, 2], [-1, 0, 0, 3], [0, 0, 0, 1.0]])
    # Rotation of the second frame as a quaternion x y z w: 90° about +y.
    second_quaternion = (0.0, 0.5**0.5, 0.0, 0.5**0.5)

    def color(self, path: Path, size: tuple[int, int] = (32, 24)) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        image = np.zeros((size[1], size[0], 3), np.uint8)
        image[:, :, 2] = 200  # OpenCV writes BGR: this is red
        assert cv2.imwrite(str(path), image)

    def depth(self, path: Path, scale: float, metres: float = 2.0) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        image = np.full((24, 32), round(metres * scale), np.uint16)
        image[0, 0] = 0
        image[0, 1] = 65535
        assert cv2.imwrite(str(path), image)

    def dotted(self, factor: int) -> np.ndarray:
        """Make a grey RGB image, `factor` times as large, with a green dot at the known pixel."""
        image = np.full((24 * factor, 32 * factor, 3), 90, np.uint8)
        u, v = PIXEL
        image[v * factor : (v + 1) * factor, u * factor : (u + 1) * factor] = (10, 240, 120)
        return image

    def dotted_file(self, path: Path, factor: int) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(path), np.ascontiguousarray(self.dotted(factor)[:, :, ::-1]))

    def scaled_intrinsics(self, factor: int) -> dict[str, float]:
        """Make the camera of an image `factor` times as large; pixel centres are at integers."""
        fx, fy, cx, cy = INTRINSICS
        return {
            "fx": fx * factor,
            "fy": fy * factor,
            "cx": (cx + 0.5) * factor - 0.5,
            "cy": (cy + 0.5) * factor - 0.5,
        }

    def opengl(self, pose: np.ndarray) -> np.ndarray:
        """Convert a camera-to-world pose to a camera with y up and z back."""
        turned = pose.copy()
        turned[:3, 1:3] *= -1
        return turned

    def green_is_at_the_pixel(self, frame) -> bool:
        """Check if the colour of the dot is aligned with exactly the known pixel."""
        u, v = PIXEL
        color = read_color_aligned_to_depth(frame, read_depth(frame)).astype(int)
        green = color[:, :, 1] - color[:, :, 0]
        return green[v, u] > 200 and np.count_nonzero(green > 100) == 1

    def seen(self, frame) -> np.ndarray:
        """Compute the world point at the known pixel from depth, camera and pose of a frame."""
        u, v = PIXEL
        camera = frame.camera
        z = float(read_depth(frame)[v, u])
        point = ((u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z, 1.0)
        return (frame.world_from_camera @ point)[:3]

    def assert_views(self, scan) -> None:
        """Check that these are single views with the known points at the known pixel."""
        assert scan.is_views
        for frame, point in zip(scan.frames, WORLD_POINTS, strict=True):
            at = self.pixel(point, np.linalg.inv(frame.world_from_camera), frame.camera)
            factor = frame.camera.width / 32
            np.testing.assert_allclose((at + 0.5) / factor - 0.5, PIXEL, atol=1e-6)
            assert read_pinhole(frame).shape == (frame.camera.height, frame.camera.width, 3)

    def pixel(self, point, camera_from_world: np.ndarray, camera) -> np.ndarray:
        """Project a world point to a camera without distortion."""
        x, y, z = (camera_from_world @ (*point, 1.0))[:3]
        return np.array([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy])


@pytest.fixture(scope="session")
def tiny() -> TinyWorld:
    return TinyWorld()


def rows(matrix: np.ndarray) -> str:
    return "\n".join(" ".join(f"{value:.9g}" for value in row) for row in matrix) + "\n"


@pytest.fixture(scope="session")
def matrix_text():
    return rows


@pytest.fixture
def trajectory(tmp_path, tiny):
    """Write a trajectory with the two poses at the times of the recordings."""
    file = tmp_path / "mine.tum"
    lines = [
        (START, 0, 0, 0, 0, 0, 0, 1),
        (START + INTERVAL, 1, 2, 3, *tiny.second_quaternion),
    ]
    file.write_text("".join(f"{t / 1e9:.9f} {' '.join(map(str, row))}\n" for t, *row in lines))
    return ScanParams(poses=str(file))
