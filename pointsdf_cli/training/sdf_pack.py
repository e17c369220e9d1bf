"""View and label artifacts packed once into memory-mapped arrays, ready to be batched.

What does not change from epoch to epoch is computed here: the network's frame of each view, its
farthest points (moved to the front) and the neighbours of the first encoder layer. Rotations about
the optical axis and mirrorings leave all of these valid. The operating system pages the arrays in
and out, so a data set larger than memory trains too and nothing is held twice.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.visibility import ViewEvidence
from pointsdf_cli.io.atomic import (
    abandoned_beside,
    require_folder,
    temporary_beside,
    unwritable,
    write_text_atomic,
)
from pointsdf_cli.io.hdf5 import artifacts_below
from pointsdf_cli.io.labels import read_labels
from pointsdf_cli.io.untrusted import read_json, read_npy_array
from pointsdf_cli.io.views import read_views, read_views_header
from pointsdf_cli.models.neighbours import farthest_point_order
from pointsdf_cli.models.normalise import network_frame
from pointsdf_cli.models.shape_model import PACKED_CENTRES as CENTRES
from pointsdf_cli.models.shape_model import PACKED_NEIGHBOURS as NEIGHBOURS
from pointsdf_cli.models.surroundings import Surroundings, surroundings_arrays
from pointsdf_cli.training.array_files import ArrayWriter, write_array

FORMAT = 4
PREFIX, INDEX = "pack-", "index.json"
NAME = re.compile(r"pack-[0-9a-f]{16}")


@dataclass(frozen=True)
class Pack:
    """V views of O objects with L labels altogether.

    Attributes:
        clouds: f2 [V, P, 3], network frame, farthest points first.
        neighbours: u2 [V, CENTRES, NEIGHBOURS], of the first CENTRES points, nearest first.
        cameras: f4 [V, 3], network frame.
        to_network: f4 [V, 3, 4], mesh frame [m] → network frame.
        scale: f4 [V], network units per metre.
        object_of_view: i4 [V].
        maps: f2 [V, 4, S, S], to_map: f4 [V, 2, 3], plane: f4 [V, 4], known: f4 [V, 2], see
            `Surroundings`.
        points: f4 [L, 3], mesh frame, m.
        sdf: f4 [L], m.
        label_start: i8 [O + 1]; object o has the labels label_start[o] to label_start[o + 1].
        names: O names, with their folders.
        meshes: SHA-256 of the O mesh files.
    """

    clouds: NDArray[np.float16]
    neighbours: NDArray[np.uint16]
    cameras: NDArray[np.float32]
    to_network: NDArray[np.float32]
    scale: NDArray[np.float32]
    object_of_view: NDArray[np.int32]
    maps: NDArray[np.float16]
    to_map: NDArray[np.float32]
    plane: NDArray[np.float32]
    known: NDArray[np.float32]
    points: NDArray[np.float32]
    sdf: NDArray[np.float32]
    label_start: NDArray[np.int64]
    names: tuple[str, ...]
    meshes: tuple[str, ...]


SURROUNDINGS = Surroundings._fields
ARRAYS = tuple(each.name for each in fields(Pack) if each.name not in ("names", "meshes"))


def pair_artifacts(views: Path | str, labels: Path | str) -> list[tuple[Path, Path]]:
    """View files with the label files of the same name, sorted.

    Raises:
        InputError: A folder is missing, nothing is in it, or no names agree.
    """
    found: dict[str, dict[str, Path]] = {}
    for option, folder in (("--views", Path(views)), ("--labels", Path(labels))):
        if not folder.is_dir():
            raise InputError("is not a folder", where=f"{option} {folder}")
        paths = {str(path.relative_to(folder)): path for path in artifacts_below(folder)}
        if not paths:
            raise InputError("holds no .h5 artifacts", where=f"{option} {folder}")
        found[option] = paths
    common = sorted(found["--views"].keys() & found["--labels"].keys())
    if not common:
        raise InputError(
            "no view file has a label file of the same name",
            where=f"--views {views}, --labels {labels}",
            hint=f"rgrasp label-sdf --views {views} --meshes DIR --out {labels}",
        )
    return [(found["--views"][name], found["--labels"][name]) for name in common]


def open_pack(
    pairs: Sequence[tuple[Path, Path]],
    folder: Path | str,
    views_per_object: Mapping[str, int] | None = None,
    on_progress: Callable[[int, int], None] | None = None,
    root: Path | None = None,
) -> Pack:
    """The pack of these artifacts, built in `folder` unless it is there already.

    A pack is a folder in `folder` that is named after what it was made of, and takes its place when
    it is whole: runs that share `folder` do not meet, and what else lies there stays.

    Args:
        pairs: View and label files of each object.
        folder: Folder of packs; finished ones of other files are replaced.
        views_per_object: Keep only the first so many views of each; by folder, "" for the rest.
        on_progress: Called with (objects done, objects).
        root: Objects are named by where their views lie below it; by default below the deepest
            folder that they share.

    Raises:
        InputError: An artifact is unreadable, or views and labels are of different meshes; no
            object lies in a folder of `views_per_object`; the pack cannot be written, or the disk
            is full.
    """
    folder = require_folder(folder)
    limits = dict(views_per_object or {})
    shared = os.path.commonpath([view_file.parent for view_file, _ in pairs])
    below = Path(shared) if root is None or not root.is_dir() else root
    objects = [view_file.relative_to(below).with_suffix("").as_posix() for view_file, _ in pairs]
    home = folder / f"{PREFIX}{_fingerprint(pairs, objects, limits)[:16]}"
    finished = _finished(home)
    if finished is not None:
        return finished
    for leftover in abandoned_beside(folder / "pack"):
        shutil.rmtree(leftover, ignore_errors=True)
    building = temporary_beside(folder / "pack")
    try:
        building.mkdir()
        _check_limits(objects, limits)
        label_start, meshes = _build(pairs, objects, building, limits, on_progress)
        write_array(building / "label_start.npy", label_start)
        write_text_atomic(building / INDEX, json.dumps({"names": objects, "meshes": meshes}))
        # Who has a pack's files open keeps them, whoever moves or removes it.
        pack = load_pack(building, tuple(objects), tuple(meshes))
        _place(building, home)
        for other in _packs_in(folder):
            if other != home:
                shutil.rmtree(other, ignore_errors=True)
        return pack
    except OSError as error:
        raise unwritable(folder, error) from error
    finally:
        shutil.rmtree(building, ignore_errors=True)  # a full disk has no room for what is no pack


def _place(building: Path, home: Path) -> None:
    """Put a pack at its place, unless another run has put the same one there meanwhile."""
    if _finished(home) is None:
        shutil.rmtree(home, ignore_errors=True)  # damaged
        try:
            os.rename(building, home)
        except OSError:
            if _finished(home) is None:
                raise


def _packs_in(folder: Path) -> list[Path]:
    """Packs in a folder: those that are named and filled as one."""
    named = (path for path in sorted(folder.iterdir()) if NAME.fullmatch(path.name))
    return [path for path in named if (path / INDEX).is_file() and (path / "clouds.npy").is_file()]


def pack_views(
    cloud: NDArray[np.float32],
    T_camera_object: NDArray[np.float64],
    evidence: Sequence[ViewEvidence] | None = None,
) -> dict[str, NDArray]:
    """One object's per-view arrays (those of `Pack` but `object_of_view`)."""
    frames = [network_frame(c) for c in cloud]
    centre = np.stack([f.centre for f in frames])
    scale = np.array([f.scale for f in frames])
    network = (cloud - centre[:, None]) * scale[:, None, None]
    count = min(CENTRES, network.shape[1])
    order = farthest_point_order(torch.from_numpy(network), count).numpy()
    packed, neighbours = [], []
    for points, first in zip(network, order, strict=True):
        # A cloud of few distinct points repeats some in its farthest point order; cut to size.
        rest = np.setdiff1d(np.arange(len(points)), first)[: len(points) - count]
        points = points[np.concatenate([first, rest])].astype(np.float16)
        packed.append(points)
        exact = points.astype(np.float32)
        neighbours.append(cKDTree(exact).query(exact[:count], k=min(NEIGHBOURS, len(points)))[1])
    rotation, translation = T_camera_object[:, :3, :3], T_camera_object[:, :3, 3]
    to_network = np.concatenate([rotation, (translation - centre)[:, :, None]], axis=2)
    seen = zip(evidence or [ViewEvidence()] * len(frames), frames, strict=True)
    around = [surroundings_arrays(known, frame) for known, frame in seen]
    columns = dict(zip(SURROUNDINGS, map(np.stack, zip(*around, strict=True)), strict=True))
    return columns | {
        "maps": columns["maps"].astype(np.float16),
        "clouds": np.stack(packed),
        "neighbours": np.stack(neighbours).astype(np.uint16),
        "cameras": (-centre * scale[:, None]).astype(np.float32),
        "to_network": (to_network * scale[:, None, None]).astype(np.float32),
        "scale": scale.astype(np.float32),
    }


