"""Damage inside containers, with valid sizes and checksums: ZIP, NPY, GLB, PLY."""

from __future__ import annotations

import io
import random
import re
import struct
import zipfile
from collections.abc import Callable

from tests.campaign.byte_damage import damage_bytes
from tests.campaign.json_damage import damage_json
from tests.campaign.text_damage import damage_text

_GLB_HEADER = struct.Struct("<4sII")
_GLB_CHUNK = struct.Struct("<II")
_PLY_END = b"end_header\n"


def damage_zip(data: bytes, draw: random.Random) -> bytes:
    """Damage, remove, copy or rename one member; the archive stays valid."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = [(info.filename, archive.read(info)) for info in archive.infolist()]
    at = draw.randrange(len(members))
    name, content = members[at]
    match draw.randrange(8):
        case 0:
            del members[at]
        case 1:
            members.append((name + "x", content))
        case 2:
            members[at] = (draw.choice(members)[0] + "2", content)
        case 3:
            members[at] = (name, draw.choice(members)[1])
        case _:
            members[at] = (name, _damage_member(content, draw))
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", draw.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as archive:
        for name, content in dict(members).items():
            archive.writestr(name, content)
    return out.getvalue()


def _damage_member(content: bytes, draw: random.Random) -> bytes:
    if content[:6] != b"\x93NUMPY":
        try:
            return damage_json(content, draw)
        except ValueError:
            return damage_bytes(content, draw)
    end = 10 + int.from_bytes(content[8:10], "little")
    if draw.random() < 0.4:
        return content[:10] + _replace_header(content[10:end], draw) + content[end:]
    return content[:end] + damage_bytes(content[end:], draw)


def _replace_header(header: bytes, draw: random.Random) -> bytes:
    """Change shape or type in the header of a NumPy array; the length stays the same."""
    text = header.decode("latin-1").rstrip()
    shape = draw.choice(
        ("()", "(0,)", "(1,)", "(3, 3)", "(-1,)", "(2305843009213693952, 3)", "(7, 0)", "'a'")
    )
    kind = draw.choice(
        ("<f4", "<f8", "<i4", "<i8", "|u1", "<U8", "|O", "|S9", "<c16", "|b1", ">f8", "<M8[s]")
    )
    if draw.random() < 0.5:
        text = re.sub(r"'shape': \([^)]*\)", f"'shape': {shape}", text)
    else:
        text = re.sub(r"'descr': '[^']*'", f"'descr': '{kind}'", text)
    return text.encode("latin-1").ljust(len(header) - 1)[: len(header) - 1] + b"\n"


def damage_glb(data: bytes, draw: random.Random) -> bytes:
    """Damage the JSON or the binary chunk of a GLB file; sizes are valid, so that the parser is reached."""
    chunks = []
    at = _GLB_HEADER.size
    while at + _GLB_CHUNK.size <= len(data):
        size, kind = _GLB_CHUNK.unpack_from(data, at)
        at += _GLB_CHUNK.size
        chunks.append((kind, data[at : at + size]))
        at += size
    which = 0 if draw.random() < 0.7 else draw.randrange(len(chunks))
    kind, content = chunks[which]
    content = damage_json(content, draw) if which == 0 else damage_bytes(content, draw)
    chunks[which] = (kind, content + b" " * (-len(content) % 4))
    body = b"".join(_GLB_CHUNK.pack(len(content), kind) + content for kind, content in chunks)
    return _GLB_HEADER.pack(b"glTF", 2, _GLB_HEADER.size + len(body)) + body


def damage_ply(data: bytes, draw: random.Random) -> bytes:
    """Damage the header of a PLY file, or the rows below it."""
    head, end, rows = data.partition(_PLY_END)
    if draw.random() < 0.6:
        return damage_text(head, draw) + end + rows
    damage = damage_text if b"format ascii" in head else damage_bytes
    return head + end + damage(rows, draw)


# Containers are recognised by the start of the content, because a file name may not state the format.
CONTAINERS: tuple[tuple[bytes, Callable[[bytes, random.Random], bytes]], ...] = (
    (b"PK\x03\x04", damage_zip),
    (b"glTF", damage_glb),
    (b"ply\n", damage_ply),
)
