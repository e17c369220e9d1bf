"""List of trials: objects × yaws × repeats × cameras × variants (the paper, section V-C).

Both variants of a pair have the same object at the same pose, camera and noise. All random numbers
depend on (seed, object, repeat, yaw, camera) only, not on the order of the trials.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import numpy as np

from pointsdf_cli.choices import Method, require_choice
from pointsdf_cli.errors import InputError
from pointsdf_cli.io.meshes import find_meshes
from pointsdf_cli.objects.stand_ins import STAND_INS
from pointsdf_cli.planning.option_checks import PARTIAL_VIEW, RECONSTRUCTION

METHODS = get_args(Method)
CAMERAS = {"high": 0.85, "low": 0.40}
"""Heights above the table [m], 0.45 m apart as in the paper; the low one sees less."""

YCB_NAMES = {
    "mustard": ("006_mustard",),
    "soft_scrub": ("021_bleach",),
    "toy_airplane": ("072-a_toy",),
    "lego": ("073-a_lego", "073_lego", "073-"),
    "pringles": ("001_chips",),
    "pitcher": ("019_pitcher",),
}
"""Beginnings of the YCB names of the paper's objects; the other two are stand-ins."""

PUBLISHED = {
    RECONSTRUCTION: {"high": 0.50, "low": 0.42, "all": 0.48},
    PARTIAL_VIEW: {"high": 0.66, "low": 0.54, "all": 0.60},
}
"""The paper's success rates on the real robot."""
PUBLISHED_NO_PLAN = {RECONSTRUCTION: 11 / 48, PARTIAL_VIEW: 4 / 48}
PUBLISHED_SECONDS = {RECONSTRUCTION: 37.81, PARTIAL_VIEW: 36.55}


@dataclass(frozen=True)
class TrialObject:
    """One object of the protocol.

    Attributes:
        name: Name in the results.
        mesh: Mesh file; None for the stand-in of that name.
        upright: Whether the mesh's z axis is up, as in YCB and the stand-ins. Other meshes may have
            any orientation.
        unit: Unit of the mesh.
    """

    name: str
    mesh: Path | None = None
    upright: bool = False
    unit: str = "m"


@dataclass(frozen=True)
class PlannerVariant:
    """A method, or an ablation of it.

    Attributes:
        method: One of `METHODS`.
        ablation: Empty, or one of `ABLATIONS`, or "checkpoint=PATH".
    """

    method: str
    ablation: str = ""

    def __post_init__(self) -> None:
        require_choice(self.method, Method, "--method")
        known = self.ablation in ("", *ABLATIONS) or self.ablation.startswith(CHECKPOINT)
        if not known:
            raise InputError(
                f"no ablation {self.ablation!r}",
                where="--ablation",
                allowed=", ".join((*ABLATIONS, "all", f"{CHECKPOINT}PATH")),
            )

    @property
    def name(self) -> str:
        """Name for people: the method, with the ablation after a slash."""
        return f"{self.method}/{self.ablation}" if self.ablation else self.method


ORACLE, NO_CONSTRAINT, NO_SUCCESS = "oracle", "no-object-constraint", "no-success-network"
NO_CLEANING = "no-cleaning"
NO_FREE_SPACE, NO_SUPPORT_PLANE = "no-free-space", "no-support-plane"
ABLATIONS = (ORACLE, NO_CONSTRAINT, NO_SUCCESS, NO_CLEANING, NO_FREE_SPACE, NO_SUPPORT_PLANE)
CHECKPOINT = "checkpoint="


@dataclass(frozen=True)
class Trial:
    """One trial.

    Attributes:
        object: Object to grasp.
        yaw_index, yaws: Index of the yaw, and number of yaws.
        repeat: Number of the repetition; each has its own place, yaw offset and noise.
        camera: A key of `CAMERAS`.
        variant: Planner variant.
        seed: Random seed of the whole experiment.
        others: Objects that stand around it.
    """

    object: TrialObject
    yaw_index: int
    yaws: int
    repeat: int
    camera: str
    variant: PlannerVariant
    seed: int
    others: tuple[TrialObject, ...] = ()

    @property
    def scene_name(self) -> str:
        """Name of the scene: the object and its pose."""
        return f"{self.object.name}_yaw{self.yaw_index}_repeat{self.repeat}"

    @property
    def pair_name(self) -> str:
        """Name shared by the variants of a pair: the scene and the view of it."""
        return f"{self.scene_name}_{self.camera}"

    @property
    def name(self) -> str:
        """Name of this trial's file."""
        variant = self.variant.name.replace("/", "+")
        if self.variant.ablation.startswith(CHECKPOINT):
            # A checksum, as a path cannot be part of a file name.
            variant = f"{self.variant.method}+checkpoint-{zlib.crc32(variant.encode()):08x}"
        return f"{self.pair_name}_{variant}"

    def rng(self, of: str) -> np.random.Generator:
        """Random generator of "pose" (object and repeat), "scene", "others" (which), "clutter"
        (their poses) or "view"."""
        names = {
            "pose": f"{self.object.name} {self.repeat}",
            "scene": self.scene_name,
            "others": self.scene_name,
            "clutter": self.scene_name,
            "view": self.pair_name,
        }
        return np.random.default_rng([self.seed, zlib.crc32(f"{of} {names[of]}".encode())])


def checkpoints_of(variants: Iterable[PlannerVariant]) -> list[Path]:
    """Reconstruction networks that variants name by "checkpoint=PATH"."""
    named = [v.ablation for v in variants if v.ablation.startswith(CHECKPOINT)]
    return [Path(name.removeprefix(CHECKPOINT)) for name in named]


