"""KTX2 images: encoded and decoded with the Node package, and the messages without it."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from browsers import PAGE, require_ktx2_packages, run_node

from scanloom.stages.diagnostics.errors import InputError, MeshError, StageError
from scanloom.stages.files import ktx2
from scanloom.stages.files.image_headers import detect_image_format, detect_image_type, read_header_size
from scanloom.stages.files.images import read_stored_image
from scanloom.stages.files.ktx2 import IMAGE_KINDS, decode_ktx2, encode_ktx2, require_ktx2_encoder
from scanloom.stages.surface.texture import Image

DESCRIBE = Path(__file__).resolve().parents[2] / "made" / "describe_ktx2.mjs"
# Values of the KTX2 specification.
BASIS_LZ, ZSTANDARD, ETC1S, UASTC = 1, 2, 163, 166
LINEAR, SRGB, UNSPECIFIED, BT709 = 1, 2, 0, 1
HEADER = b"\xabKTX 20\xbb\r\n\x1a\n" + bytes(8) + (64).to_bytes(4, "little") + (32).to_bytes(4, "little")


@pytest.fixture
def encoder(monkeypatch):
    require_ktx2_packages(monkeypatch)


def make_ramp(channels: int = 3) -> np.ndarray:
    """Make a smooth image of 64 × 32 pixels."""
    y, x = np.mgrid[:32, :64]
    ramp = np.stack([4 * x, 8 * y, 255 - 4 * x, 40 + 3 * x], axis=2)
    return ramp[:, :, :channels].astype(np.uint8)


def make_checkerboard() -> np.ndarray:
    y, x = np.mgrid[:64, :64]
    return np.repeat((255 * ((x + y) & 1)).astype(np.uint8)[:, :, None], 3, axis=2)


@pytest.mark.slow
@pytest.mark.parametrize("kind", IMAGE_KINDS)
@pytest.mark.usefixtures("encoder")
def test_images_are_read_back(kind):
    ramp = make_ramp()
    data = encode_ktx2(ramp, kind, 90)
    assert data == encode_ktx2(ramp, kind, 90)
    assert read_header_size(data) == (64, 32)
    back = decode_ktx2(data)
    assert back.shape == ramp.shape
    error = np.abs(back.astype(int) - ramp)
    assert error.mean() < (8 if kind == "color" else 2)


@pytest.mark.slow
@pytest.mark.usefixtures("encoder")
def test_alpha_is_kept():
    back = decode_ktx2(encode_ktx2(make_ramp(4), "color", 90))
    assert back.shape == (32, 64, 4)
    assert np.abs(back[:, :, 3].astype(int) - make_ramp(4)[:, :, 3]).mean() < 8


@pytest.mark.slow
@pytest.mark.usefixtures("encoder")
def test_a_higher_quality_is_closer_and_larger():
    noise = np.random.default_rng(1).integers(0, 256, (8, 8, 3)).astype(np.uint8)
    image = np.kron(noise, np.ones((16, 16, 1), np.uint8)) // 2 + np.random.default_rng(2).integers(
        0, 120, (128, 128, 3)
    ).astype(np.uint8)
    found = [(encode_ktx2(image, "color", quality)) for quality in (10, 60, 100)]
    assert len(found[0]) < len(found[1]) < len(found[2])
    errors = [float(((decode_ktx2(data).astype(float) - image) ** 2).mean()) for data in found]
    assert errors[0] > errors[1] > errors[2]


@pytest.mark.slow
@pytest.mark.usefixtures("encoder")
def test_headers_follow_the_use_of_an_image(tmp_path):
    for kind in IMAGE_KINDS:
        (tmp_path / kind).write_bytes(encode_ktx2(make_checkerboard(), kind, 90))
    (tmp_path / "alpha").write_bytes(encode_ktx2(make_ramp(4), "color", 90))
    said = run_node(DESCRIBE, PAGE / "node_modules", tmp_path)
    for name, header in said.items():
        is_color = name in ("color", "alpha")
        assert header["layout"] == [0, 0, 1]
        assert header["scheme"] == (BASIS_LZ if is_color else ZSTANDARD)
        assert header["colorModel"] == (ETC1S if is_color else UASTC)
        assert header["transferFunction"] == (SRGB if is_color else LINEAR)
        assert header["colorPrimaries"] == (BT709 if is_color else UNSPECIFIED)
        assert header["hasAlpha"] == (name == "alpha")
        # All levels down to one texel.
        assert len(header["means"]) == 7
    # Black and white mix to grey in linear light: 188 in sRGB.
    for name, grey in (("color", 188), ("normal", 128), ("data", 128)):
        assert said[name]["means"][1][0] == pytest.approx(grey, abs=2)


@pytest.mark.slow
@pytest.mark.usefixtures("encoder")
def test_damaged_images_are_no_images():
    data = encode_ktx2(make_ramp(), "color", 90)
    shuffled = np.random.default_rng(1).permutation(np.frombuffer(data[80:], np.uint8)).tobytes()
    for damaged in (data[:-40], data[:80] + shuffled, HEADER + bytes(80)):
        assert decode_ktx2(damaged) is None
    with pytest.raises(MeshError, match="cannot be decoded"):
        _ = Image("a.ktx2", data[:-40]).pixels


def test_claimed_sizes_are_not_trusted():
    """No process is started for sizes that no texture has."""
    for claimed in (0, 1 << 15, (1 << 32) - 1):
        assert decode_ktx2(HEADER[:20] + 2 * claimed.to_bytes(4, "little") + bytes(40)) is None
    assert decode_ktx2(HEADER[:24]) is None


def test_ktx2_is_an_image_of_meshes_only(tmp_path):
    assert detect_image_type(HEADER) == (".ktx2", "image/ktx2")
    assert detect_image_format(HEADER) == ""
    (tmp_path / "a.png").write_bytes(HEADER + bytes(100))
    with pytest.raises(InputError, match="KTX2 images are not supported"):
        read_stored_image(tmp_path / "a.png")


def use_tools(monkeypatch, folder: Path, *names: str) -> None:
    """Let PATH contain only the named tools."""
    folder.mkdir()
    for name in names:
        if shutil.which(name) is None:
            pytest.skip(f"{name} is missing")
        (folder / name).symlink_to(shutil.which(name))
    monkeypatch.setenv("PATH", str(folder))
    monkeypatch.delenv("NODE_PATH", raising=False)


def make_package(folder: Path, code: str) -> None:
    """Make a package of the encoder's name that runs other code."""
    package = folder / "ktx2-encoder"
    package.mkdir(parents=True)
    description = {"type": "module", "version": "0.1.0", "exports": {".": {"node": {"import": "./a.js"}}}}
    (package / "package.json").write_text(json.dumps(description), "utf-8")
    (package / "a.js").write_text(code, "utf-8")


