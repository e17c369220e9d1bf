"""Make objects and views of tables with them on every core, as files for learn.py.

    python pipelines/gpu/make_views.py OUT [--minutes M] [--files N] [--meshes DIR] [--workers N]

Each file holds some views of a few objects and, when an object comes first, labelled points: where
`render` and `label-sdf` write everything before `train-sdf` begins, learn.py reads files as they
appear. Views, sensors and errors are those of `render --scene table`. OUT/valid gets views of
objects of another seed, which nothing is trained on.
"""

from __future__ import annotations

import argparse
import itertools
import math
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import kernels
import numpy as np
import recipe
import torch
from numpy.typing import NDArray
from rays import use_embree_without_open3d
from threadpoolctl import threadpool_limits

from pointsdf_cli.camera.pinhole import CAMERAS, Camera
from pointsdf_cli.camera.scene_views import SceneView, SceneViewConfig, SceneViews
from pointsdf_cli.errors import InputError, leave_with_message
from pointsdf_cli.geometry.cloud_sampling import systematic_sample
from pointsdf_cli.geometry.sdf_sampling import BOX, MARGIN, NEAR_VARIANCE, WIDE_VARIANCE
from pointsdf_cli.geometry.signed_distance import sample_surface
from pointsdf_cli.geometry.visibility import SIZE
from pointsdf_cli.io.meshes import LoadedMesh, find_meshes, load_mesh
from pointsdf_cli.io.provenance import data_sha256, file_sha256, git_commit
from pointsdf_cli.models.neighbours import farthest_point_order, nearest_neighbours
from pointsdf_cli.models.normalise import network_frame
from pointsdf_cli.models.shape_model import PACKED_CENTRES, PACKED_NEIGHBOURS
from pointsdf_cli.models.surroundings import signed_distance
from pointsdf_cli.objects.generate import make_object

MOST_POINTS = 3000
"""Points kept of a view; each step draws the network's from them anew."""
SIZES = (1000, 2000, 3000)
"""Sizes of the clouds that `--samplings` makes."""
LABELS = 12_000
UNKNOWN = -60.0
"""Free depth of rays without evidence."""
FARTHEST = 8.0
"""Free depths are clipped to this, network units behind or before the object."""
ALL_INSIDE = 99.0
"""Distance to a region that holds every cell or none [cells]; no other distance is as large."""
COLOUR = Camera(640, 480, 1067.0, 1067.0, 319.5, 239.5)
"""Depth registered to a colour camera of long focal length."""
CAMERA_SHARES = {"colour": 0.25, "xtion": 0.3, "realsense": 0.25, "reference": 0.2}
SENSORS = ("ideal", *3 * ("structured-light",), *2 * ("stereo",))
"""Sensors, one drawn for each view; those that err are repeated to be drawn more often."""
VALIDATION_SEED, VALIDATION_OBJECTS, VALIDATION_VIEWS = 62, 64, 5
SCAN_SHAPES = 12
"""Objects made of each scan: itself and others stretched along its axes."""
STRETCHED = 0.2
"""Share of generated objects that are stretched too: few real bottles are round."""
STRETCH = 0.15
"""Standard deviation of the logarithm of a stretch along an axis."""


@dataclass(frozen=True)
class Source:
    """One object: number `index` of generated ones of `seed`, or the mesh file `path`."""

    number: int
    seed: int = 0
    index: int = 0
    path: Path | None = None
    stretched: bool = False

    def mesh(self) -> LoadedMesh:
        """The mesh, in metres."""
        if self.path is not None:
            mesh = load_mesh(self.path)
        else:
            made = make_object(self.seed, self.index)
            mesh = LoadedMesh(made.name, made.vertices.astype(np.float64), made.faces, "", "none")
        if not self.stretched:
            return mesh
        rng = np.random.default_rng([self.seed, self.number])
        return replace(mesh, vertices=mesh.vertices * np.exp(STRETCH * rng.standard_normal(3)))


