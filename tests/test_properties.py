"""Properties that hold for all transforms, clouds and scenes, looked for by hypothesis."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from pointsdf_cli.camera.pinhole import Camera
from pointsdf_cli.camera.segmentation import PLANE_BAND
from pointsdf_cli.camera.table_objects import LOOSE, segment_table
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import (
    apply_transform,
    invert_transform,
    is_rigid,
    rotation_from_wxyz,
    transform,
    wxyz_from_rotation,
)
from pointsdf_cli.io.clouds import Cloud, read_cloud, write_cloud
from pointsdf_cli.io.hdf5 import read_artifact, write_artifact
from pointsdf_cli.io.layout import Column
from pointsdf_cli.io.poses import camera_pose

FEW = settings(max_examples=30, deadline=None)
MANY = settings(max_examples=100, deadline=None)

metres = st.floats(-10, 10, width=32)
places = arrays(np.float64, 3, elements=metres)
quaternions = arrays(np.float64, 4, elements=st.floats(-1, 1)).filter(
    lambda q: np.linalg.norm(q) > 1e-3
)
poses = st.builds(lambda q, p: transform(rotation_from_wxyz(q), p), quaternions, places)
points = st.integers(1, 40).flatmap(lambda n: arrays(np.float64, (n, 3), elements=metres))


@MANY
@given(quaternions)
def test_a_quaternion_and_its_rotation_say_the_same(wxyz: NDArray) -> None:
    rotation = rotation_from_wxyz(wxyz)
    assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(rotation) > 0
    again = wxyz_from_rotation(rotation)
    assert again[0] >= 0
    unit = wxyz / np.linalg.norm(wxyz)
    assert np.isclose(abs(again @ unit), 1, atol=1e-9)  # the same turn, or its negative


@MANY
@given(poses, poses, points)
def test_transforms_are_a_group_that_keeps_distances(a: NDArray, b: NDArray, x: NDArray) -> None:
    assert is_rigid(a)
    assert np.allclose(a @ invert_transform(a), np.eye(4), atol=1e-8)
    assert np.allclose(apply_transform(a @ b, x), apply_transform(a, apply_transform(b, x)))
    moved = apply_transform(a, x)
    assert np.allclose(np.linalg.norm(moved - moved[0], axis=1), np.linalg.norm(x - x[0], axis=1))
    assert np.allclose(apply_transform(invert_transform(a), moved), x, atol=1e-8)


@MANY
@given(poses, st.floats(0.5, 2.0).filter(lambda s: abs(s - 1) > 0.01))
def test_what_scales_or_mirrors_is_not_rigid(pose: NDArray, scale: float) -> None:
    scaled, mirrored = pose.copy(), pose.copy()
    scaled[:3, :3] *= scale
    mirrored[:3, 0] *= -1
    assert not is_rigid(scaled)
    assert not is_rigid(mirrored)


@MANY
@given(poses)
def test_a_pose_that_is_typed_is_the_pose(pose: NDArray) -> None:
    by_rows = " ".join(repr(float(v)) for v in pose.ravel())
    assert np.allclose(camera_pose(by_rows), pose, atol=1e-12)
    seven = [*pose[:3, 3], *wxyz_from_rotation(pose[:3, :3])]
    assert np.allclose(camera_pose(",".join(repr(float(v)) for v in seven)), pose, atol=1e-8)


@MANY
@given(
    st.floats(100, 2000),
    st.floats(100, 2000),
    arrays(np.float64, (20, 2), elements=st.floats(0, 639)),
    arrays(np.float64, 20, elements=st.floats(0.1, 5)),
)
def test_a_pixel_comes_back_to_itself(fx: float, fy: float, uv: NDArray, depth: NDArray) -> None:
    camera = Camera(640, 480, fx, fy, 320.0, 240.0)
    seen = camera.back_project(uv[:, 0], uv[:, 1], depth)
    assert np.allclose(seen[:, 2], depth)
    assert np.allclose(camera.project(seen), uv, atol=1e-6)


@FEW
@given(points, st.none() | poses, st.sampled_from(["camera", "world"]), st.booleans())
def test_a_written_cloud_is_read_as_it_was(
    x: NDArray, pose: NDArray | None, frame: str, coloured: bool
) -> None:
    colours = (np.arange(x.size).reshape(x.shape) % 256).astype(np.uint8) if coloured else None
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cloud.ply"
        write_cloud(path, Cloud(x, colours=colours, frame=frame, T_world_camera=pose))
        cloud = read_cloud(path)
    assert np.array_equal(cloud.points, x.astype(np.float32))
    assert cloud.frame == frame
    assert (cloud.T_world_camera is None) == (pose is None)
    if pose is not None:
        assert np.array_equal(cloud.T_world_camera, pose)
    assert (cloud.colours is None) == (colours is None)
    if colours is not None:
        assert np.array_equal(cloud.colours, colours)


@FEW
@given(st.data())
def test_a_cloud_file_that_is_cut_is_refused_and_never_shorter(data: st.DataObject) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cloud.ply"
        write_cloud(path, Cloud(np.random.default_rng(0).random((30, 3))))
        whole = path.read_bytes()
        path.write_bytes(whole[: data.draw(st.integers(0, len(whole) - 1))])
        try:
            read_cloud(path)
        except InputError:
            return
    raise AssertionError("a cut file was read")


names = st.text("abcdefghijklmnopqrstuvwxyz_", min_size=1, max_size=12)
kinds = st.sampled_from([np.float32, np.float64, np.int8, np.int32])
tables = kinds.flatmap(
    lambda kind: arrays(
        kind,
        st.lists(st.integers(0, 5), min_size=1, max_size=3).map(tuple),
        elements={"allow_nan": False} if np.issubdtype(kind, np.floating) else None,
    )
)


@FEW
@given(st.dictionaries(names, tables, min_size=1, max_size=4), st.integers(0, 2**62))
def test_an_artifact_is_read_as_it_was(datasets: dict[str, NDArray], seed: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.h5"
        layout = {name: Column("f4", "m") for name in datasets}
        write_artifact(
            path,
            schema="s",
            version=3,
            layout=layout,
            arrays=datasets,
            seed=seed,
            config={"n": seed},
        )
        read = read_artifact(path, schema="s", version=3)
    assert read.attributes["seed"] == seed
    assert read.config == {"n": seed}
    assert read.datasets.keys() == datasets.keys()
    for name, array in datasets.items():
        assert read.datasets[name].dtype == array.dtype
        assert np.array_equal(read.datasets[name], array)


CAMERA = np.array([1.5, 0.0, 0.8])


def table_scene(
    centre: NDArray, size: NDArray, turn: float, rng: np.random.Generator
) -> tuple[NDArray, NDArray]:
    """What `CAMERA` sees of a table top and of a box that stands on it, with 1 mm of noise; and
    which points are the box's."""
    table = np.column_stack([rng.uniform((0.3, -0.5), (1.05, 0.5), (4000, 2)), np.zeros(4000)])
    box = rng.uniform(-0.5, 0.5, (1500, 3))
    row, face = np.arange(1500), rng.integers(3, size=1500)
    side = np.sign(box[row, face])
    box[row, face] = side / 2
    box *= size
    c, s = np.cos(turn), np.sin(turn)
    turned = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    middle = np.array([*centre, size[2] / 2])
    camera = (CAMERA - middle) @ turned
    box = box[side * camera[face] > size[face] / 2]  # sides that face the camera
    # The rays to the table enter the box's three slabs and leave them, in shares of their length.
    way = (table - middle) @ turned - camera
    slabs = np.sort([(-size / 2 - camera) / way, (size / 2 - camera) / way], axis=0)
    hidden = slabs[0].max(axis=1) < np.minimum(slabs[1].min(axis=1), 1)
    scene = np.concatenate([table[~hidden], box @ turned.T + middle])
    return scene + rng.normal(0, 0.001, scene.shape), np.arange(len(scene)) >= (~hidden).sum()


@FEW
@given(
    arrays(np.float64, 2, elements=st.floats(-0.25, 0.25)),
    arrays(np.float64, 3, elements=st.floats(0.05, 0.12)),
    st.floats(0, 3),
    st.integers(0, 1000),
)
def test_segmentation_finds_the_box(offset: NDArray, size: NDArray, turn: float, seed: int) -> None:
    cloud, is_box = table_scene(offset + [0.65, 0.0], size, turn, np.random.default_rng(seed))
    found = segment_table(cloud, CAMERA).label >= 0
    assert not found[~is_box].any()
    above = cloud[:, 2] > PLANE_BAND + 0.004
    assert found[is_box & above].mean() > 0.9
    order = np.random.default_rng(seed).permutation(len(cloud))
    again = segment_table(cloud[order], CAMERA).label >= 0
    differ = np.count_nonzero(again != found[order])
    assert differ <= 0.02 * len(cloud)  # the order decides nothing but the band's edge


@MANY
@given(arrays(np.float64, (60, 3), elements=st.floats(-3, 3)))
def test_segmentation_of_anything_labels_every_point(cloud: NDArray) -> None:
    label = segment_table(cloud, np.zeros(3)).label
    assert label.shape == (60,)
    assert label.min() >= LOOSE
