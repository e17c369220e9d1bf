"""An object in PyBullet: one free body of convex pieces."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from pointsdf_cli.errors import RgraspError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import invert_transform, rotation_from_wxyz, transform
from pointsdf_cli.io.scratch import temporary_files
from pointsdf_cli.simulation.bullet import Bullet, bullet_place
from pointsdf_cli.simulation.decomposition import Pieces
from pointsdf_cli.simulation.physics import ROLLING_FRICTION, SPINNING_FRICTION, PhysicsConfig
from pointsdf_cli.simulation.sim_object import SimObject
from pointsdf_cli.simulation.skin import shrunk


class BulletObject:
    """One object in one scene of a physics client.

    Args:
        bullet: The physics client.
        item: The object.
        file: File of its pieces (`write_pieces`).
        T_world_object: [4, 4], its mesh frame in the world.
        physics: Friction of the object.

    Attributes:
        body: Number of the body.

    Raises:
        RgraspError: PyBullet cannot read the pieces.
    """

    def __init__(
        self,
        bullet: Bullet,
        item: SimObject,
        file: Path,
        T_world_object: Array,
        physics: PhysicsConfig,
    ) -> None:
        self._bullet = bullet
        self._T_mesh_body = item.T_mesh_body
        self._T_body_mesh = invert_transform(item.T_mesh_body)
        shape = bullet.createCollisionShape(bullet.GEOM_MESH, fileName=str(file))
        if shape < 0:
            what = "PyBullet cannot read the object's convex pieces"
            raise RgraspError(what, where=item.mesh.name)
        position, xyzw = bullet_place(T_world_object @ self._T_mesh_body)
        self.body: int = bullet.createMultiBody(
            item.mass, shape, basePosition=position, baseOrientation=xyzw
        )
        bullet.changeDynamics(
            self.body,
            -1,
            localInertiaDiagonal=item.inertia.tolist(),
            lateralFriction=physics.object_friction,
            rollingFriction=ROLLING_FRICTION,
            spinningFriction=SPINNING_FRICTION,
            linearDamping=0.02,
            angularDamping=0.02,
        )

    def place(self, T_world_object: Array) -> None:
        """Place it at rest, without physics."""
        position, xyzw = bullet_place(T_world_object @ self._T_mesh_body)
        self._bullet.resetBasePositionAndOrientation(self.body, position, xyzw)

    def pose(self) -> Array:
        """T_world_object [4, 4], the mesh frame in the world."""
        position, xyzw = self._bullet.getBasePositionAndOrientation(self.body)
        rotation = rotation_from_wxyz(np.array([xyzw[3], *xyzw[:3]]))
        return transform(rotation, np.array(position)) @ self._T_body_mesh

    def centre(self) -> Array:
        """The centre of mass [3] in the world."""
        position, _ = self._bullet.getBasePositionAndOrientation(self.body)
        return np.array(position)

    def speed(self) -> tuple[float, float]:
        """Speed of the centre of mass [m/s] and angular speed [rad/s]."""
        linear, angular = self._bullet.getBaseVelocity(self.body)
        return float(np.linalg.norm(linear)), float(np.linalg.norm(angular))

    def push(self, force: Array) -> None:
        """Apply a force [3] [N], world frame, at the centre of mass during the next step."""
        b, centre = self._bullet, self.centre().tolist()
        b.applyExternalForce(self.body, -1, force.tolist(), centre, b.WORLD_FRAME)


def write_pieces(pieces: Pieces, path: Path, skin: float) -> None:
    """Write convex pieces as one OBJ file, for PyBullet a union of hulls with a skin each."""
    text, start = io.StringIO(), 1
    for i, (corners, faces) in enumerate(shrunk(*piece, skin) for piece in pieces):
        text.write(f"o piece{i}\n")
        text.writelines("v {:.7f} {:.7f} {:.7f}\n".format(*v) for v in corners)
        text.writelines("f {} {} {}\n".format(*(f + start)) for f in faces)
        start += len(corners)
    with temporary_files(path.parent):
        path.write_text(text.getvalue(), encoding="ascii")
