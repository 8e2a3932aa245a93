"""What is known of the world of a scan's poses: which way is up in it, and how long a unit of it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

Direction = tuple[float, float, float]

Y_UP: Direction = (0.0, 1.0, 0.0)
Z_UP: Direction = (0.0, 0.0, 1.0)
Y_DOWN: Direction = (0.0, -1.0, 0.0)
Z_DOWN: Direction = (0.0, 0.0, -1.0)
_IN_WORDS = {Y_UP: "y up", Z_UP: "z up", Y_DOWN: "y down", Z_DOWN: "z down"}


@dataclass(frozen=True)
class WorldUp:
    """Which way is up.

    Attributes
    ----------
    direction : of length 1.
    source : how it is known, such as `layout polycam: y up`.
    """

    direction: Direction
    source: str

    def figures(self) -> dict[str, Any]:
        """Return both, as the stage `upright` calls them."""
        return {"up": list(self.direction), "up_source": self.source}


def up_of_layout(name: str, direction: Direction) -> WorldUp:
    """Return what is up by the definition of a layout; `direction` is one of those above."""
    return WorldUp(direction, f"layout {name}: {_IN_WORDS[direction]}")


@dataclass(frozen=True)
class Scale:
    """How long a unit of the world was that is in metres now.

    Attributes
    ----------
    metres_per_unit : what its lengths were multiplied by.
    source : how it is known, such as `given`.
    spread_share : by which share of it what was measured disagrees; None where nothing was.
    """

    metres_per_unit: float
    source: str
    spread_share: float | None = None

    def figures(self) -> dict[str, Any]:
        """Return all, ready for JSON."""
        return {
            "metres_per_unit": self.metres_per_unit,
            "source": self.source,
            "spread_share": self.spread_share,
        }
