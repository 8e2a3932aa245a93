"""Damage to a file of any kind, with what its content shows of its structure."""

from __future__ import annotations

import random

from tests.campaign.byte_damage import damaged_bytes
from tests.campaign.container_damage import CONTAINERS
from tests.campaign.json_damage import damaged_json
from tests.campaign.text_damage import damaged_text

# A part repeated a thousand times, of which a part is: a gigabyte, for which a case has no room.
_LARGEST = 1 << 26


def damaged(data: bytes, draw: random.Random) -> bytes:
    """Return the content of a file with one to three damages, most of them within its structure."""
    for _ in range(draw.choice((1, 1, 1, 2, 3))):
        data = (_once(data, draw) if data else damaged_bytes(data, draw))[:_LARGEST]
    return data


def _once(data: bytes, draw: random.Random) -> bytes:
    if draw.random() < 0.25:
        return damaged_bytes(data, draw)
    try:
        for start, damage in CONTAINERS:
            if data.startswith(start):
                return damage(data, draw)
        if data[:1] in b"{[" and draw.random() < 0.7:
            return damaged_json(data, draw)
    # What an earlier damage left may be no container any more; whatever then fails, its bytes are there.
    except Exception:
        return damaged_bytes(data, draw)
    return damaged_text(data, draw) if b"\0" not in data[:2000] else damaged_bytes(data, draw)
