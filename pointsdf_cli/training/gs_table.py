"""Table of `rgrasp eval-gs`: success networks beside baselines on the same grasps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array, Indices
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
        InputError: Grasps to measure on, or to train on, are not both held and lost, or networks
            learned from all objects to measure on.
    """
    held_out = data.held_out[data.object_of]
    rows, known = np.flatnonzero(held_out | every), np.flatnonzero(~held_out | every)
    taught = _taught(checkpoints, data)
    objects = np.unique(data.object_of[rows])
    if len(rows) and taught[objects].all():
        what = f"the networks learned from all {len(objects)} objects to measure on"
        others = "grasps of other objects, or the folder that the networks were trained on"
        raise InputError(what, where=f"--grasps {grasps}", allowed=others)
    rows = rows[~taught[data.object_of[rows]]]
    _require_both_outcomes(data.label[rows], "held-out objects", grasps)
    _require_both_outcomes(data.label[known], "objects to train on", grasps)
    methods: list[evaluation.Scored] = []
    for label, path in checkpoints.items():
        learner, prior, config = prepare_trained(path, data, sources)
        name = title_of(config)
        if name in [method.name for method in methods]:
            name = f"{name} ({label})"
        threshold, scale, shift = _calibration(config, path)
        logits = learner.logits(rows)
        probability = expit(scale * logits + shift)
        methods.append(evaluation.Scored(name, logits, logits > 0, probability, threshold))
    by_prior = gs_baselines.prior_score(data, prior, load_robot(sources.robot))
    baselines = {"always success": gs_baselines.always(data, known), "prior only": by_prior}
    if not every:  # else each grasp would be its own neighbour
        baselines["10 nearest neighbours"] = gs_baselines.nearest_neighbours(data, known)
    methods += _scored(baselines, data, known, rows)
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


def _scored(
    scores: Mapping[str, Array], data: GraspData, known: Indices, rows: Indices
) -> Iterator[evaluation.Scored]:
    """Baselines on the grasps `rows`, by their scores of all and the best threshold for `known`."""
    for name, score in scores.items():
        best = best_threshold(data.label[known], score[known])
        yield evaluation.Scored(name, score, score >= best).at(rows)


def _require_both_outcomes(label: NDArray[np.float32], what: str, grasps: Path) -> None:
    if len(np.unique(label)) < 2:
        raise InputError(
            f"the grasps of {what} are not both held and lost",
            where=f"--grasps {grasps}",
            hint="collect more grasps, or of more objects",
        )


def _calibration(config: Mapping[str, Any], path: Path) -> tuple[float, float, float]:
    """Threshold of the probability, scale and shift of the logits, of a network's config."""
    try:
        threshold = float(config["validation"]["threshold"])
        scale, shift = (float(config["calibration"][key]) for key in ("scale", "shift"))
    except (KeyError, TypeError, ValueError) as error:
        what = "its config.json has no usable 'calibration' or 'validation'"
        raise InputError(what, where=path) from error
    return threshold, scale, shift


def _taught(checkpoints: Mapping[str, Path], data: GraspData) -> NDArray[np.bool_]:
    """Whether a network learned from each object; networks that do not name their meshes count as
    if they had learned from none."""
    meshes: set[str] = set()
    for path in checkpoints.values():
        meshes |= set(read_config(path).get("data", {}).get("meshes", ()))
    return np.isin(data.meshes, sorted(meshes))
