"""Depth and colour images from files in the formats of camera tools and ROS."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.input_files import read_input, require_suffix
from pointsdf_cli.io.untrusted import is_whole_number, read_npy_array

DEPTH_SUFFIXES = (".png", ".tif", ".tiff", ".pgm", ".npy")
LARGEST_PIXELS = 64_000_000
LONGEST_HEAD = 1 << 20
"""Bytes of a PGM file that its header and comments may take up."""


def check_scale(scale: float | None) -> None:
    """Refuse a number of metres a unit that is out of its range."""
    if scale is not None and not 1e-6 <= scale <= 10:
        raise InputError(
            f"{scale} m a unit", where="--depth-scale", allowed="0.000001 to 10; 0.001 for mm"
        )


def read_depth(path: Path | str, scale: float | None = None) -> tuple[NDArray[np.float64], float]:
    """A depth image f8 [height, width] in m along z, 0 where the camera saw nothing, and the scale
    that was taken.

    Args:
        path: 16-bit (or 32-bit float) PNG, TIFF or PGM, or an NPY array.
        scale: Metres a unit. None takes 0.001 (millimetres) for whole numbers, 1 for others.

    Raises:
        InputError: No such file, no depth image, negative depths only, or a scale that is not
            positive.
    """
    path = Path(path)
    check_scale(scale)
    values = _array(path) if path.suffix.lower() == ".npy" else _image(path)
    if values.ndim == 3 and values.shape[2] == 1:
        values = values[..., 0]
    if values.ndim != 2 or not values.size:
        what = f"is of shape {values.shape}, and a depth image has one number a pixel"
        raise InputError(what, where=path, allowed="[height, width]")
    if values.dtype == np.uint8 or values.dtype.kind not in "uif":
        raise InputError(
            f"holds {values.dtype} values: a picture of depths, not depths",
            where=path,
            allowed="16-bit whole numbers or floats, as the camera measured them",
        )
    if scale is None:
        scale = 0.001 if values.dtype.kind in "ui" else 1.0
    depth = values.astype(np.float64) * scale
    if not (depth > 0).any() and (depth < 0).any():
        raise InputError(
            "has negative depths only",
            where=path,
            allowed="positive depths along z, as of a camera that looks along +z",
            hint="negate them: OpenGL's cameras look along −z",
        )
    return np.where(np.isfinite(depth) & (depth > 0), depth, 0.0), scale


def read_colour(path: Path | str) -> NDArray[np.uint8]:
    """A colour image u1 [height, width, 3].

    Raises:
        InputError: No such file, or no image.
    """
    with open_image(Path(path)) as image:
        return np.asarray(image.convert("RGB"))


LABELS = 64
"""Largest number of different values in an image of labels; one of more is a mask with soft
edges."""
PHOTOGRAPH = 0.9
"""Share of pixels that are not 0 above which an image of many values is no mask."""


def mask_file(text: str) -> tuple[Path, int | None]:
    """The image and the number in `PATH` or `PATH:NUMBER`; None without a number."""
    before, colon, after = text.rpartition(":")
    if colon and is_whole_number(after) and not Path(text).exists():
        return Path(before), int(after)
    return Path(text), None


def read_mask(text: str, shape: tuple[int, int] | None = None) -> NDArray[np.bool_]:
    """A mask bool [height, width]: where an image is not 0, or has one number.

    Args:
        text: An image's path, or `PATH:NUMBER` for the pixels of that number in an image of labels.
            Of a colour image any channel counts; a transparent pixel is 0.
        shape: [height, width] that it must have; any if None.

    Raises:
        InputError: No such image, another size, nothing in it, or the numbers of several objects.
    """
    path, number = mask_file(text)
    has_palette = False
    if path.suffix.lower() == ".npy":
        values = _array(path)
    else:
        with open_image(path) as image:
            if image.format == "JPEG":
                what = "is a JPEG, which changes a mask's values"
                raise InputError(what, where=path, allowed="a mask as PNG, TIFF, BMP or NPY")
            # The numbers of a palette are labels, its colours are not.
            has_palette = image.mode == "P"
            plain = image.mode if image.mode in ("P", "L", "1", "I", "I;16", "F") else "RGBA"
            values = np.asarray(image if image.mode == plain else image.convert(plain))
            if values.ndim == 3:
                values = values[..., :3].max(axis=2) * (values[..., 3] > 0)
    if values.ndim != 2 or values.dtype.kind not in "buif":
        raise InputError(f"is of shape {values.shape}", where=path, allowed="[height, width]")
    if shape is not None and values.shape != shape:
        raise InputError(
            f"has {values.shape[1]} × {values.shape[0]} pixels and the depth image {shape[1]} × "
            f"{shape[0]}",
            where=path,
            allowed="a mask of the depth image's size",
            hint="resize it with nearest-neighbour sampling",
        )
    if number is None:
        _require_one_object(values, path, has_palette)
    mask = values != 0 if number is None else values == number
    if not mask.any():
        there = ", ".join(f"{value:g}" for value in np.unique(values)[:20])
        raise InputError(
            "is 0 everywhere" if number is None else f"has no pixel of the number {number}",
            where=path,
            allowed="a mask that is not 0 where the object is"
            if number is None
            else f"numbers in it: {there}",
        )
    return np.asarray(mask)


def _require_one_object(values: NDArray[Any], path: Path, has_palette: bool) -> None:
    """Refuse a photograph, and an image of labels of which none is named.

    Raises:
        InputError: It is a photograph, or holds negative numbers, NaN or those of several objects.
    """
    numbers = np.unique(values[values != 0])
    if not (numbers >= 0).all():
        raise InputError(
            f"holds {numbers[~(numbers >= 0)][0]:g}",
            where=path,
            allowed="a mask: 0 beside the object, positive numbers on it",
            hint=f"name the object's number: --mask {path}:NUMBER",
        )
    # 255 is the foreground of masks, whose edges may have other numbers; of a palette, a label.
    if 1 < len(numbers) <= LABELS and (has_palette or numbers[-1] != 255):
        raise InputError(
            f"holds {len(numbers)} numbers besides 0: {', '.join(f'{n:g}' for n in numbers[:12])}",
            where=path,
            allowed="a mask of one object",
            hint=f"name the object's number: --mask {path}:{numbers[0]:g}",
        )
    if len(numbers) > LABELS and (values != 0).mean() > PHOTOGRAPH:
        what = f"looks like a photograph: {len(numbers)} values, {(values != 0).mean():.0%} not 0"
        raise InputError(what, where=path, allowed="a mask: 0 beside the object")


def _image(path: Path) -> NDArray:
    require_suffix(path, DEPTH_SUFFIXES, "format of depth images")
    with open_image(path) as image:
        if image.mode in ("RGB", "RGBA", "P", "CMYK"):
            raise InputError(
                "is a colour picture, and depths are one number a pixel",
                where=path,
                allowed="the camera's 16-bit depth image, not its coloured preview",
            )
        values = np.asarray(image)
        return values if image.format != "PPM" else _as_stored(values, path)


def _as_stored(values: NDArray, path: Path) -> NDArray:
    """Values stored in a PGM file: Pillow stretches them so that the header's greatest value
    becomes 255 or 65535, but depths need the stored ones."""
    head = re.sub(rb"#[^\n]*", b" ", read_input(path, "image")[:LONGEST_HEAD]).split(maxsplit=4)
    if len(head) < 4 or not head[3].isdigit():
        raise InputError(
            "has no readable PGM header", where=path, allowed="P5, width, height, greatest value"
        )
    if head[0] not in (b"P2", b"P5"):
        return values
    greatest = int(head[3])
    shown = 255 if values.dtype == np.uint8 else 65535
    return np.rint(values * (greatest / shown)).astype(values.dtype)


@contextmanager
def open_image(path: Path) -> Iterator[Image.Image]:
    """An image file, opened.

    Raises:
        InputError: No such file, no image, one of over `LARGEST_PIXELS` pixels, or damaged where it
            is read.
    """
    try:
        with warnings.catch_warnings():  # of sizes that are refused below
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            image = Image.open(io.BytesIO(read_input(path, "image")))
    except (UnidentifiedImageError, OSError, ValueError, SyntaxError) as error:
        raise InputError("is not an image, or damaged", where=path) from error
    except Image.DecompressionBombError as error:
        raise InputError("is far too large for a camera's image", where=path) from error
    with image:
        if image.width * image.height > LARGEST_PIXELS:
            what = f"has {image.width} × {image.height} pixels"
            raise InputError(
                what, where=path, allowed=f"at most {LARGEST_PIXELS // 1_000_000} million pixels"
            )
        try:
            yield image
        except (OSError, ValueError, SyntaxError) as error:
            raise InputError("is damaged or cut short", where=path) from error


def _array(path: Path) -> NDArray:
    values = read_npy_array(path, "image")
    if values.size > LARGEST_PIXELS:
        raise InputError(f"has {values.size} pixels", where=path)
    return values