def test_without_node_the_message_names_what_to_install(monkeypatch, tmp_path):
    use_tools(monkeypatch, tmp_path / "bin")
    with pytest.raises(InputError, match="install Node, then run `npm install --global ktx2-encoder`"):
        encode_ktx2(make_ramp(), "color", 90)
    with pytest.raises(MeshError, match="KTX2 images require Node"):
        _ = Image("a.ktx2", HEADER + bytes(80)).pixels


@pytest.mark.skipif(os.name == "nt", reason="links to tools need rights on Windows")
def test_packages_of_the_working_folder_are_not_run(monkeypatch, tmp_path):
    use_tools(monkeypatch, tmp_path / "bin", "node")
    make_package(tmp_path / "scan" / "node_modules", "throw new Error('run')")
    monkeypatch.chdir(tmp_path / "scan")
    for path in ("", os.pathsep):
        monkeypatch.setenv("NODE_PATH", path)
        with pytest.raises(InputError, match="run `npm install --global ktx2-encoder`, or set NODE_PATH"):
            encode_ktx2(make_ramp(), "color", 90)


@pytest.mark.skipif(os.name == "nt", reason="a script is no program on Windows")
def test_global_packages_are_found(monkeypatch, tmp_path):
    use_tools(monkeypatch, tmp_path / "bin", "node")
    make_package(tmp_path / "lib" / "node_modules", "")
    npm = tmp_path / "bin" / "npm"
    npm.write_text(f'#!/bin/sh\ntest "$*" = "root --global" && echo "{tmp_path}/lib/node_modules"\n', "utf-8")
    npm.chmod(0o755)
    assert require_ktx2_encoder()[1] == tmp_path / "lib" / "node_modules" / "ktx2-encoder"


@pytest.mark.skipif(shutil.which("node") is None, reason="Node is missing")
@pytest.mark.parametrize(
    ("code", "seconds", "message"),
    [
        ("throw new Error('broken wheel')", 60.0, r"64 × 32 texels \(Error: broken wheel\)"),
        ("process.exit(0)", 60.0, r"\(exit code 0\)"),
        ("await new Promise((done) => setTimeout(done, 60000))", 0.5, r"\(no answer within 0 s\)"),
        (
            "class B { async init() { return { BasisEncoder: class {} } } }\n"
            "export { B as NodeBasisEncoder }",
            60.0,
            "version 0.1.0 of ktx2-encoder is too old",
        ),
    ],
)
def test_a_failing_encoder_is_one_error(monkeypatch, tmp_path, code, seconds, message):
    make_package(tmp_path / "modules", code)
    monkeypatch.setenv("NODE_PATH", str(tmp_path / "modules"))
    monkeypatch.setattr(ktx2, "_ENCODER_LIMIT_S", seconds)
    with pytest.raises(StageError, match=message):
        encode_ktx2(make_ramp(), "color", 90)
