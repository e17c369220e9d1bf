"""Clouds in every format, there and back; and every bad file ends in one message."""

from __future__ import annotations

import os
import struct
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import (
    apply_transform,
    random_rotation,
    transform,
    wxyz_from_rotation,
)
from pointsdf_cli.io.clouds import Cloud, check_object_cloud, read_cloud, write_cloud
from pointsdf_cli.io.pcd import lzf_decompress
from pointsdf_cli.io.poses import table_place

RNG = np.random.default_rng(0)
POINTS = (RNG.uniform(-0.05, 0.05, (200, 3)) + [0, 0, 0.8]).astype(np.float32).astype(np.float64)
NORMALS = RNG.standard_normal((200, 3))
NORMALS /= np.linalg.norm(NORMALS, axis=1, keepdims=True)
COLOURS = RNG.integers(0, 256, (200, 3), dtype=np.uint8)
POSE = transform(random_rotation(RNG), [0.3, -0.2, 0.9])

finite32 = st.floats(-1e6, 1e6, width=32)
clouds = st.integers(1, 40).flatmap(
    lambda n: st.builds(
        Cloud,
        points=arrays(np.float64, (n, 3), elements=finite32),
        normals=st.none() | st.just(NORMALS[:n]),
        colours=st.none() | arrays(np.uint8, (n, 3)),
        frame=st.sampled_from(["camera", "world"]),
        T_world_camera=st.none()
        | st.builds(
            lambda seed, t: transform(random_rotation(np.random.default_rng(seed)), t),
            st.integers(0, 2**32),
            arrays(np.float64, 3, elements=st.floats(-10, 10)),
        ),
    )
)


@given(cloud=clouds)
@settings(max_examples=60, deadline=None)
def test_ply_round_trip(cloud: Cloud, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("ply") / "cloud.ply"
    write_cloud(path, cloud)
    back = read_cloud(path)
    assert np.array_equal(back.points, cloud.points)
    assert back.frame == cloud.frame
    assert (back.T_world_camera is None) == (cloud.T_world_camera is None)
    if cloud.T_world_camera is not None:
        assert np.array_equal(back.T_world_camera, cloud.T_world_camera)
    assert (back.normals is None) == (cloud.normals is None)
    if cloud.normals is not None:
        assert np.allclose(back.normals, cloud.normals, atol=1e-6)
    assert (back.colours is None) == (cloud.colours is None)
    if cloud.colours is not None:
        assert np.array_equal(back.colours, cloud.colours)


def open3d_cloud() -> o3d.t.geometry.PointCloud:
    cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor(POINTS.astype(np.float32)))
    cloud.point.normals = o3d.core.Tensor(NORMALS.astype(np.float32))
    cloud.point.colors = o3d.core.Tensor(COLOURS)
    return cloud


@pytest.mark.parametrize("suffix", [".ply", ".pcd"])
@pytest.mark.parametrize("ascii_form", [True, False])
@pytest.mark.parametrize("compressed", [True, False])
def test_reads_what_open3d_writes(
    suffix: str, ascii_form: bool, compressed: bool, tmp_path: Path
) -> None:
    path = tmp_path / f"cloud{suffix}"
    o3d.t.io.write_point_cloud(
        str(path), open3d_cloud(), write_ascii=ascii_form, compressed=compressed
    )
    cloud = read_cloud(path)
    assert np.allclose(cloud.points, POINTS, atol=1e-6)
    assert np.allclose(cloud.normals, NORMALS, atol=1e-4)
    if not (suffix == ".pcd" and ascii_form):  # Open3D prints too few digits of packed colours
        assert np.array_equal(cloud.colours, COLOURS)
    assert (cloud.frame, cloud.T_world_camera) == ("camera", None)


