"""Letters in pictures: the font that comes with matplotlib, without importing matplotlib."""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec
from pathlib import Path

from PIL import ImageFont

FONT = "mpl-data/fonts/ttf/DejaVuSans.ttf"


@cache
def lettering(size: int) -> ImageFont.ImageFont | ImageFont.FreeTypeFont:
    """DejaVu Sans at this size in pixels; Pillow's own font if matplotlib has none."""
    spec = find_spec("matplotlib")
    for folder in (spec.submodule_search_locations or ()) if spec else ():
        if (Path(folder) / FONT).is_file():
            return ImageFont.truetype(str(Path(folder) / FONT), size)
    return ImageFont.load_default(size)
