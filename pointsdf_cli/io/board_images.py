"""Images of a calibration board in a folder, and a board to print."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.atomic import atomic_path
from pointsdf_cli.io.depth_images import open_image

SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm")
INCH = 0.0254


def list_images(folder: Path) -> list[Path]:
    """The images of a folder, by name, numbers in their order (image2 before image10).

    Raises:
        InputError: No such folder, or it holds no images.
    """
    if not folder.is_dir():
        raise InputError("no such folder of images", where=folder)
    images = [path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES]
    found = [path for path in images if not path.name.startswith(".")]
    if not found:
        raise InputError("holds no images", where=folder, allowed=", ".join(SUFFIXES))
    return sorted(found, key=lambda path: _natural(path.name))


def _natural(name: str) -> list[tuple[int, str]]:
    return [(int(p), "") if p.isdecimal() else (-1, p) for p in re.split(r"(\d+)", name) if p]


def read_grey(path: Path) -> NDArray[np.uint8]:
    """An image as grey levels u1 [height, width]; 16-bit ones (infrared) are stretched.

    Raises:
        InputError: No such file, or no image.
    """
    with open_image(path) as image:
        if image.mode not in ("I", "I;16", "I;16B", "I;16L", "F"):
            return np.asarray(image.convert("L"))
        values = np.asarray(image, dtype=np.float64)
    low, high = np.percentile(values, [0.5, 99.5])
    return np.asarray(255 * ((values - low) / max(high - low, 1e-9)).clip(0, 1)).astype(np.uint8)


def match_poses(
    images: Sequence[Path], names: Sequence[str] | None, count: int, where: Path
) -> list[int]:
    """For each image, the index of its pose.

    Args:
        images: In order.
        names: Names of the poses, with or without suffix; None if they are in the order of the
            images.
        count: Number of poses.
        where: The file of poses, for messages.

    Raises:
        InputError: Another count, or an image has no pose, or two.
    """
    if names is None:
        if count != len(images):
            raise InputError(
                f"holds {count} poses, and there are {len(images)} images",
                where=where,
                allowed="one pose an image, in the order of the images' names, or by name",
            )
        return list(range(count))
    at: dict[str, int] = {}
    for index, name in enumerate(names):
        if name in at:
            raise InputError(f"holds two poses of {name}", where=where, allowed="one an image")
        at[name] = index
    found = [at.get(image.name, at.get(image.stem)) for image in images]
    missing = [image.name for image, index in zip(images, found, strict=True) if index is None]
    if missing:
        raise InputError(
            f"holds no pose of {', '.join(missing[:5])}"
            + (f" and {len(missing) - 5} more" if len(missing) > 5 else ""),
            where=where,
            allowed=f"one pose an image; it has those of {', '.join(list(names)[:3])}, …",
        )
    indices = [index for index in found if index is not None]
    numbered = zip(images, indices, strict=True)
    several = [image.name for image, index in numbered if indices.count(index) > 1]
    if several:
        what = f"holds one pose for {', '.join(several[:5])}"
        raise InputError(what, where=where, allowed="one an image; give the names with suffixes")
    return indices


def write_board_page(
    path: Path, board: NDArray[np.uint8], per_metre: float, caption: str
) -> tuple[float, float]:
    """Write a board to print at scale, with a caption below.

    Args:
        path: .png or .pdf.
        board: u1 [height, width], with its margin.
        per_metre: Pixels a metre.
        caption: One line.

    Returns:
        Width and height of the page, m.

    Raises:
        InputError: The folder cannot be written.
    """
    height, width = board.shape
    letters = max(10, round(0.003 * per_metre))
    page = Image.new("L", (width, height + 2 * letters), 255)
    page.paste(Image.fromarray(board), (0, 0))
    font = ImageFont.load_default(size=letters)
    ImageDraw.Draw(page).text((width / 2, height), caption, fill=0, font=font, anchor="mt")
    dpi = per_metre * INCH
    with atomic_path(path) as temporary:
        if path.suffix.lower() == ".pdf":
            page.convert("1", dither=Image.Dither.NONE).save(temporary, resolution=dpi)
        else:
            page.save(temporary, dpi=(dpi, dpi))
    return page.width / per_metre, page.height / per_metre
