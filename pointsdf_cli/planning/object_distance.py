"""The paper's learned constraint: f_SDF(o, FK_l(q)) > 0 at points of every link's surface.

A link's surface is covered by samples (`robot.surface`), grouped into patches a few centimetres
wide. A patch whose centre is farther from the object than its radius plus `exact_to` gets the
distance of its bounding ball, a lower bound; every other patch gets the distance of its nearest
sample. A link has several patches near a wide contact; the minimum over them is the paper's
constraint.
"""

from __future__ import annotations

from copy import copy

import numpy as np

from pointsdf_cli.geometry.arrays import Array, Indices
from pointsdf_cli.geometry.field import Field
from pointsdf_cli.planning.contacts import WORLD, Contacts, Poses
from pointsdf_cli.planning.fields import RefinedField
from pointsdf_cli.planning.robot_geometry import PATCH, RobotGeometry


class ObjectDistances:
    """Signed distances of the robot's surface patches to one object.

    Args:
        geometry: Geometry of the robot.
        field: Field of the object, world frame.
        exact_to: Patches with a lower bound above this [m] keep the bound.

    Attributes:
        link: [M], each patch's link.
        names: Each patch's (link, "object").
    """

    def __init__(self, geometry: RobotGeometry, field: Field, exact_to: float = 0.05) -> None:
        self.field, self._exact_to = field, exact_to
        patches, links = geometry.patches, geometry.kinematics.links
        self.link: Indices = patches.link
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
        rotation, position = poses.rotation[:, self.link], poses.position[:, self.link]
        count, patches = rotation.shape[:2]
        point = (rotation @ self._centre[:, :, None])[..., 0] + position
        distance = self.field(point.reshape(-1, 3)).reshape(count, patches)
        distance = distance - self._radius
        normal = np.zeros_like(point)
        rows, columns = np.nonzero(distance < self._exact_to)
        if len(rows):
            world = self._points[columns] @ rotation[rows, columns].transpose(0, 2, 1)
            world += position[rows, columns][:, None]
            values = self.field(world.reshape(-1, 3)).reshape(len(rows), PATCH)
            lowest = values.argmin(axis=1)
            each = np.arange(len(rows))
            point[rows, columns] = world[each, lowest]
            distance[rows, columns] = values[each, lowest]
            if gradients:
                _, normal[rows, columns] = self.field.with_gradient(world[each, lowest])
        none = np.full(patches, WORLD)
        return Contacts(distance, self.link, point, normal, none, point)

    def by_link(self, poses: Poses) -> Array:
        """Distance [L] of each link of one configuration: the least of its samples; infinite for a
        link without samples."""
        rotation, position = poses.rotation[0, self.link], poses.position[0, self.link]
        field = self.field
        below = field.cautious() if isinstance(field, RefinedField) else field
        centres = below((rotation @ self._centre[:, :, None])[..., 0] + position)
        bound = centres - self._radius
        least = np.full(poses.rotation.shape[1], np.inf)
        # Each link's patch of the lowest bound first: most others are then known to be farther.
        order = np.argsort(bound, kind="stable")
        first = order[np.unique(self.link[order], return_index=True)[1]]
        for patches in (first, np.setdiff1d(order, first)):
            near = patches[bound[patches] < least[self.link[patches]]]
            world = self._points[near] @ rotation[near].transpose(0, 2, 1) + position[near, None]
            values = self.field(world.reshape(-1, 3)).reshape(len(near), PATCH)
            np.minimum.at(least, self.link[near], values.min(axis=1))
        return least

    def of(self, poses: Poses, rows: Indices, columns: Indices) -> Array:
        """Distances [K], m, of the patches `columns` [K] at the configurations `rows` [K]: as in a
        call, but of these alone."""
        links = self.link[columns]
        rotation, position = poses.rotation[rows, links], poses.position[rows, links]
        centre = (rotation @ self._centre[columns, :, None])[..., 0] + position
        distance = self.field(centre) - self._radius[columns]
        near = np.flatnonzero(distance < self._exact_to)
        if len(near):
            world = self._points[columns[near]] @ rotation[near].transpose(0, 2, 1)
            world += position[near, None]
            values = self.field(world.reshape(-1, 3)).reshape(len(near), PATCH)
            distance[near] = values.min(axis=1)
        return np.asarray(distance)
