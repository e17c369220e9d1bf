"""Table of `rgrasp eval-gs`: success networks beside baselines on the same grasps."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.checkpoints import read_config
from pointsdf_cli.io.provenance import git_commit
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.training import gs_baselines
from pointsdf_cli.training import gs_evaluation as evaluation
from pointsdf_cli.training.gs_data import GraspData
from pointsdf_cli.training.gs_metrics import best_threshold
from pointsdf_cli.training.gs_variants import Sources, prepare_trained, title_of


def compare(
    checkpoints: Mapping[str, Path],
    data: GraspData,
    sources: Sources,
    grasps: Path,
    every: bool,
    seed: int,
) -> dict[str, Any]:
    """Measure networks and baselines on the held-out objects, less those that a network learned
    from.

    Args:
        checkpoints: Checkpoint of each network, by a short name.
        data: Grasps.
        sources: Sources of the networks' inputs.
        grasps: Folder of the grasps.
        every: Measure on all objects instead: none was used for training.
        seed: Random seed of the intervals.

    Raises:
        InputError: The grasps to measure on, or those to train on, are not both held and lost, or
            networks learned from all objects to measure on.
    """
    held_out = data.held_out[data.object_of]
    rows, known = np.flatnonzero(held_out), np.flatnonzero(~held_out)
    if every:
        rows = known = np.arange(len(data))
    taught = _taught(checkpoints, data)
    objects = np.unique(data.object_of[rows])
    if len(rows) and taught[objects].all():
        raise InputError(
            f"the networks learned from all {len(objects)} objects to measure on",
            where=f"--grasps {grasps}",
            allowed="grasps of other objects, or the folder that the networks were trained on",
        )
    rows = rows[~taught[data.object_of[rows]]]
    for part, what in ((rows, "held-out objects"), (known, "objects to train on")):
        if len(np.unique(data.label[part])) < 2:
            raise InputError(
                f"the grasps of {what} are not both held and lost",
                where=f"--grasps {grasps}",
                hint="collect more grasps, or of more objects",
            )
    methods: list[evaluation.Scored] = []
    for label, path in checkpoints.items():
        learner, prior, config = prepare_trained(path, data, sources)
        name = title_of(config)
        if name in [method.name for method in methods]:
            name = f"{name} ({label})"
        try:
            threshold = float(config["validation"]["threshold"])
            scale, shift = (float(config["calibration"][key]) for key in ("scale", "shift"))
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(
                "its config.json has no usable 'calibration' or 'validation'", where=path
            ) from error
        logits = learner.logits(rows)
        probability = expit(scale * logits + shift)
        methods.append(evaluation.Scored(name, logits, logits > 0, probability, threshold))
    scores = {
        "always success": gs_baselines.always(data, known),
        "prior only": gs_baselines.prior_score(data, prior, load_robot(sources.robot)),
    }
    if not every:  # else each grasp would be its own neighbour
        scores["10 nearest neighbours"] = gs_baselines.nearest_neighbours(data, known)
    for name, score in scores.items():
        best = best_threshold(data.label[known], score[known])
        methods.append(evaluation.Scored(name, score, score >= best).at(rows))
    return {
        "table": {method.name: evaluation.measure(data, rows, method, seed) for method in methods},
        "published_f1": evaluation.PUBLISHED,
        "held_out": evaluation.describe_grasps(data, rows),
        "known": evaluation.describe_grasps(data, known),
        "left_out": [data.meshes[k] for k in objects if taught[k]],
        "checkpoints": [str(path) for path in checkpoints.values()],
        "grasps": str(grasps),
        "seed": seed,
        "git_commit": git_commit(),
    }


def _taught(checkpoints: Mapping[str, Path], data: GraspData) -> NDArray[np.bool_]:
    """Whether a network learned from each object; networks that do not name their meshes count as
    if they had learned from none."""
    meshes: set[str] = set()
    for path in checkpoints.values():
        meshes |= set(read_config(path).get("data", {}).get("meshes", ()))
    return np.isin(data.meshes, sorted(meshes))
