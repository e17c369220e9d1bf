"""Pictures of attempts, and the report on a folder of grasps."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from pointsdf_cli.choices import GRASP_KINDS
from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.io.atomic import atomic_path
from pointsdf_cli.io.grasps import CAUSES, HELD, LOST, Grasps, GraspsMeta
from pointsdf_cli.io.meshes import LoadedMesh
from pointsdf_cli.viz import html
from pointsdf_cli.viz.robot_picture import RobotMeshes
from pointsdf_cli.viz.shading import Painted, Stage, look_at, table_mesh

OBJECT_COLOUR = (0.25, 0.60, 0.35)
Frame = tuple[NDArray[np.float64], NDArray[np.float64]]
"""A configuration [J] and the object's T_world_object [4, 4]."""


@dataclass(frozen=True)
class Film:
    """One attempt to draw.

    Attributes:
        title: Title of the strip or film.
        mesh: The object.
        frames: Moments of it, in order.
        beside: Further bodies drawn in each; may be empty.
    """

    title: str
    mesh: LoadedMesh
    frames: Sequence[Frame]
    beside: Sequence[Sequence[Painted]] = ()


def placed(
    mesh: LoadedMesh, pose: NDArray[np.float64], colour: tuple[float, float, float]
) -> Painted:
    """A mesh at a pose [4, 4] in the world."""
    return Painted(apply_transform(pose, mesh.vertices), mesh.faces.astype(int), colour)


def draw_frame(
    robot: RobotMeshes,
    mesh: LoadedMesh,
    frame: Frame,
    eye: NDArray[np.float64],
    target: NDArray[np.float64],
    size: tuple[int, int] = (300, 260),
    oversampling: int = 2,
    beside: Sequence[Painted] = (),
) -> NDArray[np.uint8]:
    """One moment [height, width, 3], seen from `eye` [3] towards `target` [3]."""
    q, pose = frame
    scene = [*robot.at(q), table_mesh(), placed(mesh, pose, OBJECT_COLOUR), *beside]
    return Stage(scene).image(look_at(eye, target), size, 0.62, oversampling)


def film_strip(robot: RobotMeshes, film: Film) -> NDArray[np.uint8]:
    """All frames side by side, seen from one place."""
    return np.concatenate(_drawn(robot, film), axis=1)


def write_gif(path: Path, robot: RobotMeshes, film: Film, rate: float) -> None:
    """An attempt as an animated GIF with `rate` frames a second."""
    images = [Image.fromarray(image).quantize(64) for image in _drawn(robot, film)]
    others, duration = images[1:], round(1000 / rate)
    with atomic_path(path) as temporary:
        images[0].save(temporary, save_all=True, append_images=others, duration=duration, loop=0)


def grasp_report(
    items: Sequence[tuple[str, Grasps, GraspsMeta]],
    refused: Sequence[tuple[str, str]],
    strips: Sequence[tuple[str, NDArray[np.uint8]]],
    title: str,
) -> str:
    """Page on grasps: rates by split, kind, cause and object; pictures; skipped files with reasons.

    Args:
        items: Name, attempts and description of every object.
        refused: Name and reason of every mesh that could not be used.
        strips: Captions and pictures.
        title: Title of the page.
    """
    counts = ("attempts", "executed", "held", "held of executed")
    by_object = [(name, meta.split, *_counts(grasps.label)) for name, grasps, meta in items]
    parts = [
        html.heading("Rates"),
        html.table(("split", "kind", *counts), _rates(items)),
        html.heading("What became of the attempts"),
        html.table(("cause", *GRASP_KINDS), _causes(items)),
    ]
    if strips:
        parts.append(html.heading("Before, closed, gripped, lifted, settled"))
        for caption, image in strips:
            parts += [html.note(caption), html.png(png_bytes(image), caption)]
    parts += [html.heading("By object"), html.table(("object", "split", *counts), by_object)]
    if refused:
        parts += [html.heading("Skipped"), html.table(("object", "reason"), refused)]
    return html.page(title, parts)


def share(part: int, whole: int) -> str:
    """A percentage, or a dash for none of none."""
    return f"{part / whole:.1%}" if whole else "–"


def png_bytes(image: NDArray[np.uint8]) -> bytes:
    """An image [height, width, 3] as PNG."""
    buffer = io.BytesIO()
    Image.fromarray(image).quantize(128).save(buffer, format="png", optimize=True)
    return buffer.getvalue()


def _rates(items: Sequence[tuple[str, Grasps, GraspsMeta]]) -> list[tuple[object, ...]]:
    rows: list[tuple[object, ...]] = []
    for split in ("train", "test"):
        of_split = [grasps for _, grasps, meta in items if meta.split == split]
        for i, kind in enumerate(GRASP_KINDS):
            labels = [grasps.label[grasps.kind == i] for grasps in of_split]
            rows.append((split, kind, *_counts(np.concatenate([[], *labels]))))
    return rows


def _counts(label: NDArray) -> tuple[int, int, int, str]:
    """Attempts with labels [G], executed and held ones, and the share of these two."""
    executed, held = int((label >= LOST).sum()), int((label == HELD).sum())
    return len(label), executed, held, share(held, executed)


def _causes(items: Sequence[tuple[str, Grasps, GraspsMeta]]) -> list[tuple[object, ...]]:
    counts = np.zeros((len(CAUSES), len(GRASP_KINDS)), dtype=int)
    for _, grasps, _ in items:
        np.add.at(counts, (grasps.cause, grasps.kind), 1)
    return [(cause, *map(int, row)) for cause, row in zip(CAUSES, counts, strict=True)]


EYES = ((0.55, -0.65, 0.35), (0.55, 0.65, 0.35), (0.85, 0.0, 0.35), (0.0, -0.85, 0.35))
"""Possible camera positions relative to the target [m]."""


def _drawn(robot: RobotMeshes, film: Film) -> list[NDArray[np.uint8]]:
    """All frames [height, width, 3], seen from one place."""
    eye, target = _viewpoint(robot, film)
    beside = film.beside or [()] * len(film.frames)
    return [
        draw_frame(robot, film.mesh, frame, eye, target, beside=parts)
        for frame, parts in zip(film.frames, beside, strict=True)
    ]


def _viewpoint(robot: RobotMeshes, film: Film) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Eye and target [3] of the view in which the hand hides least of the object."""
    middle = (film.mesh.vertices.min(axis=0) + film.mesh.vertices.max(axis=0)) / 2
    pose = film.frames[0][1]
    # A little above the object's first position.
    target = np.array([*(pose[:3, :3] @ middle + pose[:3, 3])[:2], 0.13])
    last = len(film.frames) - 1
    moments = [film.frames[k] for k in sorted({0, last // 2, last})]

    def seen(eye: NDArray[np.float64]) -> int:
        """Smallest number of object pixels over all frames."""
        counts = []
        for moment in moments:
            small = draw_frame(robot, film.mesh, moment, eye, target, (60, 52), 1).astype(int)
            # Green above red and blue, whatever the shade: only the object is painted so.
            red, green, blue = np.moveaxis(small, -1, 0)
            counts.append(int(((green > red + 8) & (green > blue + 8)).sum()))
        return min(counts)

    return max((target + eye for eye in EYES), key=seen), target
