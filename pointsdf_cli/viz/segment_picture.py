"""Pictures of the objects on a table, numbered in the image of the view."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from pointsdf_cli.io.atomic import atomic_path

COLOURS = (
    (230, 25, 75),
    (60, 180, 75),
    (0, 130, 200),
    (245, 130, 48),
    (145, 30, 180),
    (70, 200, 220),
    (240, 50, 230),
    (120, 110, 0),
)
LARGEST = 960
"""Longer side [px] of the picture of a cloud without an image."""


def segment_picture(
    path: Path,
    pixels: NDArray[np.float64],
    depth: NDArray[np.float64],
    number: NDArray[np.int64],
    labels: Sequence[tuple[int, tuple[float, float]]],
    size: tuple[int, int] | None = None,
    background: NDArray[np.uint8] | None = None,
) -> None:
    """Draw every object in a colour of its own with its number on it.

    Args:
        path: PNG to write.
        pixels: [N, 2], (u, v) of all points; any projection for a cloud without an image.
        depth: [N], m.
        number: [N], number of each point's object; 0 for none.
        labels: Number of each object and the pixel for writing it.
        size: (width, height) of the image; None fits the picture to the points.
        background: u1 [height, width, 3] to draw on; None shades the depths.
    """
    if size is None:
        low, high = _shown(pixels, number > 0)
        kept = ((pixels >= low) & (pixels <= high)).all(axis=1)
        pixels, depth, number = pixels[kept], depth[kept], number[kept]
        scale = LARGEST / max(float((high - low).max()), 1e-9)
        pixels = (pixels - low) * scale
        labels = [(k, tuple((np.asarray(at) - low) * scale)) for k, at in labels]
        width, height = (int(n) + 1 for n in pixels.max(axis=0))
    else:
        width, height = size
    u, v = np.clip(np.rint(pixels), 0, [width - 1, height - 1]).astype(int).T
    image = _shaded(u, v, depth, width, height) if background is None else background.copy()
    on = np.zeros((height, width), dtype=np.int64)
    on[v, u] = number
    if size is None:
        on = scipy.ndimage.grey_dilation(on, size=(7, 7))
    for k, _ in labels:
        colour = np.array(COLOURS[(k - 1) % len(COLOURS)])
        mine = on == k
        edge = mine & ~scipy.ndimage.binary_erosion(mine, iterations=2)
        image[mine] = (0.65 * image[mine] + 0.35 * colour).astype(np.uint8)
        image[edge] = colour
    drawing = Image.fromarray(image)
    draw, font = ImageDraw.Draw(drawing), ImageFont.load_default(22)
    for k, at in labels:
        left, top, right, bottom = draw.textbbox(at, str(k), font=font, anchor="mm")
        draw.rectangle((left - 4, top - 4, right + 4, bottom + 4), fill=(255, 255, 255))
        draw.text(at, str(k), font=font, anchor="mm", fill=COLOURS[(k - 1) % len(COLOURS)])
    with atomic_path(path) as temporary:
        drawing.save(temporary, format="PNG")


def label_image(
    path: Path, pixels: NDArray[np.float64], number: NDArray[np.int64], size: tuple[int, int]
) -> None:
    """Write an image of labels: each pixel's value is the number of its object, shown in a colour
    of its own.

    Args:
        path: PNG with a palette.
        pixels: [N, 2], (u, v) of all points.
        number: [N], number of each point's object, up to 255; 0 for none.
        size: (width, height).
    """
    on = np.zeros(size[::-1], dtype=np.uint8)
    u, v = np.clip(np.rint(pixels), 0, np.subtract(size, 1)).astype(int).T
    on[v, u] = number
    image = Image.fromarray(on, "P")
    shown = [COLOURS[k % len(COLOURS)] for k in range(255)]
    image.putpalette([0, 0, 0, *(value for colour in shown for value in colour)])
    with atomic_path(path) as temporary:
        image.save(temporary, format="PNG")


def _shown(
    pixels: NDArray[np.float64], on_object: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lower and upper bounds [2] of what is drawn: all objects, and all but the outermost points,
    as few points near the lens lie far outside."""
    low, high = np.percentile(pixels, [1, 99], axis=0)
    if on_object.any():
        mine = pixels[on_object]
        low, high = np.minimum(low, mine.min(axis=0)), np.maximum(high, mine.max(axis=0))
    edge = 0.05 * (high - low)
    return np.maximum(low - edge, pixels.min(axis=0)), np.minimum(high + edge, pixels.max(axis=0))


def _shaded(
    u: NDArray[np.int64], v: NDArray[np.int64], depth: NDArray[np.float64], width: int, height: int
) -> NDArray[np.uint8]:
    """Depths as shades of grey, near ones light; white where nothing was seen."""
    near, far = np.percentile(depth, [1, 99])
    shade = 220 - 160 * np.clip((depth - near) / max(far - near, 1e-6), 0, 1)
    image = np.full((height, width), 255, dtype=np.uint8)
    image[v, u] = shade.astype(np.uint8)
    return np.repeat(image[..., None], 3, axis=2)
