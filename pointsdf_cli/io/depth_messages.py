"""Depths from ROS image messages: raw, `compressedDepth`, and plain PNG."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.depth_images import LARGEST_PIXELS

_ENCODINGS = {"16UC1": ("u2", 0.001), "mono16": ("u2", 0.001), "32FC1": ("f4", 1.0)}
_DEPTH_HEADER = 12
"""Bytes before the PNG of a compressedDepth image: the format and two parameters."""


def depth_of_message(
    message: Any, path: Path, topic: str, scale: float | None = None
) -> NDArray[np.float32]:
    """Depths f4 [height, width] in m of an Image or CompressedImage message; 0 for no return.

    Args:
        message: The deserialised message.
        path: The bag, for error messages.
        topic: The message's topic, for error messages.
        scale: Metres a unit; None for those of the encoding.

    Raises:
        InputError: Another encoding or compression, or a damaged image.
    """
    read = _compressed if hasattr(message, "format") else _raw
    values = read(message, path, topic, scale)
    return np.where(np.isfinite(values) & (values > 0), values, 0).astype(np.float32)


def _raw(message: Any, path: Path, topic: str, scale: float | None) -> NDArray[Any]:
    width, height, step = int(message.width), int(message.height), int(message.step)
    if message.encoding not in _ENCODINGS:
        what = f"images on {topic} are {message.encoding}, no depths"
        raise InputError(what, where=path, allowed=", ".join(_ENCODINGS))
    kind, own = _ENCODINGS[message.encoding]
    number = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    data = np.ascontiguousarray(message.data)
    whole = min(width, height) > 0 and width * height <= LARGEST_PIXELS
    if not whole or step < width * number.itemsize or data.nbytes < step * height:
        raise InputError(f"an image on {topic} is cut short", where=path)
    rows = data.view(np.uint8)[: step * height].reshape(height, step)
    return rows[:, : width * number.itemsize].copy().view(number) * np.float64(scale or own)


def _compressed(message: Any, path: Path, topic: str, scale: float | None) -> NDArray[Any]:
    """16UC1 and 32FC1 as `compressedDepth` (PNG) writes them, and 16UC1 as a plain PNG."""
    form, data = str(message.format), np.ascontiguousarray(message.data).tobytes()
    encoding = form.partition(";")[0].strip()
    header = _DEPTH_HEADER if "compressedDepth" in form else 0
    png = data[header:].startswith(b"\x89PNG")
    if not png or encoding not in _ENCODINGS or (encoding == "32FC1" and not header):
        raise InputError(
            f"images on {topic} are compressed as {form!r}, which is not read",
            where=path,
            allowed="uncompressed images, or compressedDepth with PNG",
            hint="ros2 run image_transport republish compressedDepth raw, and record that; or "
            "record the uncompressed topic",
        )
    try:
        with Image.open(io.BytesIO(data[header:])) as image:
            if image.width * image.height > LARGEST_PIXELS or not image.mode.startswith("I"):
                raise ValueError(image.mode)
            values = np.asarray(image).astype(np.float64)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise InputError(f"an image on {topic} is not a 16-bit PNG", where=path) from error
    if encoding != "32FC1":
        return values * (scale or _ENCODINGS[encoding][1])
    # Floats are kept as inverse depths: value = a / depth + b.
    a, b = np.frombuffer(data[4:header], "<f4").astype(np.float64)
    return (scale or 1.0) * np.divide(a, values - b, out=np.zeros_like(values), where=values > 0)
