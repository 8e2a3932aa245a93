"""Up direction and scale of the world coordinates of a scan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

Direction = tuple[float, float, float]

Y_UP: Direction = (0.0, 1.0, 0.0)
Z_UP: Direction = (0.0, 0.0, 1.0)
Y_DOWN: Direction = (0.0, -1.0, 0.0)
Z_DOWN: Direction = (0.0, 0.0, -1.0)
_DIRECTION_NAMES = {Y_UP: "y up", Z_UP: "z up", Y_DOWN: "y down", Z_DOWN: "z down"}


@dataclass(frozen=True)
class WorldUp:
    """Up direction of the world.

    Attributes
    ----------
    direction : unit vector.
    source : origin of the information, such as `layout polycam: y up`.
    """

    direction: Direction
    source: str

    def to_dict(self) -> dict[str, Any]:
        """Return direction and source under the keys of the stage `upright`."""
        return {"up": list(self.direction), "up_source": self.source}


def create_layout_up(name: str, direction: Direction) -> WorldUp:
    """Create the up direction that a layout defines.

    `direction` is an axis constant of this module.
    """
    return WorldUp(direction, f"layout {name}: {_DIRECTION_NAMES[direction]}")


@dataclass(frozen=True)
class Scale:
    """Conversion of the world unit to metres.

    Attributes
    ----------
    metres_per_unit : factor that was applied to all lengths.
    source : origin of the information, such as `given`.
    spread_ratio : maximum relative deviation of individual measurements; None if nothing was measured.
    """

    metres_per_unit: float
    source: str
    spread_ratio: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return all fields as a JSON object."""
        return {
            "metres_per_unit": self.metres_per_unit,
            "source": self.source,
            "spread_ratio": self.spread_ratio,
        }
