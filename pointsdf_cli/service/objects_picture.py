"""Pictures of the objects on a table with their numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.depth_images import read_colour
from pointsdf_cli.planning.list_objects import Listing
from pointsdf_cli.viz.segment_picture import label_image, segment_picture


def draw_numbers(picture: Path, listing: Listing, colour: Path | None = None) -> None:
    """Draw the objects with their numbers, on a colour image if there is one."""
    view, mine = listing.view, _numbers(listing)
    cloud, points = view.cloud, view.cloud.points
    if cloud.pixels is not None and cloud.image is not None:
        pixels, size = cloud.pixels, cloud.image.depth.shape[::-1]
    else:
        pixels, size = points[:, :2] / points[:, 2:], None
    at = [
        (item.number, tuple(np.median(pixels[mine == item.number], axis=0)))
        for item in listing.objects
    ]
    background = None if colour is None or size is None else read_colour(colour)
    segment_picture(picture, pixels, points[:, 2], mine, at, size, background)


def draw_labels(path: Path, listing: Listing) -> None:
    """Write the numbers of the objects as an image of labels, from which `--mask` takes one.

    Raises:
        InputError: The view has no image.
    """
    cloud = listing.view.cloud
    if cloud.pixels is None or cloud.image is None:
        raise InputError(
            "is a cloud without an image: it has no pixels to label",
            where=listing.view.name,
            allowed="a depth image",
            hint="leave --labels out",
        )
    height, width = cloud.image.depth.shape
    label_image(path, cloud.pixels, _numbers(listing), (width, height))


def _numbers(listing: Listing) -> NDArray[np.int64]:
    """The number [N] of each point's object; 0 for none."""
    view = listing.view
    number = np.zeros(view.objects.count + 1, dtype=np.int64)  # the last for negative labels
    for item in listing.objects:
        number[item.label] = item.number
    return np.asarray(number[np.maximum(view.label, -1)])