@dataclass(frozen=True)
class Task:
    """One file to make; `labelled` where the objects' labels go with it. `samplings`: as in
    `sampled`."""

    number: int
    sources: tuple[Source, ...]
    views: int
    labelled: bool
    config: SceneViewConfig
    out: Path
    samplings: int = 0


def make_file(task: Task) -> int:
    """Write the file of a task; the number of its views. Objects that are never seen are left
    out."""
    rows: list[dict[str, NDArray]] = []
    labels: list[dict[str, NDArray]] = []
    for place, source in enumerate(task.sources):
        rng = np.random.default_rng([task.number, source.number, place])
        try:
            mesh = source.mesh()
            drawn = _draw(mesh, task, rng)
        except InputError as error:
            print(f"object {source.number}: {error}", file=sys.stderr)
            continue
        number = np.array(source.number, np.int32)
        made = [view_arrays(view, rng) | {"object": number} for view in drawn]
        rows += [row | sampled(row, task.samplings, rng) for row in made]
        if task.labelled:
            labels.append(label_arrays(mesh, rng) | {"label_object": number})
            if task.samplings:  # for a processor: it would do this beside the training
                labels[-1]["label_sdf"] = kernels.signed_distance(
                    *(torch.from_numpy(labels[-1][n]) for n in ("label_points", "label_triangles"))
                ).numpy()
    if rows:
        data = {key: np.stack([row[key] for row in rows]) for key in rows[0]}
        if labels:
            triangles = [each.pop("label_triangles") for each in labels]
            data["label_faces"] = np.array([len(t) for t in triangles], np.int32)
            data["label_triangles"] = np.concatenate(triangles)
            data |= {key: np.stack([each[key] for each in labels]) for key in labels[0]}
        task.out.mkdir(parents=True, exist_ok=True)
        unfinished = task.out / f".{task.number:06d}.npz"
        np.savez(unfinished, **data)
        os.replace(unfinished, path_of(task))
    return len(rows)


def path_of(task: Task) -> Path:
    """The task's file."""
    return task.out / f"{task.number:06d}.npz"


def _draw(mesh: LoadedMesh, task: Task, rng: np.random.Generator) -> list[SceneView]:
    cameras = [COLOUR, *(CAMERAS[name] for name in list(CAMERA_SHARES)[1:])]
    camera = cameras[rng.choice(len(cameras), p=list(CAMERA_SHARES.values()))]
    drawer = SceneViews(mesh, camera, task.config)
    return [drawer.draw(rng)[0] for _ in range(task.views)]


def view_arrays(view: SceneView, rng: np.random.Generator) -> dict[str, NDArray]:
    """Arrays of a view for learn.py, in the network's frame of all its points.

    `points` f2 [MOST_POINTS, 3], the first `count` of them along a curve over the image; `camera`,
    `to_network` and `scale` as in `sdf_pack.Pack`; `free`, `regions`, `window`, `plane` and `known`
    are the evidence before it is scaled with a cloud (`models/surroundings.py`).
    """
    count = min(MOST_POINTS, len(view.points))
    points = view.points[systematic_sample(view.points[:, :2], count, rng)]
    frame = network_frame(points)
    kept = np.zeros((MOST_POINTS, 3), np.float16)
    kept[:count] = frame.to_network(points)
    pose = view.T_camera_object
    to_network = np.column_stack([pose[:3, :3], pose[:3, 3] - frame.centre]) * frame.scale
    free = np.full((SIZE, SIZE), UNKNOWN, np.float16)
    regions = np.zeros((2, SIZE, SIZE), np.float16)
    window, plane, known = np.zeros(4), np.zeros(4), np.zeros(2)
    if view.evidence.visibility is not None:
        window, seen, depth = view.evidence.visibility
        behind = np.clip((depth - frame.centre[2]) * frame.scale, -FARTHEST, FARTHEST)
        free[depth > 0] = behind[depth > 0]
        regions[0] = signed_distance((depth > 0) & (behind > 0.6), 1.0, ALL_INSIDE)
        regions[1] = signed_distance(seen, 1.0, ALL_INSIDE)
        known[0] = 1.0
    if view.evidence.support_plane is not None:
        normal, offset = view.evidence.support_plane[:3], view.evidence.support_plane[3]
        plane = np.array([*normal, (offset - normal @ frame.centre) * frame.scale])
        known[1] = 1.0
    single = {
        "camera": -frame.centre * frame.scale,
        "to_network": to_network,
        "scale": np.array(frame.scale),
        "window": window,
        "plane": plane,
        "known": known,
    }
    arrays: dict[str, NDArray] = {k: np.asarray(v, np.float32) for k, v in single.items()}
    total = np.array(count, np.int32)
    return arrays | {"points": kept, "count": total, "free": free, "regions": regions}


