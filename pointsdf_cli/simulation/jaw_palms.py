"""Palm poses of a hand with jaws, which close on the object across a width that fits them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pointsdf_cli.choices import TOP
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import cross_matrix, transform
from pointsdf_cli.robot.jaws import Jaws
from pointsdf_cli.simulation.faces import Box, Face, box_along

DEPTH_NOISE = 0.012
"""Standard deviation of how deep the object is between the jaws [m]."""
UNSEEN = 0.02
"""Largest shift of the middle away from the camera [m]: the seen points lack the object's back."""
TURNS = 18
"""Directions in a quarter turn that are tried for the narrowest outline."""
SHIFT = 0.35
"""Largest shift from the middle along the pads, as a share of the object's half extent there: any
place of a bottle's height will do."""
PLACE_NOISE, TURN_NOISE = 0.004, 0.05
"""Standard deviations across the jaws [m], and about each axis [rad]."""
NEAREST = 0.003
"""Least distance of the palm to the face, and depth of the object between the pads [m]."""


def snug_box(points: Array) -> Box:
    """The upright box of least outline around points [N, 3], seen from above.

    Jaws need the narrowest direction; principal axes of a square's two visible sides are its
    diagonals.
    """
    turns = np.arange(TURNS) * (np.pi / 2 / TURNS)
    boxes = [box_along(points, np.array([np.cos(turn), np.sin(turn)])) for turn in turns]
    return min(boxes, key=lambda box: float(box.half[0] * box.half[1]))


def jaw_palm(
    box: Box, faces: Sequence[Face], jaws: Jaws, reach: float, away: Array, rng: np.random.Generator
) -> tuple[Face, Array]:
    """One palm pose, with noise, for a face and a direction of the jaws in which the box fits.

    The middle of the box goes between the pads, if the palm does not meet the face before. Where
    nothing fits, the narrowest direction is taken.

    Args:
        box: Box of the partial cloud.
        faces: Its faces to choose from.
        jaws: The hand's.
        reach: Along z from the palm's origin to the middle between the jaws [m].
        away: [3], horizontal direction from the camera, unit.
        rng: Source of the choice and the noise.

    Returns:
        The face and T_world_palm [4, 4].
    """
    ways = [(face, k) for face in faces for k in range(2) if abs(face.normal @ box.axes[k]) < 0.5]
    fits = [way for way in ways if 2 * box.half[way[1]] <= jaws.room]
    fits = fits or [min(ways, key=lambda way: float(box.half[way[1]]))]
    face, across = fits[int(rng.integers(len(fits)))]
    inward, up = -face.normal, np.array([0.0, 0.0, 1.0])
    z = np.cross(inward, up) if face.kind != TOP else box.axes[across]
    if face.kind == TOP and z @ jaws.home_z < 0:
        z = -z
    rotation = np.stack([inward, np.cross(z, inward), z], axis=1)
    extent = np.abs(box.axes @ rotation).T @ box.half  # half extents along the palm's axes
    farthest = max(NEAREST, jaws.pads[1] - NEAREST)
    distance = jaws.middle - extent[0] + DEPTH_NOISE * rng.standard_normal()
    nearest = NEAREST + DEPTH_NOISE / 2 * abs(rng.standard_normal())
    behind = UNSEEN * rng.uniform(0, 1) * float(away @ z)
    aside = SHIFT * extent[1] * rng.uniform(-1, 1)
    between = PLACE_NOISE * rng.standard_normal() + behind - reach
    local = np.array([-min(max(distance, nearest), farthest), aside, between])
    turn = TURN_NOISE * rng.standard_normal(3)
    return face, transform(rotation @ small_rotation(turn), face.centre + rotation @ local)


def small_rotation(vector: Array) -> Array:
    """The rotation [3, 3] about `vector` [3] by its length."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    cross = cross_matrix(vector / angle)
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