def test_open3d_reads_what_we_write(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    write_cloud(path, Cloud(POINTS, NORMALS, COLOURS, "world", POSE))
    cloud = o3d.t.io.read_point_cloud(str(path))
    assert np.allclose(cloud.point.positions.numpy(), POINTS)
    assert np.allclose(cloud.point.normals.numpy(), NORMALS, atol=1e-6)
    assert np.array_equal(cloud.point.colors.numpy(), COLOURS)


def test_a_pipe_is_no_damaged_file(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "cloud.ply")
    with pytest.raises(InputError, match="is a pipe"):
        read_cloud(tmp_path / "cloud.ply")


def test_ply_big_endian_doubles_after_another_element(tmp_path: Path) -> None:
    header = (
        "ply\nformat binary_big_endian 1.0\nelement sensor 2\nproperty short id\n"
        "element vertex 3\nproperty uchar quality\nproperty double x\nproperty double y\n"
        "property double z\nend_header\n"
    )
    rows = [(9, 0.1, 0.2, 0.3), (8, 0.4, 0.5, 0.6), (7, 0.7, 0.8, 0.9)]
    body = struct.pack(">hh", 1, 2) + b"".join(struct.pack(">Bddd", *row) for row in rows)
    path = tmp_path / "cloud.ply"
    path.write_bytes(header.encode() + body)
    assert np.array_equal(read_cloud(path).points, np.array(rows)[:, 1:])


def test_pcd_viewpoint_is_the_camera_in_the_world(tmp_path: Path) -> None:
    place, wxyz = POSE[:3, 3], wxyz_from_rotation(POSE[:3, :3])
    world = apply_transform(POSE, POINTS)
    path = tmp_path / "cloud.pcd"
    path.write_text(
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z _\nSIZE 4 4 4 1\nTYPE F F F U\nCOUNT 1 1 1 2\n"
        f"WIDTH {len(world)}\nHEIGHT 1\nVIEWPOINT {' '.join(map(str, [*place, *wxyz]))}\n"
        f"POINTS {len(world)}\nDATA ascii\n" + "".join(f"{x} {y} {z} 0 0\n" for x, y, z in world)
    )
    cloud = read_cloud(path)
    assert cloud.frame == "world"
    assert cloud.T_world_camera == pytest.approx(POSE)
    points, T_world_camera = cloud.in_camera_frame()
    assert points == pytest.approx(POINTS)
    assert apply_transform(T_world_camera, points) == pytest.approx(world)


def test_pcd_colours_written_as_whole_numbers_are_bits(tmp_path: Path) -> None:
    path = tmp_path / "cloud.pcd"
    packed = [0xFF102030, 0x00FFFEFD, 0x80000001]
    path.write_text(
        "VERSION 0.7\nFIELDS x y z rgba\nSIZE 4 4 4 4\nTYPE F F F U\nCOUNT 1 1 1 1\nWIDTH 3\n"
        "HEIGHT 1\nPOINTS 3\nDATA ascii\n" + "".join(f"{k} 0 1 {p}\n" for k, p in enumerate(packed))
    )
    colours = read_cloud(path).colours
    assert colours is not None
    assert colours.tolist() == [[0x10, 0x20, 0x30], [0xFF, 0xFE, 0xFD], [0, 0, 1]]


@given(data=st.binary(max_size=400))
@settings(max_examples=60, deadline=None)
def test_lzf_literals_come_back(data: bytes) -> None:
    packed = b"".join(
        bytes([len(run) - 1]) + run for run in (data[i : i + 32] for i in range(0, len(data), 32))
    )
    assert lzf_decompress(packed, len(data)) == data


def test_lzf_copy_may_overlap_itself() -> None:
    # "ab", then 9 bytes from 2 back: (length − 2) = 7 in the long form.
    assert lzf_decompress(bytes([1]) + b"ab" + bytes([7 << 5, 0, 1]), 11) == b"ab" * 5 + b"a"


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("blanks.xyz", "# frame world\n0.1 0.2 0.3\n0.4 0.5 0.6\n"),
        ("commas.csv", "x,y,z\n0.1,0.2,0.3\n0.4,0.5,0.6\n"),
        ("crlf.txt", "0.1;0.2;0.3\r\n0.4;0.5;0.6\r\n"),
        ("remark.xyz", "0.1 0.2 0.3 # a, b\n0.4 0.5 0.6\n"),
        ("bom.xyz", "\ufeff0.1 0.2 0.3 7\n0.4 0.5 0.6 8\n"),
    ],
)
def test_text_tables(name: str, text: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(text.encode())
    cloud = read_cloud(path)
    assert np.array_equal(cloud.points, [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])
    assert cloud.frame == ("world" if "world" in text else "camera")


def test_six_columns_are_normals_or_colours(tmp_path: Path) -> None:
    np.save(tmp_path / "normals.npy", np.hstack([POINTS, NORMALS]))
    np.save(tmp_path / "colours.npy", np.hstack([POINTS, COLOURS]))
    np.save(tmp_path / "image.npy", POINTS.reshape(10, 20, 3))
    assert np.allclose(read_cloud(tmp_path / "normals.npy").normals, NORMALS)
    colours = read_cloud(tmp_path / "colours.npy")
    assert colours.normals is None
    assert np.array_equal(colours.colours, COLOURS)
    assert np.array_equal(read_cloud(tmp_path / "image.npy").points, POINTS)


def test_unit_scales_to_metres(tmp_path: Path) -> None:
    np.save(tmp_path / "mm.npy", POINTS * 1000)
    assert read_cloud(tmp_path / "mm.npy", unit="mm").points == pytest.approx(POINTS)


def test_invalid_points_are_refused_or_dropped(tmp_path: Path) -> None:
    holed = POINTS.copy()
    holed[[3, 7], [0, 2]] = np.nan, np.inf
    np.save(tmp_path / "holed.npy", holed)
    with pytest.raises(InputError, match=r"2 of 200 points.*\n.*\n.*--drop-invalid"):
        read_cloud(tmp_path / "holed.npy")
    kept = read_cloud(tmp_path / "holed.npy", drop_invalid=True).points
    assert np.array_equal(kept, np.delete(POINTS, [3, 7], axis=0))


def test_zeros_where_nothing_was_seen_are_dropped_with_what_is_invalid(tmp_path: Path) -> None:
    holed = POINTS.copy()
    holed[[3, 7]] = 0.0
    np.save(tmp_path / "holed.npy", holed)
    with pytest.raises(InputError, match=r"2 of 200 points are 0 0 0[^$]*--drop-invalid"):
        read_cloud(tmp_path / "holed.npy").in_camera_frame()
    kept = read_cloud(tmp_path / "holed.npy", drop_invalid=True).points
    assert np.array_equal(kept, np.delete(POINTS, [3, 7], axis=0))


def test_a_depth_image_is_no_table_of_points(tmp_path: Path) -> None:
    np.save(tmp_path / "depth.npy", np.ones((480, 640), np.float32))
    with pytest.raises(InputError, match="rgrasp cloud"):
        read_cloud(tmp_path / "depth.npy")


def test_world_cloud_without_a_camera_asks_for_one() -> None:
    with pytest.raises(InputError, match="--camera-pose"):
        Cloud(POINTS, frame="world").in_camera_frame()


def test_points_behind_the_camera_are_not_in_its_frame() -> None:
    with pytest.raises(InputError, match="behind the camera"):
        Cloud(POINTS - [0, 0, 1]).in_camera_frame()


def ply(body: bytes, vertices: object = 3, form: str = "ascii", more: str = "") -> bytes:
    return (
        f"ply\nformat {form} 1.0\n{more}element vertex {vertices}\nproperty float x\n"
        "property float y\nproperty float z\nend_header\n"
    ).encode() + body


PCD = (
    "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 3\nHEIGHT 1\n"
    "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 3\nDATA "
)
POSE_LINE = "comment T_world_camera "
BAD_FILES = {
    "empty.ply": (b"", "not a PLY"),
    "rubbish.ply": (RNG.bytes(5000), "not a PLY"),
    "rubbish.pcd": (RNG.bytes(5000), "not a PCD"),
    "rubbish.xyz": (b"\xff\xfe\x00" + RNG.bytes(5000), "not text|no rows"),
    "rubbish.npy": (RNG.bytes(5000), "not a NumPy"),
    "none.ply": (ply(b"", 0), "no points"),
    "none.xyz": (b"# nothing\n", "no rows"),
    "no_end.ply": (b"ply\nformat ascii 1.0\nelement vertex 1\n", "no end"),
    "short.ply": (ply(b"1 2 3\n4 5 6\n"), "cut short"),
    "short_binary.ply": (ply(bytes(35), 3, "binary_little_endian"), "cut short"),
    "greedy.ply": (ply(bytes(36), 10**15, "binary_little_endian"), "cut short"),
    "greedy_ascii.ply": (ply(b"1 2 3\n", 10**15), "cut short"),
    "negative.ply": (ply(b"", -3), "negative"),
    "not_a_count.ply": (ply(b"", "many"), "header is damaged"),
    "words.ply": (ply(b"one two three\n" * 3), "not all numbers"),
    "form.ply": (ply(b"", 3, "binary_middle_endian"), "unknown PLY format"),
    "no_z.ply": (
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n",
        "no x, y and z",
    ),
    "frame.ply": (ply(b"1 2 3\n" * 3, more="comment frame moon\n"), "unknown frame"),
    "pose.ply": (ply(b"1 2 3\n" * 3, more=f"{POSE_LINE}1 2 3\n"), "not 16 numbers"),
    "mirror.ply": (
        ply(b"1 2 3\n" * 3, more=f"{POSE_LINE}-1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n"),
        "not a rotation",
    ),
    "short.pcd": ((PCD + "ascii\n1 2 3\n4 5\n").encode(), "cut short"),
    "short_binary.pcd": ((PCD + "binary\n").encode() + bytes(35), "cut short"),
    "short_packed.pcd": ((PCD + "binary_compressed\n").encode() + bytes(3), "cut short"),
    "damaged_packed.pcd": (
        (PCD + "binary_compressed\n").encode() + struct.pack("<II", 4, 36) + b"\xff\xff\xff\xff",
        "damaged",
    ),
    "kind.pcd": ((PCD + "ternary\n").encode(), "unknown PCD data"),
    "ragged.xyz": (b"1 2 3\n4 5\n", "as a table"),
    "thin.npy": (b"", "not a NumPy"),
    "cloud.jpg": (b"", "unknown cloud format"),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_a_bad_file_is_one_message(name: str, tmp_path: Path) -> None:
    content, message = BAD_FILES[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        read_cloud(tmp_path / name)
    assert name in caught.value.message


@given(cut=st.integers(0, 2000), flip=st.integers(0, 2000), byte=st.integers(0, 255))
@settings(max_examples=150, deadline=None)
@pytest.mark.parametrize("suffix", [".ply", ".pcd"])
def test_damage_never_raises_anything_else(
    suffix: str, cut: int, flip: int, byte: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("damage")
    path = folder / f"cloud{suffix}"
    if not (whole := folder / f"whole{suffix}").exists():
        o3d.t.io.write_point_cloud(str(whole), open3d_cloud(), compressed=suffix == ".pcd")
    content = bytearray(whole.read_bytes())
    content[flip % len(content)] = byte
    path.write_bytes(content[: len(content) - cut])
    try:
        cloud = read_cloud(path)
    except InputError:
        return
    assert np.isfinite(cloud.points).all()


def test_no_file_and_a_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_cloud(tmp_path / "nowhere.ply")
    with pytest.raises(InputError, match="is a folder"):
        read_cloud(tmp_path)


LINE = np.outer(np.linspace(0, 0.1, 100), [1, 2, 3]) + [0, 0, 1]


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (POINTS[:3], "3 points, too few"),
        (np.repeat(POINTS[:1], 100, axis=0), "the same point"),
        (LINE, "on one line"),
        (POINTS * 1000, "millimetres.*\n.*\n.*--unit mm"),
        (POINTS * 0.01, "too small"),
        (POINTS * 1e200, "millimetres"),
        (POINTS + [0, 0, 100], "100.* m away"),
        (np.concatenate([POINTS, [[1e7, 0, 1]]]), "millimetres"),
        (RNG.uniform(-2, 2, (500, 3)) + [0, 0, 3], "a whole scene"),
    ],
)
def test_what_cannot_be_one_object(points: np.ndarray, message: str) -> None:
    with pytest.raises(InputError, match=message):
        check_object_cloud(Cloud(points), "cloud.ply")


def test_a_plane_and_an_ordinary_cloud_pass() -> None:
    assert check_object_cloud(Cloud(POINTS * [1, 1, 0] + [0, 0, 1]), "plane").points.shape
    assert check_object_cloud(Cloud(POINTS), "cloud").points.shape


def test_millions_of_points(tmp_path: Path) -> None:
    """Two million there and back in arrays, not point by point."""
    points = np.tile(POINTS, (10_000, 1))
    write_cloud(tmp_path / "many.ply", Cloud(points))
    assert np.array_equal(read_cloud(tmp_path / "many.ply").points[-200:], POINTS)


def test_a_pcd_viewpoint_has_the_unit_of_the_points(tmp_path: Path) -> None:
    world = apply_transform(POSE, POINTS) * 1000
    turned = " ".join(map(repr, wxyz_from_rotation(POSE[:3, :3]).tolist()))
    place = " ".join(map(repr, (1000 * POSE[:3, 3]).tolist()))
    head = (
        "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
        f"WIDTH {len(world)}\nHEIGHT 1\nVIEWPOINT {place} {turned}\nPOINTS {len(world)}\n"
        "DATA ascii\n"
    )
    rows = "\n".join(" ".join(map(repr, row)) for row in world.tolist())
    (tmp_path / "a.pcd").write_text(head + rows + "\n")
    cloud = read_cloud(tmp_path / "a.pcd", "mm")
    np.testing.assert_allclose(cloud.T_world_camera, POSE, atol=1e-9)
    np.testing.assert_allclose(cloud.in_camera_frame()[0], POINTS, atol=1e-6)


def test_options_say_more_than_a_header(tmp_path: Path) -> None:
    header = "comment frame camera_depth_optical_frame\ncomment T_world_camera 1 2 3\n"
    (tmp_path / "a.ply").write_bytes(ply(b"1 2 3\n" * 3, more=header))
    with pytest.raises(InputError, match="--frame"):
        read_cloud(tmp_path / "a.ply", T_world_camera=POSE)
    cloud = read_cloud(tmp_path / "a.ply", frame="camera", T_world_camera=POSE)
    assert cloud.frame == "camera"
    np.testing.assert_array_equal(cloud.T_world_camera, POSE)
    with pytest.raises(InputError, match="camera, world"):
        read_cloud(tmp_path / "a.ply", frame="moon", T_world_camera=POSE)


@pytest.mark.parametrize(
    "titles", ["x,y,z", ",x,y,z", "intensity,z,y,x", '"X","Y","Z"', "r,g,b,x,y,z", "x,y,z,nx,ny,nz"]
)
def test_titles_say_which_columns_are_which(titles: str, tmp_path: Path) -> None:
    """As pandas writes a table, its index first; and in any order."""
    known = {
        **dict(zip("xyz", POINTS.T, strict=True)),
        **dict(zip("rgb", COLOURS.T, strict=True)),
        **dict(zip(("nx", "ny", "nz"), NORMALS.T, strict=True)),
        "": np.arange(len(POINTS)),
        "intensity": np.full(len(POINTS), 0.5),
    }
    columns = [known[title.strip('"').lower()] for title in titles.split(",")]
    rows = "\n".join(",".join(repr(float(v)) for v in row) for row in zip(*columns, strict=True))
    (tmp_path / "a.csv").write_text(f"{titles}\n{rows}\n")
    cloud = read_cloud(tmp_path / "a.csv")
    np.testing.assert_array_equal(cloud.points, POINTS)
    assert (cloud.colours is not None) == titles.startswith("r,")
    assert (cloud.normals is not None) == titles.endswith("nz")
    if cloud.colours is not None:
        np.testing.assert_array_equal(cloud.colours, COLOURS)


def test_a_point_a_column_is_to_be_transposed(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", POINTS.T)
    with pytest.raises(InputError, match="transposed"):
        read_cloud(tmp_path / "a.npy")


def test_a_remark_of_four_words_is_no_row_of_titles(tmp_path: Path) -> None:
    rows = "".join(f"{x} {y} {z} 0.5\n" for x, y, z in POINTS)
    (tmp_path / "a.xyz").write_text("# scan of my mug\n" + rows)
    assert read_cloud(tmp_path / "a.xyz").points == pytest.approx(POINTS)


@pytest.mark.parametrize("kind", ["normals", "colours"])
def test_what_was_not_seen_says_nothing_of_the_columns(tmp_path: Path, kind: str) -> None:
    rest = np.tile([0.0, 0.6, 0.8] if kind == "normals" else [10.0, 20.0, 255.0], (200, 1))
    table = np.hstack([POINTS, rest])
    table[5] = np.nan
    np.save(tmp_path / "a.npy", table)
    kept = getattr(read_cloud(tmp_path / "a.npy", drop_invalid=True), kind)
    np.testing.assert_array_equal(kept, np.delete(rest, 5, axis=0))


def test_a_covered_camera_saw_no_point(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.zeros((100, 3)))
    with pytest.raises(InputError, match="none of 100 points"):
        read_cloud(tmp_path / "a.npy", drop_invalid=True)


def test_titles_without_coordinates_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("id,px,py,pz\n" + "1,0.1,0.2,0.3\n" * 60)
    with pytest.raises(InputError, match="none of them named x, y or z"):
        read_cloud(tmp_path / "a.csv")


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("a.csv", "id,x,y,z [m]\n" + "1,0.1,0.2,0.3\n" * 60, "none of them named z"),
        ("a.csv", (",".join(["1.5"] * 320) + "\n") * 60, "a depth image"),
    ],
    ids=["some titles", "an image"],
)
def test_tables_of_something_else_are_refused(
    tmp_path: Path, name: str, text: str, says: str
) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=says):
        read_cloud(tmp_path / name)


