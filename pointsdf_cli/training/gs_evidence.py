"""Cache of a shape network's embeddings and distances for grasps.

They are stored in one file for each grasps file, named by a hash of the grasps, the network's
weights and the evaluated points. A second training run reads them in a second.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.cloud_sampling import systematic_sample
from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.io.atomic import require_folder
from pointsdf_cli.io.batch import run_stage
from pointsdf_cli.io.grasp_evidence import Evidence, join_evidence, read_evidence, write_evidence
from pointsdf_cli.io.grasps import Grasps, read_grasps
from pointsdf_cli.io.provenance import file_sha256
from pointsdf_cli.models.grasp_checkpoint import weights_hash
from pointsdf_cli.models.grasp_features import BODY_SIZE, GraspFeatures, object_body
from pointsdf_cli.models.hand_sweep import HandSweep, SweepConfig
from pointsdf_cli.models.normalise import network_frame
from pointsdf_cli.models.reconstruction import Reconstruction
from pointsdf_cli.models.registry import load_cached, use_threads
from pointsdf_cli.models.shape_model import ShapeModel
from pointsdf_cli.robot.description import load_robot, robot_digest
from pointsdf_cli.training.gs_data import GraspData
from pointsdf_cli.training.precision import autocast_dtype

RECIPE = 3
"""Version of the cache; increases when the same inputs give other numbers."""


@dataclass(frozen=True)
class EvidenceTask:
    """One grasps file for one worker process.

    Attributes:
        grasps: The grasps file.
        out: Path of its evidence.
        key: Hash of everything that the evidence depends on.
        encoder: The shape network's checkpoint.
        sweep: Points for the hand's distances; None for embeddings only.
        robot: The robot's YAML; None for the bundled one.
    """

    grasps: Path
    out: Path
    key: str
    encoder: Path
    sweep: SweepConfig | None
    robot: Path | None


def evidence_of(
    data: GraspData,
    encoder: Path,
    cache: Path,
    *,
    sweep: SweepConfig | None,
    robot: Path | None = None,
    jobs: int = 1,
    on_done: Callable[[str, object], None] | None = None,
) -> Evidence:
    """The evidence of all grasps, from the cache or computed.

    Args:
        data: The grasps.
        encoder: Checkpoint directory of the shape network.
        cache: Folder of the cache.
        sweep: Points for the distances; None for embeddings only.
        robot: The robot's YAML; None for the bundled one.
        jobs: Processes.
        on_done: Called with each file's name.

    Raises:
        InputError: The checkpoint or the cache cannot be used.
    """
    cache = require_folder(cache)
    weights = weights_hash(encoder)
    if not load_cached(encoder).gives_distances and sweep is not None:
        raise InputError(
            f"a {load_cached(encoder).architecture} gives no distances",
            where=encoder,
            allowed="a network of signed distances, such as pointsdf-ray",
        )
    tasks = []
    asked = None if sweep is None else asdict(sweep)
    digest, precision = robot_digest(robot), str(autocast_dtype("auto", torch.device("cpu")))
    for name, file in zip(data.names, data.files, strict=True):
        decides = [RECIPE, file_sha256(file), weights, asked, digest, precision]
        key = hashlib.sha256(json.dumps(decides).encode()).hexdigest()
        out = cache / f"{name.replace('/', '__')}-{key[:16]}.h5"
        tasks.append((name, EvidenceTask(file, out, key, encoder, sweep, robot)))
    missing = [(name, task) for name, task in tasks if not task.out.is_file()]
    made = run_stage(missing, make_evidence, jobs=jobs, folders=[cache], on_done=on_done)
    made.raise_if_refused("mend or remove them and run the same command again")
    evidence = join_evidence([read_evidence(task.out) for _, task in tasks])
    if len(evidence.scale) != len(data):
        raise InputError("does not fit the grasps", where=cache, hint=f"remove {cache}")
    return evidence


def make_evidence(task: EvidenceTask) -> int:
    """Compute a network's features for the executed grasps of one file and write them."""
    use_threads(1)
    model = load_cached(task.encoder)
    robot = load_robot(task.robot)
    grasps, meta = read_grasps(task.grasps)
    columns = [meta.joint_names.index(joint) for joint in robot.preshape_joints]
    chosen = np.flatnonzero(grasps.executed)
    scene = grasps.scene[chosen]
    if task.sweep is None:
        evidence = _embeddings(model, grasps.cloud[chosen], grasps.T_world_camera[chosen], scene)
    else:
        features = GraspFeatures(HandSweep(robot, task.sweep), robot.preshape_ranges)
        scenes = [chosen[scene == k] for k in np.unique(scene)]
        parts = [_scene_evidence(model, grasps, rows, columns, features) for rows in scenes]
        evidence = join_evidence(parts)
        back = np.argsort(np.concatenate(scenes), kind="stable")
        evidence = Evidence(**{name: array[back] for name, array in vars(evidence).items()})
    write_evidence(task.out, evidence, task.key)
    return len(chosen)


