"""The views of key frames: their features are kept, their images as far as there is room."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from threading import Lock

from scanloom.stages.registration.features import Features
from scanloom.stages.registration.view import View, read_view
from scanloom.stages.scans.model.scan import Frame

# Views whose images are kept, of 0.3 MB each; others are read again when they are asked for.
_HELD = 256


class KeyViews:
    """Views by the frame's place in the scan; any thread may ask."""

    def __init__(self, frames: Sequence[Frame], max_depth: float) -> None:
        self.features: dict[int, Features] = {}
        self._frames = frames
        self._max_depth = max_depth
        self._held: OrderedDict[int, View] = OrderedDict()
        self._lock = Lock()

    def keep(self, number: int, view: View) -> None:
        """Take in the view of a place; the one not asked for longest makes room for it."""
        with self._lock:
            self.features[number] = view.features
            self._held[number] = view
            self._held.move_to_end(number)
            if len(self._held) > _HELD:
                self._held.popitem(last=False)

    def view(self, number: int) -> View:
        """Return the view of a place that was taken in before."""
        with self._lock:
            view = self._held.get(number)
            if view is not None:
                self._held.move_to_end(number)
                return view
        view = read_view(self._frames[number], self._max_depth, self.features[number])
        self.keep(number, view)
        return view
