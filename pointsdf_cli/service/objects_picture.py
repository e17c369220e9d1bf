"""Picture of the objects on a table with their numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pointsdf_cli.io.depth_images import read_colour
from pointsdf_cli.planning.list_objects import Listing
from pointsdf_cli.viz.segment_picture import segment_picture


def draw_numbers(picture: Path, listing: Listing, colour: Path | None = None) -> None:
    """Draw the objects with their numbers, on a colour image if there is one."""
    view = listing.view
    number = np.zeros(view.objects.count, dtype=np.int64)
    for item in listing.objects:
        number[item.label] = item.number
    label = view.label
    mine = np.where(label >= 0, number[np.maximum(label, 0)], 0) if len(number) else label * 0
    points = view.all_points
    if view.all_pixels is not None and view.image is not None:
        pixels, size = view.all_pixels, view.image.depth.shape[::-1]
    else:
        pixels, size = points[:, :2] / points[:, 2:], None
    at = [
        (item.number, tuple(np.median(pixels[mine == item.number], axis=0)))
        for item in listing.objects
    ]
    background = None if colour is None or size is None else read_colour(colour)
    segment_picture(picture, pixels, points[:, 2], mine, at, size, background)