def _scene_evidence(
    model: ShapeModel,
    grasps: Grasps,
    rows: NDArray[np.int64],
    columns: list[int],
    features: GraspFeatures,
) -> Evidence:
    """Evidence of the grasps `rows` [G] of one scene, whose view is encoded once.

    Args:
        model: The shape network.
        grasps: Grasps of one file.
        rows: Indices of the scene's grasps.
        columns: Columns of the preshape joints in `grasps.q`.
        features: Features that tell at which points distances are asked for.
    """
    first, count = rows[0], len(rows)
    pose = grasps.T_world_camera[first]
    points = apply_transform(pose, grasps.cloud[first])
    # One sampling, as `_embeddings` reads it.
    shape = Reconstruction.from_cloud(
        model, points, pose[:3, 3], pose[:3, :3], evidence=grasps.evidence[first], tries=1
    )
    preshape, palm = grasps.q[rows][:, columns], grasps.T_world_palm[rows]
    asked = features.points(torch.tensor(preshape), torch.tensor(palm))
    found = object_body(points, shape.sdf)
    body = torch.cat([found.centre, found.mass_centre, found.numbers]).numpy()
    return Evidence(
        embedding=np.repeat(shape.embedding[None], count, axis=0).astype(np.float32),
        centre=np.repeat(shape.centre[None], count, axis=0),
        scale=np.full(count, shape.scale),
        size=np.repeat(shape.size[None], count, axis=0).astype(np.float32),
        distance=shape.sdf(asked.numpy()),
        body=np.repeat(body[None], count, axis=0),
    )


def _embeddings(
    model: ShapeModel,
    cloud: NDArray[np.float32],
    T_world_camera: NDArray[np.float64],
    scene: NDArray[np.integer],
) -> Evidence:
    """Embeddings of all grasps [G] of one file: each scene's view is encoded, nothing decoded."""
    first, of_grasp = np.unique(scene, return_index=True, return_inverse=True)[1:]
    # In the order in which a reconstruction samples them: it moves the embedding a little.
    seen = [
        points[systematic_sample(points[:, :2], len(points), np.random.default_rng(0))]
        for points in cloud[first]
    ]
    frames = [network_frame(points) for points in seen]
    clouds = np.stack([f.to_network(points) for f, points in zip(frames, seen, strict=True)])
    cameras = np.stack([frame.to_network(np.zeros(3)) for frame in frames])
    with torch.no_grad():
        embedding = model.embed(torch.tensor(clouds).float(), torch.tensor(cameras).float())
    placed = zip(T_world_camera[first], frames, strict=True)
    centre = np.concatenate([apply_transform(pose, frame.centre[None]) for pose, frame in placed])
    count = len(cloud)
    return Evidence(
        embedding=embedding.numpy()[of_grasp],
        centre=centre[of_grasp],
        scale=np.array([frame.scale for frame in frames])[of_grasp],
        size=np.ptp(cloud[first], axis=1)[of_grasp],
        distance=np.zeros((count, 0), np.float32),
        body=np.zeros((count, 6 + BODY_SIZE), np.float32),
    )
