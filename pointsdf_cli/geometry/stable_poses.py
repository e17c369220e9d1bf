"""Resting poses of an object on a table, sampled so that objects made to stand do stand.

Falling objects mostly come to rest lying; people put cans and bottles upright, and a hand can then
reach around them. So the tallest firm pose is preferred.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
import trimesh

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import transform

FIRM = 0.17
"""Least tilt [rad] at which an object in a firm pose falls over."""
EQUAL_HEIGHT = 0.05
"""Relative height difference within which firm poses count as the tallest."""
STANDING = 0.75
"""Usual probability of the tallest firm pose; otherwise poses have their own probability."""


@dataclass(frozen=True)
class StablePose:
    """One way to rest on the table.

    Attributes:
        T_table_object: [4, 4], the mesh on a table whose top is z = 0.
        probability: Probability that a falling object comes to rest so.
        height: Height of the object's top above the table [m].
        margin: Tilt at which it falls over [rad].
    """

    T_table_object: Array
    probability: float
    height: float
    margin: float


def stable_poses(vertices: Array, centre_of_mass: Array) -> list[StablePose]:
    """All resting poses of a mesh [V, 3], the most probable first (quasi-static: Goldberg 1999).

    Raises:
        InputError: It has none (degenerate geometry).
    """
    try:
        whole = hull = trimesh.convex.convex_hull(vertices)
        if len(hull.vertices) > 400:
            # Scans have thousands of hull faces; a few hundred describe how they rest.
            hull = hull.simplify_quadric_decimation(face_count=600).convex_hull
        inward = (np.asarray(hull.triangles_center) - centre_of_mass) * hull.face_normals
        if not (inward.sum(axis=1) > 0)[hull.area_faces > 0].all():
            # trimesh would look for one inside for ever.
            what = "has its centre of mass outside of itself"
            raise InputError(what, allowed="a surface that does not cross itself")
        with np.errstate(invalid="ignore"):  # faces that are triangles no longer
            transforms, probabilities = trimesh.poses.compute_stable_poses(
                hull, center_mass=centre_of_mass, sigma=0.0, n_samples=1, threshold=0.0
            )
    except (scipy.spatial.QhullError, ValueError, IndexError) as error:
        raise InputError(f"has no stable pose ({type(error).__name__})") from error
    if not len(transforms):
        raise InputError("has no stable pose")
    poses = []
    for matrix, probability in zip(transforms, probabilities, strict=True):
        rotation = matrix[:3, :3]
        mass = rotation @ centre_of_mass
        heights = np.asarray(whole.vertices) @ rotation[2]
        floor = heights.min()
        pose = transform(rotation, [-mass[0], -mass[1], -floor])
        height = float(np.ptp(heights))
        # The simplified hull lies up to some millimetres within the mesh.
        placed = np.asarray(hull.vertices) @ rotation.T
        under = placed[:, 2].min()
        margin = tilt_margin(placed - [0, 0, under], mass - [0, 0, under])
        poses.append(StablePose(pose, float(probability), height, margin))
    return sorted(poses, key=lambda pose: -pose.probability)


def foot_height(height: float) -> float:
    """Height above the table [m] below which a point belongs to the foot, for a body of this height
    [m]: scans round off flat bottoms."""
    return 0.02 * height + 2e-4


def tilt_margin(placed: Array, mass: Array) -> float:
    """The angle [rad] of tilt at which a body falls over its nearest support edge; 0 if at once.

    Args:
        placed: [V, 3], corners of the body's hull, standing on z = 0.
        mass: [3], its centre of mass.
    """
    foot = placed[placed[:, 2] < foot_height(float(placed[:, 2].max())), :2]
    if len(foot) < 3:
        return 0.0
    try:
        edges = scipy.spatial.ConvexHull(foot).equations
    except scipy.spatial.QhullError:
        return 0.0
    reach = float(-(edges[:, :2] @ mass[:2] + edges[:, 2]).max())
    return float(np.arctan2(max(reach, 0.0), mass[2]))


def draw_pose(
    poses: list[StablePose], standing: float, rng: np.random.Generator
) -> tuple[int, bool]:
    """Index of a pose, and whether it was drawn as a standing one.

    Standing poses are the firm ones that are the tallest, within `EQUAL_HEIGHT`.
    """
    firm = [i for i, pose in enumerate(poses) if pose.margin >= FIRM]
    tallest = max((poses[i].height for i in firm), default=0.0)
    candidates = [i for i in firm if poses[i].height >= (1 - EQUAL_HEIGHT) * tallest]
    wants_standing = rng.random() < standing
    if candidates and wants_standing:
        return int(rng.choice(candidates)), True
    weights = np.array([pose.probability for pose in poses])
    return int(rng.choice(len(poses), p=weights / weights.sum())), False
