"""Objects of real captures whose pose is known, for real_depth.py and real_grasps.py."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image
from scipy import ndimage

from pointsdf_cli.camera.pinhole import Camera
from pointsdf_cli.camera.sensor_presets import load_sensor
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import invert_transform
from pointsdf_cli.io.meshes import LoadedMesh, find_meshes, load_mesh

SPECKS = 7
"""Side [px] of the median filter that fills the rest of a simulated scene."""


class Registered(NamedTuple):
    """One object of a capture.

    Attributes:
        folder: The capture.
        name: Capture and object.
        mesh: The object's scan.
        T_camera_mesh: [4, 4].
        label: Its number in label.png; None for an object that stands alone.
    """

    folder: Path
    name: str
    mesh: LoadedMesh
    T_camera_mesh: Array
    label: int | None

    def view(self) -> tuple[Camera, Array]:
        """The camera, and its depth image [height, width], m."""
        depth = np.asarray(Image.open(self.folder / "depth.png")) * 1e-4
        K = np.array(json.loads((self.folder / "K.json").read_text()))
        height, width = depth.shape
        return Camera(width, height, K[0, 0], K[1, 1], K[0, 2], K[1, 2]), depth

    def simulated(self, exact: Array, seed: int) -> Array:
        """Depths [height, width] that `structured-light` would measure of the scene, m.

        Args:
            exact: [height, width], the object's exact depths, m; 0 where it is not seen.
            seed: Random seed of the errors.
        """
        camera, depth = self.view()
        scene = np.where(exact > 0, exact, ndimage.median_filter(depth, SPECKS))
        rng = np.random.default_rng(seed)
        measured = load_sensor("structured-light").observe(scene.astype(np.float32), camera, rng)
        return measured.astype(np.float64)


def registered_objects(captures: Path, meshes: Path) -> Iterator[Registered]:
    """Every object of the captures that truth.json gives a pose of.

    Raises:
        InputError: There is none, or a mesh of one is missing.
    """
    truth_files = sorted(captures.glob("*/truth.json"))
    if not truth_files:
        raise InputError("holds no capture with truth.json", where=captures)
    for truth_file in truth_files:
        folder, truth = truth_file.parent, json.loads(truth_file.read_text())
        if "mesh" in truth:
            T_world_camera = np.array(json.loads((folder / "T_world_camera.json").read_text()))
            poses = {truth["mesh"]: invert_transform(T_world_camera) @ truth["T_world_mesh"]}
            numbers = {}
        else:
            poses = {name: np.array(pose) for name, pose in truth["T_camera_mesh"].items()}
            numbers = {name: int(number) for number, name in truth["labels"].items()}
        for name, pose in poses.items():
            mesh = load_mesh(find_meshes(meshes, f"{name}*.ply")[0])
            yield Registered(folder, f"{folder.name} {name}", mesh, pose, numbers.get(name))