def sampled(
    row: dict[str, NDArray], samplings: int, rng: np.random.Generator
) -> dict[str, NDArray]:
    """Clouds of each of `SIZES` from a view's points, ready for the network: on a processor a step
    spends half of its time on making them.

    For each size N that the view has the points for, `indices<N>` i2 [samplings, N], the farthest
    points first, and `neighbours<N>` i2 [samplings, M, K] of these.
    """
    arrays: dict[str, NDArray] = {}
    points, total = row["points"].astype(np.float32), int(row["count"])
    for size in SIZES if samplings else ():
        indices = np.zeros((samplings, size), np.int16)
        neighbours = np.zeros((samplings, PACKED_CENTRES, PACKED_NEIGHBOURS), np.int16)
        for k in range(samplings if total >= size or size == SIZES[0] else 0):
            # The points lie along a curve already.
            steps = ((np.arange(size) + rng.random()) * (total / size)).astype(np.int64)
            chosen = np.arange(size) if total < size else np.minimum(steps, total - 1)
            chosen[chosen >= total] = rng.integers(total, size=max(0, size - total))
            cloud = torch.from_numpy(points[chosen])[None]
            rank = np.arange(size, 2 * size)
            rank[farthest_point_order(cloud, PACKED_CENTRES)[0].numpy()] = range(PACKED_CENTRES)
            order = np.argsort(rank)
            cloud, indices[k] = cloud[:, order], chosen[order]
            centres = cloud[:, :PACKED_CENTRES]
            neighbours[k] = nearest_neighbours(centres, cloud, PACKED_NEIGHBOURS)[0].numpy()
        arrays |= {f"indices{size}": indices, f"neighbours{size}": neighbours}
    return arrays


