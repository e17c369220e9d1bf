"""Beginning of a run of `rgrasp train-sdf`: network, split and provenance, from scratch or not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.checkpoints import has_train_state, read_config
from pointsdf_cli.io.provenance import git_commit
from pointsdf_cli.models.registry import build_model, load_model
from pointsdf_cli.models.shape_model import ShapeModel
from pointsdf_cli.training.checks import require_share
from pointsdf_cli.training.presets import paper_steps, settings
from pointsdf_cli.training.sdf_config import TrainConfig
from pointsdf_cli.training.sdf_data import Split, held_out_names, split_views
from pointsdf_cli.training.sdf_pack import Pack

Start = tuple[ShapeModel, Split, TrainConfig, dict[str, Any], list[str]]


@dataclass(frozen=True)
class SdfRun:
    """A run to begin or to resume, by the command's options of these names.

    Raises:
        InputError: `held_out` is not a share of the objects.
    """

    views: Path
    out: Path
    model: str
    preset: str
    start_from: Path | None = None
    held_out: float = 0.05
    resume: bool = False

    def __post_init__(self) -> None:
        require_share(self, "held_out")

    def begin(self, data: Pack, given: Mapping[str, Any]) -> Start:
        """Build the network, split the data and complete the settings.

        Args:
            data: Views and labels.
            given: As for `settings`.

        Returns:
            Network with its initial weights, split, settings, provenance for config.json, and
            sentences for the user.

        Raises:
            InputError: The initial weights are of another architecture or size, or the resumed run
                began with others.
        """
        arguments, config = settings(self.model, self.preset, given)
        started = self.started_from()
        before = (started or {}).get("data", {})
        known = held_out_before(data, before)
        split = split_views(data, self.held_out, config.seed, known)
        if self.preset == "paper" and given["steps"] is None and given["minutes"] is None:
            config = replace(config, steps=paper_steps(len(split.train), config.batch_size))
        arguments = {**(started or {}).get("model", {}), **arguments}
        network = build_model(self.model, arguments, seed=config.seed)
        notes = []
        if self.start_from is not None and not self.resume:
            notes = self._begin_with(self.start_from, network, len(known), len(data.names))
        notes.append(
            f"{self.model} with {sum(p.numel() for p in network.parameters()) / 1e6:.1f} M "
            f"weights; {len(data.names)} objects, {len(split.train)} views to train on, "
            f"{len(split.held_out_objects)} of held-out objects"
        )
        # None where a run before this one may have learned from them.
        names = held_out_names(data, split)
        meshes = {mesh for name, mesh in zip(data.names, data.meshes, strict=True) if name in names}
        unknown = started is not None and not known
        provenance = {
            "preset": self.preset,
            "started_from": started,
            "data": {
                "objects": len(data.names),
                "views": len(data.scale),
                "held_out": None if unknown else sorted({*names, *before.get("held_out", ())}),
                "held_out_meshes": None
                if unknown
                else sorted({*meshes, *before.get("held_out_meshes", ())}),
            },
            "git_commit": git_commit(),
        }
        return network, split, config, provenance, notes

    def _begin_with(
        self, checkpoint: Path, network: ShapeModel, known: int, objects: int
    ) -> list[str]:
        """Load the initial weights; `known` of the objects were held out from their training."""
        try:
            network.begin_with(load_model(checkpoint))
        except RuntimeError as error:
            raise InputError(
                f"has other sizes than {self.model} --preset {self.preset}",
                where=f"--start-from {checkpoint}",
            ) from error
        if not known:
            return [
                f"{checkpoint} names no held-out object of {self.views}: it may have been trained "
                "on those that are held out here"
            ]
        if known < round(self.held_out * objects):
            return [
                f"{known} objects are held out, the same as for {checkpoint}; --held-out is not "
                "used"
            ]
        return []

    def started_from(self) -> dict[str, Any] | None:
        """config.json of the checkpoint with the run's initial weights.

        Raises:
            InputError: It is of another architecture, or the resumed run began with another one.
        """
        where = f"--start-from {self.start_from}"
        started = None if self.start_from is None else read_config(self.start_from)
        if self.resume and has_train_state(self.out):
            begun = read_config(self.out).get("started_from")
            if started is not None and started != begun:
                raise InputError(
                    "the run to resume did not begin with that checkpoint as it is now",
                    where=where,
                    hint="leave --start-from out: --resume needs none",
                )
            started = begun if begun is None else dict(begun)
        if started is not None and started.get("architecture") != self.model:
            raise InputError(f"is a {started.get('architecture')}", where=where, allowed=self.model)
        return started


def held_out_before(data: Pack, before: Mapping[str, Any]) -> set[str]:
    """Names of the objects that were held out when the initial weights were trained.

    Args:
        data: Views and labels of this run.
        before: `data` of the config.json of the initial weights. Meshes are compared by content;
            by name where it has names only.
    """
    meshes = before.get("held_out_meshes")
    if meshes is None:
        return set(before.get("held_out") or ()) & set(data.names)
    return {name for name, mesh in zip(data.names, data.meshes, strict=True) if mesh in meshes}


def view_limits(entries: Sequence[str]) -> dict[str, int]:
    """Largest number of views per object by folder, from `N` and `FOLDER=N`.

    Raises:
        InputError: An entry has another form.
    """
    limits = {}
    for entry in entries:
        folder, _, number = entry.rpartition("=")
        if not number.isdecimal() or int(number) < 1:
            raise InputError(
                f"{entry!r} is not a number of views",
                where="--views-per-object",
                allowed="N, FOLDER=N",
            )
        limits[folder] = int(number)
    return limits
