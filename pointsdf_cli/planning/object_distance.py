"""The paper's learned constraint: f_SDF(o, FK_l(q)) > 0 at points of every link's surface.

A link's surface is covered by samples (`robot.surface`), grouped into patches a few centimetres
wide. A patch whose centre is farther from the object than its radius plus `exact_to` gets the
distance of its bounding sphere, a lower bound; every other patch gets the distance of its nearest
sample. A link has several patches near a wide contact; the minimum over them is the paper's
constraint.
"""

from __future__ import annotations

from copy import copy

import numpy as np

from pointsdf_cli.geometry.arrays import Array, Indices
from pointsdf_cli.geometry.field import Field
from pointsdf_cli.planning.contacts import WORLD, Contacts, Poses
from pointsdf_cli.planning.fields import cautious
from pointsdf_cli.planning.robot_geometry import PATCH, RobotGeometry


class ObjectDistances:
    """Signed distances of the robot's surface patches to one object.

    Args:
        geometry: Geometry of the robot.
        field: Field of the object, world frame.
        exact_to: Patches with a lower bound above this [m] keep the bound.

    Attributes:
        link: [M], each patch's link.
        other_link: [M], WORLD: the object is fixed.
        names: Each patch's (link, "object").
    """

    def __init__(self, geometry: RobotGeometry, field: Field, exact_to: float = 0.05) -> None:
        self.field, self._exact_to = field, exact_to
        patches, links = geometry.patches, geometry.kinematics.links
        self.link: Indices = patches.link
        self.other_link: Indices = np.full(len(patches.link), WORLD)
        self.names = tuple((links[i], "object") for i in patches.link)
        self._points, self._centre, self._radius = patches.points, patches.centre, patches.radius

    def exact_up_to(self, exact_to: float) -> ObjectDistances:
        """A copy whose distances are exact up to `exact_to` [m]."""
        other = copy(self)
        other._exact_to = exact_to
        return other

    def with_field(self, field: Field, exact_to: float) -> ObjectDistances:
        """The same of another field, exact up to `exact_to` [m]."""
        other = self.exact_up_to(exact_to)
        other.field = field
        return other

    def __call__(self, poses: Poses, gradients: bool = True) -> Contacts:
        """Distances [B, M] of all patches, with their nearest samples."""
        shape = len(poses.rotation), len(self.link)
        rows, columns = (index.ravel() for index in np.indices(shape))
        distance, point, near = self._nearest(poses, rows, columns)
        normal = np.zeros_like(point)
        if gradients and len(near):
            _, normal[near] = self.field.with_gradient(point[near])
        distance, point = distance.reshape(shape), point.reshape(*shape, 3)
        normal = normal.reshape(*shape, 3)
        return Contacts(distance, self.link, point, normal, self.other_link, point)

    def by_link(self, poses: Poses) -> Array:
        """Distance [L] of each link of one configuration: the least of its samples; infinite for a
        link without samples."""
        rotation, position = poses.rotation[0, self.link], poses.position[0, self.link]
        places = (rotation @ self._centre[:, :, None])[..., 0] + position
        centres = cautious(self.field)(places)
        bound = centres - self._radius
        least = np.full(poses.rotation.shape[1], np.inf)
        # Each link's patch of the lowest bound first: most others are then known to be farther.
        order = np.argsort(bound, kind="stable")
        first = order[np.unique(self.link[order], return_index=True)[1]]
        for patches in (first, np.setdiff1d(order, first)):
            near = patches[bound[patches] < least[self.link[patches]]]
            _, values = self._samples(near, rotation[near], position[near])
            np.minimum.at(least, self.link[near], values.min(axis=1))
        return least

    def of(self, poses: Poses, rows: Indices, columns: Indices) -> Array:
        """Distances [K], m, of the patches `columns` [K] at the configurations `rows` [K]: as in a
        call, but of these alone."""
        return self._nearest(poses, rows, columns)[0]

    def _nearest(
        self, poses: Poses, rows: Indices, columns: Indices
    ) -> tuple[Array, Array, Indices]:
        """Distances [K] m of the patches `columns` [K] at the configurations `rows` [K], the points
        [K, 3] of these distances, and which of them are exact."""
        links = self.link[columns]
        rotation, position = poses.rotation[rows, links], poses.position[rows, links]
        point = (rotation @ self._centre[columns, :, None])[..., 0] + position
        distance = np.asarray(self.field(point) - self._radius[columns])
        near = np.flatnonzero(distance < self._exact_to)
        if len(near):
            world, values = self._samples(columns[near], rotation[near], position[near])
            each, lowest = np.arange(len(near)), values.argmin(axis=1)
            point[near], distance[near] = world[each, lowest], values[each, lowest]
        return distance, point, near

    def _samples(self, patches: Indices, rotation: Array, position: Array) -> tuple[Array, Array]:
        """Samples [K, PATCH, 3] of patches [K] whose links are at (R [K, 3, 3], p [K, 3]), in the
        world, m, and their distances [K, PATCH]."""
        world = self._points[patches] @ rotation.transpose(0, 2, 1) + position[:, None]
        return world, self.field(world.reshape(-1, 3)).reshape(len(patches), PATCH)