def choose_objects(
    meshes: Path | None, objects: str = "auto", pattern: str = "*", unit: str = "m"
) -> list[TrialObject]:
    """The objects of an experiment.

    Args:
        meshes: A folder of meshes, or one mesh; None for the eight stand-ins.
        objects: "eight" for the paper's, from the folder if it has them; "all" for every mesh of
            the folder; "others" for all but the paper's; "auto" for the eight if the folder has any
            of the paper's, else all; or names separated by commas.
        pattern: Only meshes with a matching file name.
        unit: Unit of the meshes.

    Raises:
        InputError: No such folder or object.
    """
    files = [] if meshes is None else find_meshes(meshes, pattern)
    by_paper: dict[str, Path] = {}
    for name, starts in YCB_NAMES.items():
        found = [path for start in starts for path in files if path.name.startswith(start)]
        if found:
            by_paper[name] = found[0]
    scanned = {name: TrialObject(name, path, True, unit) for name, path in by_paper.items()}
    eight = [scanned.get(name) or TrialObject(name, upright=True) for name in STAND_INS]
    if objects == "auto":
        objects = "eight" if by_paper or meshes is None else "all"
    if objects == "eight":
        return eight
    if meshes is None and objects in ("all", "others"):
        raise InputError(f"--objects {objects} needs a folder", hint="--meshes DIR")
    taken = set(by_paper.values()) if objects == "others" else set()
    every = [TrialObject(path.stem, path, unit=unit) for path in files if path not in taken]
    if objects in ("all", "others"):
        return _distinct(every)
    # A file of exactly the name of one of the eight takes precedence.
    known = {item.name: item for item in (*eight, *every)}
    named = [name.strip() for name in objects.split(",")]
    if len(set(named)) < len(named):
        raise InputError("names an object twice", where=f"--objects {objects}")
    _distinct([item for item in every if item.name in named])
    for name in named:
        if name not in known:
            raise InputError(
                f"no object {name!r}",
                where="--objects",
                allowed="auto, eight, all, others, or names: " + ", ".join(sorted(known)[:20]),
            )
    return [known[name] for name in named]


def planner_variants(method: str, ablations: Sequence[str] = ()) -> list[PlannerVariant]:
    """Planners to compare.

    Args:
        method: One of `METHODS`, or "both".
        ablations: Ablations of the reconstruction method to add, as in `PlannerVariant`; "all" are
            those in `ABLATIONS`.

    Raises:
        InputError: No such ablation.
    """
    variants = [PlannerVariant(one) for one in METHODS if method in ("both", one)]
    wanted = [one for name in ablations for one in (ABLATIONS if name == "all" else (name,))]
    return variants + [PlannerVariant(RECONSTRUCTION, one) for one in wanted]


def make_trials(
    objects: Sequence[TrialObject],
    variants: Sequence[PlannerVariant],
    yaws: int = 3,
    cameras: Sequence[str] = ("high", "low"),
    repeats: int = 1,
    seed: int = 0,
    clutter: int = 0,
    pool: Sequence[TrialObject] = (),
) -> list[Trial]:
    """All trials, pair by pair: variants of one pair follow each other.

    Args:
        objects, variants, yaws, cameras, repeats, seed: The experiment.
        clutter: Number of other objects around each, drawn for each scene.
        pool: Objects to draw them from; the target itself is excluded.

    Raises:
        InputError: No yaw, repeat or variant, an unknown camera, or a pool that is too small.
    """
    if yaws < 1 or repeats < 1:
        where = "--yaws" if yaws < 1 else "--repeats"
        raise InputError(f"{min(yaws, repeats)}", where=where, allowed="1 or more")
    unknown = [camera for camera in cameras if camera not in CAMERAS]
    if unknown or not cameras or len(set(cameras)) < len(cameras):
        what = f"no camera {', '.join(unknown)!r}" if unknown else "a camera is given twice"
        what = what if cameras else "no camera is given"
        raise InputError(what, where="--cameras", allowed=", ".join(CAMERAS))
    twice = sorted({one.name for one in variants if list(variants).count(one) > 1})
    if twice or not variants:
        what = f"{twice[0]} is given twice" if twice else "nothing to try"
        raise InputError(what, where="--method, --ablation", allowed="each once")
    trials = [
        Trial(item, yaw, yaws, repeat, camera, variant, seed)
        for item in objects
        for repeat in range(repeats)
        for yaw in range(yaws)
        for camera in cameras
        for variant in variants
    ]
    return [replace(one, others=_others(one, clutter, pool)) for one in trials]


def _others(trial: Trial, count: int, pool: Sequence[TrialObject]) -> tuple[TrialObject, ...]:
    """Objects of the pool to stand around the target.

    Raises:
        InputError: The pool is too small.
    """
    target = trial.object
    named_apart = [one for one in pool if one.name != target.name]
    free = [one for one in named_apart if one.mesh is None or one.mesh != target.mesh]
    if not 0 <= count <= len(free):
        raise InputError(
            f"{count}",
            where="--clutter",
            allowed=f"0 to {len(free)}, the number of other objects in the folder",
        )
    drawn = trial.rng("others").permutation(len(free))[:count]
    return tuple(free[k] for k in drawn)


def clutter_pool(meshes: Path | None, pattern: str = "*", unit: str = "m") -> list[TrialObject]:
    """Every object that may stand around a target: the folder's, or the eight stand-ins.

    Raises:
        InputError: No such folder.
    """
    if meshes is None:
        return [TrialObject(name) for name in STAND_INS]
    return [TrialObject(path.stem, path, unit=unit) for path in find_meshes(meshes, pattern)]


def _distinct(items: list[TrialObject]) -> list[TrialObject]:
    names = [item.name for item in items]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(
            f"two meshes are called {twice[0]}", where="--meshes", allowed="one mesh a name"
        )
    return items
