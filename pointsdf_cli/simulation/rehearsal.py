"""Rehearsal: grasps tried in simulation on the reconstructed object before one is chosen.

A try on the completed surface, with the hand on a rigid arm, takes about 0.15 s. Surface, position,
mass and friction of the object are uncertain, so each grasp is tried under the same few
disturbances of them. The grasp is preferred that is most likely to hold by the success network and
its rehearsals together. The true object is not used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import QhullError
from scipy.special import expit, logit

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import transform
from pointsdf_cli.io.meshes import LoadedMesh
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.robot.lift import LIFT_HEIGHT, lift_path
from pointsdf_cli.simulation.executor import Executor, ExecutorConfig
from pointsdf_cli.simulation.mass import estimated_mass
from pointsdf_cli.simulation.physics import PhysicsConfig
from pointsdf_cli.simulation.quick_pieces import quick_pieces
from pointsdf_cli.simulation.sim_object import SimObject
from pointsdf_cli.simulation.world import World

REPEATS = 8
"""Number of tries of a grasp; the first is undisturbed."""
FAILURES = 2
"""Number of failures after which a grasp is not tried again."""
PLACE = 0.005
"""Standard deviation of the object's position on the table [m]."""
TURN = 0.05
"""Standard deviation of its yaw [rad]."""
SCALE = 0.04
"""Standard deviation of its relative size, horizontally and vertically."""
FRICTION = (0.45, 0.7)
"""Range of the friction of the object."""
MASS = (0.5, 3.0)
"""Range of the ratio of its mass to the estimate: of 28 YCB objects half have 0.5 to 2.5, solid
tools up to 7."""
FOOT = 0.012
"""Height [m] above the table below which the lowest points are moved onto it; at most half of the
object's."""
INTERCEPT, BY_SUCCESS, BY_REHEARSALS = 0.85, 0.83, 0.53
"""Logistic regression of grasps that held on the true object, by the log-odds of the success
network and of the rehearsals (docs/notebook.md, "What a rehearsal tells")."""
SUREST = 0.99
"""Largest success probability that is believed."""
PHYSICS = PhysicsConfig(step=1 / 240, iterations=100)
"""Contact simulation, coarser than that of trials: only the ranking matters. Of 171 tries
three end otherwise than with the whole arm and 200 iterations, which take three times as long."""


class Rehearsed(NamedTuple):
    """Result of one rehearsed grasp.

    Attributes:
        tries: Number of tries; 0 if the arm cannot lift from there, or if an earlier grasp is more
            likely to hold than this one can be.
        held: Number of tries in which it held.
        rise: Mean rise of the object [m], at most the lift's height: decides between grasps that
            hold equally often.
    """

    tries: int
    held: int
    rise: float

    @property
    def share(self) -> float:
        """Share of tries in which it held."""
        return self.held / self.tries if self.tries else 0.0

    def chance(self, success: float) -> float:
        """Probability that the grasp holds, given the success network's `success`."""
        rehearsed = (self.held + 0.5) / (self.tries + 1)
        network = np.clip(success, 1 - SUREST, SUREST)
        odds = INTERCEPT + BY_SUCCESS * logit(network) + BY_REHEARSALS * logit(rehearsed)
        return float(expit(odds))


UNTRIED = Rehearsed(0, 0, 0.0)


@dataclass(frozen=True)
class _Disturbance:
    shift: Array
    yaw: float
    scale: Array
    friction: float
    mass: float


class Rehearsal:
    """Rehearsal of grasps with one robot, in one physics world.

    Args:
        robot: The robot.
        execution: Execution of grasps, as in trials but without hold and pushes.
        repeats: Number of tries of a grasp; the first is undisturbed.
    """

    def __init__(
        self,
        robot: RobotDescription,
        execution: ExecutorConfig | None = None,
        repeats: int = REPEATS,
    ) -> None:
        self._repeats = repeats
        # An object at rest in the hand after half a second mostly stays there, and hold and pushes
        # take several times as long as the rest.
        execution = (execution or ExecutorConfig()).without_hold_and_push()
        self._execution = replace(execution, longest_settling=0.6)
        self._world = World(robot, PHYSICS)

    def close(self) -> None:
        """Close the physics client."""
        self._world.close()

    def __call__(
        self,
        vertices: Array,
        faces: NDArray[np.integer],
        q: Array,
        success: Array,
        right: Array | None = None,
        seed: int = 0,
        table_height: float = 0.0,
    ) -> list[Rehearsed]:
        """Try those grasps of an object, in their order, that may be better than all before.

        Args:
            vertices: [V, 3], vertices of the reconstructed surface, world frame.
            faces: [F, 3].
            q: [C, J], configurations in which the hand begins to close.
            success: [C], their success probabilities by the network.
            right: [C], probability of each that the reconstruction is right at its contacts; 1 each
                if None.
            seed: Random seed of the disturbances, which are the same for all grasps.
            table_height: Height of the table [m].

        Raises:
            InputError: The surface is flat.
        """
        self._world.table_height = table_height
        believed = believed_object(vertices, faces, table_height)
        disturbances = _disturbances(self._repeats, np.random.default_rng(seed))
        perfect = Rehearsed(len(disturbances), len(disturbances), LIFT_HEIGHT)
        tried: list[Rehearsed] = []
        best = 0.0
        right = np.ones(len(success)) if right is None else right
        for grasp, probability, factor in zip(np.atleast_2d(q), success, right, strict=True):
            if factor * perfect.chance(probability) <= best:
                tried.append(UNTRIED)
                continue
            one = self._try(believed, grasp, self._lift(grasp), disturbances)
            best = max(best, factor * one.chance(probability) if one.tries else 0.0)
            tried.append(one)
        return tried

    def _try(
        self, believed: SimObject, q: Array, lift: Array | None, disturbances: list[_Disturbance]
    ) -> Rehearsed:
        if lift is None:
            return UNTRIED
        rises: list[float] = []
        held = 0
        for disturbance in disturbances:
            if len(rises) - held >= FAILURES or (rises and not held):
                break  # it fails even when all is as believed, or too often
            world = self._world
            item = _disturbed(believed, disturbance, world.table_height)
            world.physics = replace(PHYSICS, object_friction=disturbance.friction)
            world.reset(item, np.eye(4), q, robot="hand")
            outcome = Executor(world, self._execution).run(q, lift)
            held += outcome.held
            rises.append(
                float(np.clip(outcome.lift_height, 0.0, LIFT_HEIGHT)) if outcome.valid else 0.0
            )
        return Rehearsed(len(rises), held, float(np.mean(rises)))

    def _lift(self, q: Array) -> Array | None:
        world = self._world
        return lift_path(world.chain, q)


