"""Image files next to a mesh: names that are valid on every system."""

import io
from pathlib import Path

import numpy as np
import PIL.Image
import pytest

from scanloom.stages.surface.formats.texture_files import write_images
from scanloom.stages.surface.texture import Image


def encode_gray_png(level: int) -> bytes:
    file = io.BytesIO()
    PIL.Image.fromarray(np.full((2, 2, 3), level, np.uint8)).save(file, "png")
    return file.getvalue()


@pytest.mark.parametrize(
    ("named", "written"),
    [
        ("wall.png", "wall.png"),
        ("con.png", "_con.png"),
        ("AUX", "_AUX.png"),
        ("com1.tar.png", "_com1.tar.png"),
        ("console.png", "console.png"),
        ("../up.png", "up.png"),
        ("C:\\photos\\a:b.png", "a_b.png"),
        ("dots. . .", "dots.png"),
    ],
)
def test_file_names_are_valid_on_every_system(tmp_path: Path, named: str, written: str) -> None:
    image = Image(named, encode_gray_png(1))
    assert write_images(tmp_path / "model.obj", [image]) == {id(image): written}
    assert [path.name for path in tmp_path.iterdir()] == [written]


def test_two_images_with_the_same_name_are_both_written(tmp_path: Path) -> None:
    images = [Image("wall.png", encode_gray_png(1)), Image("wall.png", encode_gray_png(2))]
    names = write_images(tmp_path / "model.obj", images)
    assert len(set(names.values())) == 2
    assert [(tmp_path / names[id(image)]).read_bytes() for image in images] == [
        encode_gray_png(1),
        encode_gray_png(2),
    ]
