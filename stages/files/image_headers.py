"""Format and size of an image file from its first bytes, without a decoder.

The content selects the format, and only the formats below are decoded: image libraries know dozens more, and
some of those start other programs or allocate memory for any size that a header states.
"""

from __future__ import annotations

from collections.abc import Callable

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
_KTX2_MAGIC = b"\xabKTX 20\xbb\r\n\x1a\n"
# Magic bytes, extension and media type of the formats that textures have.
_TEXTURE_MAGICS = (
    (PNG_MAGIC, ".png", "image/png"),
    (b"\xff\xd8\xff", ".jpg", "image/jpeg"),
    (b"BM", ".bmp", "image/bmp"),
    (b"GIF87a", ".gif", "image/gif"),
    (b"GIF89a", ".gif", "image/gif"),
    (b"II*\0", ".tif", "image/tiff"),
    (b"MM\0*", ".tif", "image/tiff"),
    (_KTX2_MAGIC, ".ktx2", "image/ktx2"),
)
_UNKNOWN = ("", "application/octet-stream")
# Second byte of netpbm files: bitmaps, greymaps, pixmaps, and PFM.
_PNM_KINDS = b"123456fF"
# Maximum bytes of a netpbm header with comments.
_MAX_PNM_HEADER_BYTES = 4096
# Formats that are recognised only for the message about them.
_UNSUPPORTED_MAGICS = (
    (0, b"\0\0\0\x0cjP  ", "JPEG 2000"),
    (0, b"\xff\x4f\xff\x51", "JPEG 2000"),
    (4, b"ftypavif", "AVIF"),
    (4, b"ftypheic", "HEIC"),
    (4, b"ftypmif1", "HEIC"),
    (0, b"%!PS", "PostScript"),
    (0, b"DDS ", "DDS"),
    (0, b"#?RADIANCE", "Radiance HDR"),
    (0, _KTX2_MAGIC, "KTX2"),
)
# JPEG markers of a frame header, which holds the image size: SOF0-15 without DHT, JPG and DAC.
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
# JPEG markers without a length: TEM, RST0-7, SOI.
_JPEG_BARE = frozenset((0x01, *range(0xD0, 0xD9)))
_JPEG_SCAN = 0xDA
# TIFF tags of the width and height of the image and of its tiles, and bytes of the integer types.
_TIFF_WIDTHS, _TIFF_HEIGHTS = frozenset((256, 322)), frozenset((257, 323))
_TIFF_INTEGER_BYTES = {1: 1, 3: 2, 4: 4, 6: 1, 8: 2, 9: 4}
_TGA_HEADER_BYTES = 18
_TGA_IMAGE_TYPES = frozenset((1, 2, 3, 9, 10, 11))
_TGA_PIXEL_BITS = frozenset((8, 15, 16, 24, 32))


def detect_image_type(data: bytes, name: str = "") -> tuple[str, str]:
    """Detect the extension and media type of a texture image.

    Returns ("", "application/octet-stream") for other formats. TGA has no magic bytes: it needs a plausible
    header and a file name that ends in .tga.
    """
    for beginning, extension, mime in _TEXTURE_MAGICS:
        if data.startswith(beginning):
            return extension, mime
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        return ".webp", "image/webp"
    if name.lower().endswith(".tga") and _has_tga_header(data):
        return ".tga", "image/x-tga"
    return _UNKNOWN


def detect_image_format(data: bytes, name: str = "") -> str:
    """Detect the extension of an image that `decode_image` decodes; empty for every other content."""
    if data.startswith(_KTX2_MAGIC):
        return ""
    if data[:1] == b"P" and data[1:2] in {bytes((kind,)) for kind in _PNM_KINDS} and data[2:3].isspace():
        return ".pnm"
    return detect_image_type(data, name)[0]


def name_unsupported_format(data: bytes) -> str:
    """Name the format of an image that is not decoded; empty if unknown."""
    return next((name for at, magic, name in _UNSUPPORTED_MAGICS if data[at:].startswith(magic)), "")


def read_header_size(data: bytes, name: str = "") -> tuple[int, int] | None:
    """Read the (width, height) that an image header states, unchecked.

    For TIFF, the larger of image and tile. None for unknown formats and damaged headers.
    """
    read = _SIZE_READERS.get(detect_image_format(data, name) or detect_image_type(data, name)[0])
    return None if read is None else read(data)


def _read_png_size(data: bytes) -> tuple[int, int] | None:
    if len(data) < 24:
        return None
    return int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")


