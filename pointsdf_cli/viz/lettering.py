"""Letters in pictures: the font that comes with matplotlib, without importing matplotlib."""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec
from pathlib import Path

from PIL import ImageFont

FONTS = Path("mpl-data/fonts/ttf")


@cache
def lettering(size: int, bold: bool = False) -> ImageFont.ImageFont | ImageFont.FreeTypeFont:
    """DejaVu Sans at this size in pixels; Pillow's own font if matplotlib has none."""
    spec = find_spec("matplotlib")
    for folder in (spec.submodule_search_locations or ()) if spec else ():
        font = folder / FONTS / ("DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf")
        if font.is_file():
            return ImageFont.truetype(str(font), size)
    return ImageFont.load_default(size)
