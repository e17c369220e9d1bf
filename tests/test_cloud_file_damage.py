"""Files that plyfile and pypcd4 cannot take, and the readers of `io/ply.py` and `io/pcd.py` can.

plyfile 1.1.5 allocates 7 GB for the faces that a header promises, and refuses remarks that are not
ASCII and further columns. pypcd4 1.5.1 makes up the points that are missing from uninitialised
memory, fails with a TypeError on a damaged copy, and refuses a header without COUNT.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.pcd import read_pcd
from pointsdf_cli.io.ply import read_ply

POINTS = np.array([[0, 0, 1], [0, 1, 2]], dtype="<f4")
PLY = "ply\nformat {form} 1.0\n{more}element vertex 2\n" + "".join(
    f"property float {axis}\n" for axis in "xyz"
)
PCD = (
    "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\n{count}WIDTH {n}\nHEIGHT 1\n"
    "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA {form}\n"
)
COUNT = "COUNT 1 1 1\n"
TEXT = b"0 0 1\n0 1 2\n"


def ply(form: str, more: str = "", faces: int = 0) -> bytes:
    lists = f"element face {faces}\nproperty list uchar int vertex_indices\n" if faces else ""
    return f"{PLY.format(form=form, more=more)}{lists}end_header\n".encode("latin-1")


def pcd(form: str, n: int, count: str = COUNT) -> bytes:
    return PCD.format(form=form, n=n, count=count).encode()


READABLE = {
    "faces_cut_off.ply": ply("binary_little_endian", faces=900_000_000) + POINTS.tobytes(),
    "remark_in_latin.ply": ply("ascii", "comment caméra\n") + TEXT,
    "more_columns.ply": ply("ascii") + b"0 0 1 255 255\n0 1 2 255 255\n",
    "no_count.pcd": pcd("ascii", 2, count="") + TEXT,
}
DAMAGED = {
    "rows_missing.pcd": pcd("ascii", 3) + TEXT,
    "many_promised.pcd": pcd("ascii", 400_000_000) + TEXT,
    "copy_from_before.pcd": pcd("binary_compressed", 2)
    + struct.pack("<II", 9, 24)
    + b"\xe0\xff\xffabcdefg",
}


@pytest.mark.parametrize("name", READABLE)
def test_points_are_read_whatever_else_is_wrong(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(READABLE[name])
    raw = read_ply(path) if path.suffix == ".ply" else read_pcd(path)
    assert np.array_equal(raw.points, POINTS)


@pytest.mark.parametrize("name", DAMAGED)
def test_points_that_are_not_there_are_not_made_up(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(DAMAGED[name])
    with pytest.raises(InputError, match="damaged"):
        read_pcd(path)
