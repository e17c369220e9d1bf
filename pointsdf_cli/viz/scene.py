"""Scene for viewers as pure data: parts fixed to bodies, and frames in which the bodies move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pointsdf_cli.errors import InputError

KINDS = ("mesh", "points", "lines")
WORLD = -1
"""Index of the body that never moves."""

Colour = tuple[float, float, float]

AXES: tuple[Colour, ...] = ((0.85, 0.1, 0.1), (0.1, 0.6, 0.1), (0.15, 0.25, 0.9))
"""Colours of the axes of a frame."""


@dataclass(frozen=True)
class Part:
    """One part of a scene.

    Attributes:
        name: Name of the part.
        layer: Name of the layer; parts of a layer are shown and hidden together.
        kind: Way of drawing it. Lines join vertices 0-1, 2-3, and so on.
        vertices: [V, 3], in the body's frame, m; kept as f4.
        faces: [F, 3] of a mesh, kept as i4; None for the others.
        colour: Red, green, blue in [0, 1], or f4 [V, 3] with one for each vertex.
        body: Index into `Scene.bodies`, or WORLD.
        frame: The only frame that shows it; None for all.
        opacity: Opacity; 1 is solid.
    """

    name: str
    layer: str
    kind: Literal["mesh", "points", "lines"]
    vertices: NDArray[np.floating]
    faces: NDArray[np.integer] | None = None
    colour: Colour | NDArray[np.float32] = (0.6, 0.6, 0.6)
    body: int = WORLD
    frame: int | None = None
    opacity: float = 1.0

    def __post_init__(self) -> None:
        if self.kind not in KINDS or (self.kind == "mesh") != (self.faces is not None):
            raise InputError(f"a part of kind {self.kind!r}", allowed=", ".join(KINDS))
        object.__setattr__(self, "vertices", np.asarray(self.vertices, np.float32))
        if self.faces is not None:
            object.__setattr__(self, "faces", np.asarray(self.faces, np.int32))

    def vertex_colours(self) -> NDArray[np.float32]:
        """Colours f4 [V, 3] of the vertices."""
        colours = np.asarray(self.colour, dtype=np.float32)
        return np.ascontiguousarray(np.broadcast_to(colours, self.vertices.shape))


@dataclass(frozen=True)
class Scene:
    """A scene of moving bodies.

    Attributes:
        title: Title of the scene.
        parts: Parts to draw.
        bodies: Names of the B moving bodies.
        poses: f8 [F, B, 4, 4], body in world, for each of F frames; NaN for a body not shown.
        captions: [F], descriptions of the frames.
        slider: Meaning of a frame, such as "time" or "view".
        rate: Frames a second when played.
        facts: Names and values to print beside the picture.
    """

    title: str
    parts: tuple[Part, ...]
    bodies: tuple[str, ...] = ()
    poses: NDArray[np.float64] = field(default_factory=lambda: np.zeros((1, 0, 4, 4)))
    captions: tuple[str, ...] = ("",)
    slider: str = "frame"
    rate: float = 4.0
    facts: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        if self.poses.shape != (len(self.captions), len(self.bodies), 4, 4):
            wanted = f"{len(self.captions)} frames of {len(self.bodies)} bodies"
            what = f"poses of shape {self.poses.shape} for {wanted}"
            raise InputError(what, allowed="[F, B, 4, 4]")
        for part in self.parts:
            if not WORLD <= part.body < len(self.bodies):
                raise InputError(f"{part.name!r} is fixed to no body", allowed=str(self.bodies))

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.captions)

    @property
    def layers(self) -> tuple[str, ...]:
        """Names of the layers, in order of first occurrence."""
        return tuple(dict.fromkeys(part.layer for part in self.parts))

    def pose(self, body: int, frame: int) -> NDArray[np.float64]:
        """Pose [4, 4] of a body in the world; NaN if it is not shown."""
        return np.eye(4) if body == WORLD else self.poses[frame, body]

    def bounds(self) -> NDArray[np.float64]:
        """Bounding box (low, high) [2, 3] without table, axes and camera, world, m.

        Bodies count at their first pose.
        """
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        there = np.logical_and.reduce(np.isfinite(self.poses), axis=(2, 3))
        for part in self.parts:
            if part.layer in ("table", "axes", "camera") or not len(part.vertices):
                continue
            seen = [0] if part.body == WORLD else np.flatnonzero(there[:, part.body])
            if not len(seen):
                continue
            pose = self.pose(part.body, int(seen[0]))
            points = part.vertices @ pose[:3, :3].T + pose[:3, 3]
            low, high = np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0))
        return (
            np.stack([low, high]) if np.isfinite(low).all() else np.array([[-0.5] * 3, [0.5] * 3])
        )


def joined(scenes: Sequence[Scene]) -> Scene:
    """Join scenes in one world; at most one of them may move.

    Raises:
        InputError: Two of them have frames of their own.
    """
    moving = [scene for scene in scenes if scene.frames > 1]
    if len(moving) > 1:
        raise InputError(
            f"{moving[0].title} and {moving[1].title} each have a slider of their own",
            allowed="one artifact that moves (plan, grasps, views, trials), others that rest",
        )
    if len(scenes) == 1:
        return scenes[0]
    lead = moving[0] if moving else scenes[0]
    bodies: list[str] = []
    poses, parts = [], []
    for scene in scenes:
        start = len(bodies)
        bodies += scene.bodies
        poses.append(np.broadcast_to(scene.poses, (lead.frames, *scene.poses.shape[1:])))
        still = scene is not lead
        for part in scene.parts:
            body = part.body if part.body == WORLD else part.body + start
            parts.append(replace(part, body=body, frame=None if still else part.frame))
    return replace(
        lead,
        title=" + ".join(scene.title for scene in scenes),
        parts=tuple(parts),
        bodies=tuple(bodies),
        poses=np.concatenate(poses, axis=1),
        facts=tuple(fact for scene in scenes for fact in scene.facts),
    )


def axes(name: str, layer: str, size: float, body: int = WORLD) -> Part:
    """A frame's axes as lines of length `size` [m]: x red, y green, z blue."""
    vertices = np.zeros((6, 3))
    vertices[[1, 3, 5], [0, 1, 2]] = size
    colour = np.repeat(AXES, 2, axis=0)
    return Part(name, layer, "lines", vertices, None, colour.astype(np.float32), body)


def by_height(points: ArrayLike) -> NDArray[np.float32]:
    """Colours f4 [N, 3] from violet to yellow along z of points [N, 3]."""
    values = np.asarray(points, dtype=np.float64)[:, 2]
    if not len(values):
        return np.zeros((0, 3), np.float32)
    low, high = np.percentile(values, [2, 98])
    where = np.clip((values - low) / max(high - low, 1e-9), 0, 1)
    stops = np.array([[0.27, 0, 0.33], [0.13, 0.57, 0.55], [0.99, 0.85, 0.14]])
    mixed = [np.interp(where, [0, 0.5, 1], stops[:, k]) for k in range(3)]
    return np.stack(mixed, axis=1).astype(np.float32)