def best_first(
    tried: Sequence[Rehearsed], success: Sequence[float], right: Sequence[float]
) -> list[int]:
    """Indices of grasps, the one most likely to hold first; ties keep their order.

    Grasps without a try come last.

    Args:
        tried: Result of each grasp.
        success: Success probability of each by the network.
        right: Probability of each that the reconstruction is right at its contacts.
    """

    def cost(k: int) -> tuple[bool, float, float]:
        one = tried[k]
        chance = right[k] * one.chance(success[k])
        return not one.tries, -round(chance, 3), -round(one.rise, 2)

    return sorted(range(len(tried)), key=cost)


def believed_object(
    vertices: Array, faces: NDArray[np.integer], table_height: float = 0.0
) -> SimObject:
    """Object to simulate from a reconstructed surface; its mesh frame is the world's.

    Args:
        vertices, faces, table_height: As in `Rehearsal`.

    Raises:
        InputError: The surface is flat.
    """
    pieces = quick_pieces(vertices, faces)
    foot = min(FOOT, (float(vertices[:, 2].max()) - table_height) / 2)
    standing = [_put_down(corners, table_height, foot) for corners, _ in pieces]
    hulls = [hull for hull in standing if hull is not None]
    if not hulls:
        raise InputError("the surface encloses nothing above the table")
    volumes = np.array([hull.volume for hull in hulls])
    whole = float(volumes.sum())
    surface = trimesh.Trimesh(vertices, faces, process=False)
    hull_volume = float(surface.convex_hull.volume)
    mass = estimated_mass(whole, float(surface.area), hull_volume)
    centre = np.sum([hull.volume * hull.center_mass for hull in hulls], axis=0) / whole
    inertia = np.zeros((3, 3))
    for hull in hulls:
        hull.density = mass / whole
        away = hull.center_mass - centre
        # Parallel axis theorem: about the whole's centre instead of the piece's.
        inertia += hull.moment_inertia
        inertia += hull.mass * (away @ away * np.eye(3) - np.outer(away, away))
    moments, axes = np.linalg.eigh(inertia)
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    believed = LoadedMesh("reconstruction", np.asarray(vertices), np.asarray(faces), "", "none")
    return SimObject(
        mesh=believed,
        pieces=[((np.asarray(h.vertices) - centre) @ axes, np.asarray(h.faces)) for h in hulls],
        T_mesh_body=transform(axes, centre),
        mass=mass,
        inertia=np.maximum(moments, 1e-6),
        poses=[],
    )


def _put_down(corners: Array, table_height: float, foot: float) -> trimesh.Trimesh | None:
    """Hull clipped at the table, with its lowest points moved onto it; None if nothing is left."""
    corners = np.array(corners)
    low = corners[:, 2] < table_height + foot
    if low.all():  # all of it is foot, or was below
        return None
    corners[low, 2] = table_height
    try:
        hull = trimesh.convex.convex_hull(corners)
    except (ValueError, QhullError):  # flat
        return None
    return hull if hull.volume > 1e-9 else None


def _disturbances(repeats: int, rng: np.random.Generator) -> list[_Disturbance]:
    """Disturbances of the tries: the first is zero, the others are random."""
    middle = float(np.mean(FRICTION))
    drawn = [_Disturbance(np.zeros(2), 0.0, np.ones(3), middle, 1.0)]
    for _ in range(repeats - 1):
        level, upright = 1 + SCALE * rng.standard_normal(2)
        drawn.append(
            _Disturbance(
                shift=PLACE * rng.standard_normal(2),
                yaw=TURN * float(rng.standard_normal()),
                scale=np.array([level, level, upright]),
                friction=float(rng.uniform(*FRICTION)),
                mass=float(np.exp(rng.uniform(*np.log(MASS)))),
            )
        )
    return drawn


def _disturbed(item: SimObject, disturbance: _Disturbance, table_height: float) -> SimObject:
    """The object scaled, rotated about its foot and shifted; its frame is the world's."""
    axes, centre = item.T_mesh_body[:3, :3], item.T_mesh_body[:3, 3]
    c, s = np.cos(disturbance.yaw), np.sin(disturbance.yaw)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    foot = np.array([centre[0], centre[1], table_height])
    place = foot + np.array([*disturbance.shift, 0.0])

    def moved(points: Array) -> Array:
        return ((points - foot) * disturbance.scale) @ turn.T + place

    turned, middle = turn @ axes, moved(centre)
    pieces = [
        ((moved(corners @ axes.T + centre) - middle) @ turned, faces)
        for corners, faces in item.pieces
    ]
    return replace(
        item,
        pieces=pieces,
        T_mesh_body=transform(turned, middle),
        mass=item.mass * disturbance.mass,
        inertia=item.inertia * disturbance.mass,
    )