def test_an_image_of_planes_is_no_image_of_points(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.zeros((3, 48, 64)))
    with pytest.raises(InputError, match="array"):
        read_cloud(tmp_path / "a.npy")


def test_a_remark_behind_the_first_point_hides_none(tmp_path: Path) -> None:
    rows = "".join(f"{0.001 * k} 0.1 1.0 # point {k}\n" for k in range(60))
    (tmp_path / "a.xyz").write_text(rows)
    assert len(read_cloud(tmp_path / "a.xyz").points) == 60


def test_a_remark_with_slashes_hides_no_point(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text("1 2 3 // first\n0.1 0.2 0.3\n0.2 0.2 0.3\n")
    assert len(read_cloud(tmp_path / "a.xyz").points) == 3


@pytest.mark.parametrize("over_table", [False, True])
def test_a_pose_made_from_the_table_is_marked(over_table: bool, tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    points = np.random.default_rng(0).random((60, 3))
    write_cloud(path, Cloud(points, T_world_camera=np.eye(4), over_table=over_table))
    assert read_cloud(path).over_table == over_table
    assert not read_cloud(path, T_world_camera=np.eye(4)).over_table


@pytest.mark.parametrize("count", ["0", "2"])
def test_a_pcd_of_several_x_a_point_is_damaged(tmp_path: Path, count: str) -> None:
    header = (
        "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\n"
        f"COUNT {count} {count} {count}\nWIDTH 60\nHEIGHT 1\nPOINTS 60\nDATA binary\n"
    )
    (tmp_path / "a.pcd").write_bytes(header.encode() + bytes(60 * 24))
    with pytest.raises(InputError, match="COUNT"):
        read_cloud(tmp_path / "a.pcd")


def test_a_pcd_of_several_colours_a_point_is_damaged(tmp_path: Path) -> None:
    header = (
        "VERSION .7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 3\n"
        "WIDTH 60\nHEIGHT 1\nPOINTS 60\nDATA binary\n"
    )
    (tmp_path / "a.pcd").write_bytes(header.encode() + bytes(60 * 24))
    with pytest.raises(InputError, match="COUNT 3 of rgb"):
        read_cloud(tmp_path / "a.pcd")


def test_half_nan_and_half_zero_is_no_cloud(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.repeat([[np.nan] * 3, [0.0] * 3], 50, axis=0))
    with pytest.raises(InputError) as refused:
        read_cloud(tmp_path / "a.npy", drop_invalid=True)
    assert "--drop-invalid" not in refused.value.message


def test_a_camera_beyond_all_rooms_is_refused(tmp_path: Path) -> None:
    points = np.random.default_rng(0).uniform(0, 0.1, (300, 3)) + [0, 0, 0.5]
    pose = np.eye(4)
    pose[0, 3] = 600.0
    write_cloud(tmp_path / "far.ply", Cloud(points, T_world_camera=pose))
    with pytest.raises(InputError, match="the camera of the header is 600 m"):
        read_cloud(tmp_path / "far.ply")
    with pytest.raises(InputError, match=r"the object.s place is 600 m away"):
        table_place("table:600,0")
