"""Contact sheets: a folder of meshes as one picture of shaded tiles, drawn without a display.

Each tile is ray cast by Open3D, so nothing here needs a window, OpenGL or Vulkan. The tile is
scaled to its own mesh; the caption under it tells the true size.
"""

from __future__ import annotations

import colorsys
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.open3d_core import o3d
from pointsdf_cli.io.atomic import atomic_path
from pointsdf_cli.io.meshes import load_mesh
from pointsdf_cli.viz.lettering import lettering

BACKGROUND = (250, 250, 248)
INK = (40, 40, 44)
FAINT_INK = (120, 120, 126)
# Rays are cast on a grid this many times finer than the tile and averaged: smooth edges.
SUPERSAMPLING = 2
# Few hues, so that a palette of 256 colours has many shades of each.
HUES, SHADES = 10, 24
COLUMNS, TILE = 6, 200
"""Tiles per row, and the sides of a tile [pixels]."""
AZIMUTH, ELEVATION = np.deg2rad(-55.0), np.deg2rad(28.0)


@dataclass(frozen=True)
class SheetItem:
    """One tile of a contact sheet.

    Attributes:
        vertices: [V, 3] m, +z up.
        faces: [F, 3] vertex indices, counter-clockwise seen from outside.
        label: The line in bold under the tile, above the size; equal labels share a colour.
    """

    vertices: np.ndarray
    faces: np.ndarray
    label: str


def shaded_view(
    vertices: np.ndarray,
    faces: np.ndarray,
    size: int,
    colour: tuple[float, float, float] = (0.55, 0.65, 0.8),
    azimuth: float = AZIMUTH,
    elevation: float = ELEVATION,
    framing: np.ndarray | None = None,
) -> np.ndarray:
    """Orthographic picture of a mesh, lit by its face normals, filling the tile.

    Args:
        vertices: [V, 3] m, +z up.
        faces: [F, 3].
        size: Pixels on each side.
        colour: RGB in [0, 1].
        azimuth: Direction from the mesh to the camera, radians about +z from +x.
        elevation: The same, above the horizon.
        framing: [N, 3] what fills the tile, where it is more than the mesh itself.

    Returns:
        uint8 [size, size, 3].
    """
    level = np.cos(elevation)
    towards_camera = np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    up = np.cross(towards_camera, right)
    basis = np.stack([right, up, towards_camera])
    seen = (vertices if framing is None else framing) @ basis.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    centre = (low + high) / 2
    half = max(float((high - low)[:2].max()) / 2, 1e-9) * 1.08

    fine = size * SUPERSAMPLING
    ticks = (np.arange(fine) + 0.5) / fine * 2 - 1
    x, y = np.meshgrid(centre[0] + half * ticks, centre[1] - half * ticks)
    origin = np.stack([x, y, np.full_like(x, high[2] + half)], axis=-1) @ basis
    direction = np.broadcast_to(-towards_camera, origin.shape)
    normal, depth = _cast(vertices, faces, origin, direction)

    # Back faces, which only a mesh that is not closed shows, are painted red.
    facing = normal @ towards_camera
    key = np.clip(normal @ _unit(0.35 * right + 0.75 * up + 0.75 * towards_camera), 0, 1)
    fill = np.clip(normal @ _unit(-0.9 * right + 0.1 * up + 0.4 * towards_camera), 0, 1)
    light = 0.16 + 0.68 * key + 0.22 * fill
    picture = np.asarray(colour) * light[..., None]
    picture = np.where((facing < 0)[..., None], (0.8, 0.1, 0.1), picture)
    # A dark line where the depth jumps makes handles and rims readable.
    jump = _depth_jump(depth) > 0.06 * half
    picture = np.where(jump[..., None], picture * 0.55, picture)
    picture = np.where(np.isinf(depth)[..., None], np.asarray(BACKGROUND) / 255, picture)
    picture = picture.reshape(size, SUPERSAMPLING, size, SUPERSAMPLING, 3).mean(axis=(1, 3))
    return (np.clip(picture, 0, 1) * 255).astype(np.uint8)


