"""Annotations on images: captions and scale bars."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from scanloom.stages.rendering.render import RenderModel
from scanloom.stages.rendering.viewpoints import Viewpoint
from scanloom.stages.scans.model.scan import ColorImage

# Font size as a ratio of the image's height and its minimum in pixels, and margin as a ratio of the height.
_FONT_RATIO, _MIN_FONT_PX = 1 / 32, 11
_MARGIN_RATIO = 1 / 40
# Maximum length of the bar as a ratio of the image's width.
_MAX_BAR_RATIO = 0.25
_INK, _PAPER = (29, 37, 48, 255), (255, 255, 255, 205)
# Rays along each side of an image that search for the surface if its centre shows none.
_FOCUS_RAYS = 24


class ScaleBar(NamedTuple):
    """Scale bar with a round length.

    Attributes
    ----------
    length, depth : length of the bar and depth at which it is valid, metres.
    pixels : length in the image.
    """

    length: float
    depth: float
    pixels: float

    @property
    def label(self) -> str:
        """Label with the length and the depth, because perspective scales with depth."""
        return f"{format_length(self.length)} at {self.depth:.3g} m"


def choose_scale_bar(viewpoint: Viewpoint, depth: float) -> ScaleBar:
    """Choose the longest scale bar that fits, at a depth in metres.

    Its length is 1, 2 or 5 times a power of ten.
    """
    per_metre = viewpoint.camera.fx / depth
    max_length = _MAX_BAR_RATIO * viewpoint.camera.width / per_metre
    power = 10.0 ** np.floor(np.log10(max_length))
    length = float(next(digit * power for digit in (5, 2, 1) if digit * power <= max_length * (1 + 1e-9)))
    return ScaleBar(length, depth, length * per_metre)


def find_focus(model: RenderModel, viewpoint: Viewpoint) -> float | None:
    """Return the depth of the surface at the centre of an image, metres.

    If the centre shows no surface, return the median depth of the visible surface, or None if nothing is
    visible.
    """
    camera = viewpoint.camera
    middle = np.array([[(camera.width - 1) / 2, (camera.height - 1) / 2]])
    found = model.measure_depths(viewpoint, middle)
    if not len(found):
        across, down = (np.linspace(0, size - 1, _FOCUS_RAYS) for size in (camera.width, camera.height))
        found = model.measure_depths(viewpoint, np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2))
    return float(np.median(found)) if len(found) else None


def draw_caption(image: ColorImage, text: str) -> ColorImage:
    """Draw a caption at the upper left of an image, truncated to its width."""
    drawing = _AnnotationDrawing(image)
    drawing.draw_panel(drawing.truncate(text), drawing.margin, drawing.margin)
    return drawing.to_array()


def draw_scale_bar(image: ColorImage, bar: ScaleBar) -> ColorImage:
    """Draw a scale bar at the lower left of an image."""
    drawing = _AnnotationDrawing(image)
    drawing.draw_bar(bar)
    return drawing.to_array()


def format_length(length: float) -> str:
    """Format a length in mm, cm or m."""
    if length < 0.00999:
        return f"{1000 * length:.4g} mm"
    return f"{100 * length:.4g} cm" if length < 0.999 else f"{length:.4g} m"


class _AnnotationDrawing:
    """Drawing context for annotations on an image, based on Pillow."""

    def __init__(self, image: ColorImage) -> None:
        from PIL import Image, ImageDraw, ImageFont

        self._picture = Image.fromarray(image)
        # RGBA mode blends translucent colours with the image.
        self._draw: Any = ImageDraw.Draw(self._picture, "RGBA")
        height = image.shape[0]
        self._size = max(round(_FONT_RATIO * height), _MIN_FONT_PX)
        self._font: Any = ImageFont.load_default(self._size)
        self.margin = max(round(_MARGIN_RATIO * height), 4)
        self._pad = max(self._size // 3, 3)

    def truncate(self, text: str) -> str:
        available_width = self._picture.width - 2 * (self.margin + self._pad)
        if self._draw.textlength(text, self._font) <= available_width:
            return text
        while text and self._draw.textlength(text + "…", self._font) > available_width:
            text = text[:-1]
        return text + "…"

    def draw_panel(self, text: str, left: float, top: float) -> None:
        """Draw text on a light panel with its upper left corner at (left, top)."""
        wide = self._draw.textlength(text, self._font) + 2 * self._pad
        high = self._size + 2 * self._pad
        self._draw.rounded_rectangle((left, top, left + wide, top + high), self._pad, fill=_PAPER)
        self._draw.text((left + self._pad, top + high / 2), text, fill=_INK, font=self._font, anchor="lm")

    def draw_bar(self, bar: ScaleBar) -> None:
        """Draw a scale bar with its label above."""
        text = self.truncate(bar.label)
        thick = max(self._size // 5, 2)
        wide = max(bar.pixels, self._draw.textlength(text, self._font)) + 2 * self._pad
        high = self._size + thick + 3 * self._pad
        left, top = self.margin, self._picture.height - self.margin - high
        self._draw.rounded_rectangle((left, top, left + wide, top + high), self._pad, fill=_PAPER)
        at = (left + self._pad, top + self._pad + self._size / 2)
        self._draw.text(at, text, fill=_INK, font=self._font, anchor="lm")
        low = top + high - self._pad
        # −1 because Pillow includes the last pixel of a rectangle.
        right = left + self._pad + round(bar.pixels) - 1
        self._draw.rectangle((left + self._pad, low - thick, right, low - 1), fill=_INK)

    def to_array(self) -> ColorImage:
        return np.asarray(self._picture, np.uint8)