def _build(
    pairs: Sequence[tuple[Path, Path]],
    names: Sequence[str],
    folder: Path,
    limits: Mapping[str, int],
    on_progress: Callable[[int, int], None] | None,
) -> tuple[NDArray[np.int64], list[str]]:
    """Write the arrays into a folder; where each object's labels start, and its mesh's hash."""
    writers: dict[str, ArrayWriter] = {}
    starts = [0]
    meshes = []
    for done, (name, (view_file, label_file)) in enumerate(zip(names, pairs, strict=True)):
        views, labels = read_views(view_file), read_labels(label_file)
        unit = read_views_header(view_file).unit
        if (views.mesh_hash, unit) != (labels.mesh_hash, labels.unit):
            other = "mesh" if views.mesh_hash != labels.mesh_hash else "unit of the mesh"
            raise InputError(
                f"was made from another {other} than {label_file}",
                where=view_file,
                hint="render and label the same meshes again with --force",
            )
        meshes.append(views.mesh_hash)
        kept = slice(None, _limit(name, limits))
        arrays: dict[str, NDArray] = pack_views(
            views.cloud[kept], views.T_camera_object[kept], views.evidence[kept]
        )
        arrays["object_of_view"] = np.full(len(arrays["scale"]), done, np.int32)
        arrays["points"], arrays["sdf"] = labels.points, labels.sdf
        for key, array in arrays.items():
            if key not in writers:
                writers[key] = ArrayWriter(folder / f"{key}.bin", array)
            writers[key].append(array, view_file)
        starts.append(starts[-1] + len(labels.sdf))
        if on_progress is not None:
            on_progress(done + 1, len(pairs))
    for key, writer in writers.items():
        writer.finish(folder / f"{key}.npy")
    return np.array(starts, np.int64), meshes