def _read_jpeg_size(data: bytes) -> tuple[int, int] | None:
    at = 2
    # As in decoders, bytes between two segments are skipped.
    while (at := data.find(b"\xff", at)) >= 0 and at + 9 <= len(data):
        marker = data[at + 1]
        if marker in _JPEG_FRAMES:
            return int.from_bytes(data[at + 7 : at + 9], "big"), int.from_bytes(data[at + 5 : at + 7], "big")
        if marker == _JPEG_SCAN:
            return None
        if marker in (0x00, 0xFF):
            at += 1
        else:
            at += 2 if marker in _JPEG_BARE else 2 + max(2, int.from_bytes(data[at + 2 : at + 4], "big"))
    return None


def _read_bmp_size(data: bytes) -> tuple[int, int] | None:
    if len(data) < 26:
        return None
    if int.from_bytes(data[14:18], "little") == 12:
        return int.from_bytes(data[18:20], "little"), int.from_bytes(data[20:22], "little")
    # A negative height means that the top row comes first.
    width, height = (int.from_bytes(data[at : at + 4], "little", signed=True) for at in (18, 22))
    return width, abs(height)


def _read_gif_size(data: bytes) -> tuple[int, int] | None:
    """Read the size of the screen or of the first frame, whichever is larger."""
    if len(data) < 13:
        return None
    width, height = (int.from_bytes(data[at : at + 2], "little") for at in (6, 8))
    at = 13 + (3 << (1 + (data[10] & 7)) if data[10] & 0x80 else 0)
    while data[at : at + 1] == b"!":
        at += 2
        while at < len(data) and data[at] != 0:
            at += 1 + data[at]
        at += 1
    if data[at : at + 1] == b"," and at + 10 <= len(data):
        left, top, frame_width, frame_height = (
            int.from_bytes(data[at + k : at + k + 2], "little") for k in (1, 3, 5, 7)
        )
        width, height = max(width, left + frame_width), max(height, top + frame_height)
    return width, height


def _read_tiff_size(data: bytes) -> tuple[int, int] | None:
    order = "little" if data[:2] == b"II" else "big"

    def integer(at: int, size: int) -> int:
        return int.from_bytes(data[at : at + size], order)  # type: ignore[arg-type]

    start = integer(4, 4)
    end = start + 2 + 12 * integer(start, 2)
    if not 8 <= start < end <= len(data):
        return None
    width = height = 0
    for at in range(start + 2, end, 12):
        tag = integer(at, 2)
        if tag in _TIFF_WIDTHS or tag in _TIFF_HEIGHTS:
            size = _TIFF_INTEGER_BYTES.get(integer(at + 2, 2))
            if size is None:
                return None
            value = integer(at + 8, size)
            # Readers differ in which of two equal tags is valid, so the largest one counts.
            width, height = (
                (max(width, value), height) if tag in _TIFF_WIDTHS else (width, max(height, value))
            )
    return width, height


def _read_webp_size(data: bytes) -> tuple[int, int] | None:
    if len(data) < 30:
        return None
    kind = data[12:16]
    if kind == b"VP8X":
        return 1 + int.from_bytes(data[24:27], "little"), 1 + int.from_bytes(data[27:30], "little")
    if kind == b"VP8L":
        bits = int.from_bytes(data[21:25], "little")
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    if kind == b"VP8 ":
        width, height = (int.from_bytes(data[at : at + 2], "little") & 0x3FFF for at in (26, 28))
        return width, height
    return None


def _read_tga_size(data: bytes) -> tuple[int, int]:
    return int.from_bytes(data[12:14], "little"), int.from_bytes(data[14:16], "little")


def _has_tga_header(data: bytes) -> bool:
    return (
        len(data) > _TGA_HEADER_BYTES
        and data[1] <= 1
        and data[2] in _TGA_IMAGE_TYPES
        and data[16] in _TGA_PIXEL_BITS
    )


def _read_ktx2_size(data: bytes) -> tuple[int, int] | None:
    if len(data) < 28:
        return None
    return int.from_bytes(data[20:24], "little"), int.from_bytes(data[24:28], "little")


def _read_pnm_size(data: bytes) -> tuple[int, int] | None:
    lines = data[2:_MAX_PNM_HEADER_BYTES].split(b"\n")
    # The last line may be cut, or pixels.
    words = [word for line in lines for word in line.partition(b"#")[0].split()[:3]]
    if len(words) < 2 or not all(word.isdigit() and len(word) <= 10 for word in words[:2]):
        return None
    return int(words[0]), int(words[1])


_SIZE_READERS: dict[str, Callable[[bytes], tuple[int, int] | None]] = {
    ".png": _read_png_size,
    ".jpg": _read_jpeg_size,
    ".bmp": _read_bmp_size,
    ".gif": _read_gif_size,
    ".tif": _read_tiff_size,
    ".webp": _read_webp_size,
    ".tga": _read_tga_size,
    ".pnm": _read_pnm_size,
    ".ktx2": _read_ktx2_size,
}