def _cast(
    vertices: np.ndarray, faces: np.ndarray, origin: np.ndarray, direction: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Normals [H, W, 3] and distances [H, W] m of what rays hit first; inf where nothing."""
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(vertices.astype(np.float32), faces.astype(np.uint32))
    hits = scene.cast_rays(np.concatenate([origin, direction], axis=-1).astype(np.float32))
    return hits["primitive_normals"].numpy(), hits["t_hit"].numpy()


def draw_sheet(items: Sequence[SheetItem]) -> Image.Image:
    """All items in rows, each with its label and size below.

    Raises:
        InputError: No item.
    """
    if not items:
        raise InputError("there is no mesh to draw", where="contact sheet")
    columns = min(COLUMNS, len(items))
    rows = -(-len(items) // columns)
    text = max(10, TILE // 16)
    pitch = TILE + 2 * text + text
    gap = TILE // 20
    sheet = Image.new("RGB", (columns * (TILE + gap) + gap, rows * pitch + gap), color=BACKGROUND)
    pen = ImageDraw.Draw(sheet)
    for index, item in enumerate(items):
        left = gap + (index % columns) * (TILE + gap)
        top = gap + (index // columns) * pitch
        # By the text alone: `hash` is salted per process.
        colour = _hue_colour(zlib.crc32(item.label.encode()) % HUES)
        tile = shaded_view(item.vertices, item.faces, TILE, colour)
        sheet.paste(Image.fromarray(tile), (left, top))
        middle = left + TILE // 2
        below, size = top + TILE + int(1.25 * text), size_caption(item.vertices)
        pen.text((middle, top + TILE), item.label, INK, lettering(text, bold=True), anchor="mt")
        pen.text((middle, below), size, FAINT_INK, lettering(text), anchor="mt")
    return sheet


def write_sheet(path: Path, items: Sequence[SheetItem]) -> None:
    """Draw a sheet and write it as a palette PNG (small enough to keep in a repository)."""
    sheet = draw_sheet(items).quantize(palette=_palette(), dither=Image.Dither.NONE)
    with atomic_path(Path(path)) as temporary:
        sheet.save(temporary, format="PNG", optimize=True)


def items_from_files(meshes: Sequence[Path]) -> list[SheetItem]:
    """A tile for each mesh file, labelled by its name without a leading number."""
    items = []
    for path in meshes:
        mesh = load_mesh(path)
        number, _, rest = mesh.name.partition("_")
        numbered = rest and number.replace("-", "").isalnum() and number[0].isdigit()
        name = rest if numbered else mesh.name
        items.append(SheetItem(mesh.vertices, mesh.faces, name.replace("_", " ")[:26]))
    return items


def size_caption(vertices: np.ndarray) -> str:
    """The bounding box of [V, 3] m vertices as text in centimetres."""
    extent = np.ptp(vertices, axis=0) * 100
    return "{:.1f} × {:.1f} × {:.1f} cm".format(*extent)


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


def _depth_jump(depth: np.ndarray) -> np.ndarray:
    """Largest depth step to the right and lower neighbour, [H, W]; 0 where both miss."""
    finite = np.where(np.isinf(depth), 1e3, depth)
    jump = np.zeros_like(finite)
    jump[:, :-1] = np.abs(np.diff(finite, axis=1))
    jump[:-1] = np.maximum(jump[:-1], np.abs(np.diff(finite, axis=0)))
    return jump


def _hue_colour(index: int) -> tuple[float, float, float]:
    return colorsys.hls_to_rgb(index / HUES, 0.68, 0.42)


def _palette() -> Image.Image:
    """All 256 colours of a sheet: every hue from dark to light, and greys up to the background."""
    light = np.linspace(0.05, 1.06, SHADES)
    hues = np.array([_hue_colour(index) for index in range(HUES)])
    greys = np.linspace(np.array(INK), np.array(BACKGROUND), 256 - HUES * SHADES)
    shades = np.clip(hues[:, None] * light[:, None], 0, 1).reshape(-1, 3) * 255
    image = Image.new("P", (1, 1))
    image.putpalette(np.concatenate([shades, greys]).round().astype(np.uint8).ravel().tolist())
    return image