def _check_limits(names: Sequence[str], limits: Mapping[str, int]) -> None:
    """Require an object in every limited folder: a typing error would limit nothing."""
    for prefix in limits:
        if not any(_lies_in(name, prefix) for name in names):
            folders = sorted({name.rpartition("/")[0] for name in names} - {""})
            raise InputError(
                f"no views lie in {prefix!r}",
                where="--views-per-object",
                allowed=", ".join(folders[:20]) or "a number alone: the views lie in no folders",
            )


def _limit(name: str, limits: Mapping[str, int]) -> int | None:
    """Largest number of views of an object: the limit of the longest folder that it lies in."""
    fitting = [prefix for prefix in limits if _lies_in(name, prefix)]
    return limits[max(fitting, key=len)] if fitting else None


def _lies_in(name: str, prefix: str) -> bool:
    return not prefix or name.startswith(prefix.rstrip("/") + "/")


def _finished(home: Path) -> Pack | None:
    """The pack in a folder, if one was finished there and is whole."""
    try:
        index = read_json(home / INDEX)
        return load_pack(home, tuple(index["names"]), tuple(index["meshes"]))
    except (InputError, ValueError, LookupError, TypeError):
        return None


def read_pack(folder: Path) -> Pack:
    """The finished pack in a training's `--pack` folder.

    Raises:
        InputError: There is none.
    """
    packs = map(_finished, _packs_in(folder) if folder.is_dir() else [])
    pack = next((pack for pack in packs if pack is not None), None)
    if pack is None:
        raise InputError("holds no pack", where=folder, allowed="what `train-sdf --pack` made")
    return pack


def load_pack(folder: Path, names: tuple[str, ...], meshes: tuple[str, ...]) -> Pack:
    """The arrays of a finished pack, mapped into memory."""
    arrays = {n: read_npy_array(folder / f"{n}.npy") for n in ARRAYS}
    return Pack(**arrays, names=names, meshes=meshes)


def _fingerprint(
    pairs: Sequence[tuple[Path, Path]], objects: Sequence[str], limits: Mapping[str, int]
) -> str:
    digest = hashlib.sha256(f"{FORMAT} {sorted(limits.items())} {CENTRES} {NEIGHBOURS}".encode())
    digest.update("\n".join(objects).encode())
    for pair in pairs:
        for path in pair:
            stat = path.stat()
            digest.update(f"{path.resolve()} {stat.st_size} {stat.st_mtime_ns}\n".encode())
    return digest.hexdigest()
