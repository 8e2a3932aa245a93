"""Damage to a file of any kind, which follows the structure of its content."""

from __future__ import annotations

import random

from tests.campaign.byte_damage import damage_bytes
from tests.campaign.container_damage import CONTAINERS
from tests.campaign.json_damage import damage_json
from tests.campaign.text_damage import damage_text

# Repeated spans could grow a file to a gigabyte, for which a case has not enough memory.
_LARGEST = 1 << 26


def damage_file(data: bytes, draw: random.Random) -> bytes:
    """Apply one to three damages to the content of a file, most of them within its structure."""
    for _ in range(draw.choice((1, 1, 1, 2, 3))):
        data = (_damage_once(data, draw) if data else damage_bytes(data, draw))[:_LARGEST]
    return data


def _damage_once(data: bytes, draw: random.Random) -> bytes:
    if draw.random() < 0.25:
        return damage_bytes(data, draw)
    try:
        for start, damage in CONTAINERS:
            if data.startswith(start):
                return damage(data, draw)
        if data[:1] in b"{[" and draw.random() < 0.7:
            return damage_json(data, draw)
    # After an earlier damage, the container may be invalid; then bytes are damaged.
    except Exception:
        return damage_bytes(data, draw)
    return damage_text(data, draw) if b"\0" not in data[:2000] else damage_bytes(data, draw)