def label_arrays(mesh: LoadedMesh, rng: np.random.Generator) -> dict[str, NDArray]:
    """Points to label about the box's centre, spread as `sample_sdf` does, and the triangles."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    centre, unit = (low + high) / 2, MARGIN * float((high - low).max())
    near = round(0.4 * LABELS)
    surface, _ = sample_surface(mesh.vertices, mesh.faces, 2 * near, rng)
    deviation = unit * np.sqrt(np.repeat([WIDE_VARIANCE, NEAR_VARIANCE], near))
    surface = surface - centre + deviation[:, None] * rng.standard_normal((2 * near, 3))
    uniform = unit * rng.uniform(-BOX, BOX, (LABELS - 2 * near, 3))
    corners = (mesh.vertices - centre)[mesh.faces].reshape(-1, 9)
    return {
        "label_points": np.concatenate([surface, uniform]).astype(np.float32),
        "label_triangles": corners.astype(np.float32),
        "label_centre": centre.astype(np.float32),
    }


def tasks(options: argparse.Namespace) -> Iterator[Task]:
    """Validation first, then rounds over all objects in new orders, without end."""
    config = SceneViewConfig(
        SENSORS, exact=options.exact, sensor_spread=options.spread, dark=options.dark,
        strips=options.strips,
    )  # fmt: skip
    preset = replace(config, sensor_spread=0.0, dark=0.0, strips=0.0)
    held = [Source(k, VALIDATION_SEED, k) for k in range(options.validation)]
    for first in range(0, len(held), 8):
        group = tuple(held[first : first + 8])
        valid = options.out / "valid"
        yield Task(first, group, VALIDATION_VIEWS, True, preset, valid, options.samplings)
    rng = np.random.default_rng(options.seed)
    stretched = rng.random(options.objects) < STRETCHED
    every = [Source(k, options.seed, k, None, bool(s)) for k, s in enumerate(stretched)]
    scans = find_meshes(options.meshes) if options.meshes else []
    for shape, path in itertools.product(range(SCAN_SHAPES), scans):
        every.append(Source(len(every), options.seed, 0, path, shape > 0))
    number = 0
    for turn in itertools.count():
        order = rng.permutation(len(every))
        for first in range(0, len(order), options.group):
            sources = tuple(every[k] for k in order[first : first + options.group])
            labelled = turn == 0
            yield Task(
                number, sources, options.views, labelled, config, options.out, options.samplings
            )
            number += 1


def write_recipe(options: argparse.Namespace) -> None:
    """Write the options that decide what the views are, for the checkpoint's config.

    Raises:
        InputError: Others made the views that are there.
    """
    names = ("seed", "objects", "views", "exact", "spread", "dark", "strips", "samplings", "group")
    scans = find_meshes(options.meshes) if options.meshes else []
    deciding = {name: getattr(options, name) for name in (*names, "validation")} | {
        "scans": len(scans),
        "scans_sha256": data_sha256(map(file_sha256, scans)),
        "shapes_per_scan": SCAN_SHAPES,
        "stretched": STRETCHED,
        "stretch": STRETCH,
        "sensors": list(SENSORS),
        "camera_shares": CAMERA_SHARES,
        "git_commit": git_commit(),
    }
    recipe.begin(options.out, deciding)


@leave_with_message()
def main() -> None:
    """Make files until the time is over; those that are there are not made again."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--minutes", type=float, default=math.inf, help="until stopped")
    parser.add_argument("--files", type=int, help="most files, validation included")
    parser.add_argument("--meshes", type=Path, help="folder of scans")
    parser.add_argument("--objects", type=int, default=6000, help="generated objects")
    parser.add_argument("--validation", type=int, default=VALIDATION_OBJECTS)
    parser.add_argument("--views", type=int, default=6, help="views of an object in a file")
    parser.add_argument("--group", type=int, default=12, help="objects of a file")
    parser.add_argument("--exact", type=float, default=0.4, help="share of views without errors")
    parser.add_argument("--spread", type=float, default=0.5, help="spread of the sensors' errors")
    parser.add_argument("--dark", type=float, default=0.15, help="share of views of dark things")
    parser.add_argument("--strips", type=float, default=0.5,
                        help="share of views that lose strips beside shadows")  # fmt: skip
    parser.add_argument("--samplings", type=int, default=0,
                        help="clouds of each size and view to make here, and signed distances; "
                             "0: in learn.py, which only a GPU does quickly")  # fmt: skip
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--workers", type=int, default=max(1, (os.cpu_count() or 2) - 2))
    options = parser.parse_args()
    if options.seed == VALIDATION_SEED:
        parser.error(f"--seed {VALIDATION_SEED} makes the held-out objects; give another")
    end = time.monotonic() + 60 * options.minutes
    write_recipe(options)
    every = itertools.islice(tasks(options), options.files)
    missing = (task for task in every if not path_of(task).exists())
    made = 0
    use_embree_without_open3d()
    # Leaving the block below ends the workers.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    torch.set_num_threads(1)
    context = multiprocessing.get_context("fork")
    with context.Pool(options.workers, threadpool_limits, (1,)) as pool:
        waiting = [pool.apply_async(make_file, (task,)) for task in
                   itertools.islice(missing, 2 * options.workers)]  # fmt: skip
        while waiting and time.monotonic() < end:
            finished = [result for result in waiting if result.ready()]
            for result in finished:
                made += result.get()
                waiting.remove(result)
                for task in itertools.islice(missing, 1):
                    waiting.append(pool.apply_async(make_file, (task,)))
            if finished:
                print(f"{made} views", flush=True)
            time.sleep(0.05)
        pool.terminate()
    (options.out / recipe.ENDED).touch()


if __name__ == "__main__":
    main()
