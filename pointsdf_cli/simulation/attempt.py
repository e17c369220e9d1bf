"""Attempts to grasp an object: their settings, scenes and results."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.camera.sensor_presets import with_sensor_parameters
from pointsdf_cli.choices import GRASP_KINDS
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.visibility import ViewEvidence
from pointsdf_cli.io.grasps import CAUSES, HELD, INVALID, LOST, Grasps
from pointsdf_cli.simulation.executor import ExecutorConfig
from pointsdf_cli.simulation.heuristic import HeuristicConfig
from pointsdf_cli.simulation.observe import CameraPlacement
from pointsdf_cli.simulation.physics import PhysicsConfig
from pointsdf_cli.simulation.preshape_path import PreshapePath
from pointsdf_cli.simulation.verdict import UNTRIED, Outcome

SCENE_ATTEMPTS = 4
"""Number of attempts that share one pose of the object and one view of it."""


@dataclass(frozen=True)
class AttemptConfig:
    """Settings that determine the outcome of an attempt.

    Attributes:
        hand_alone: Simulate only the hand, as on a rigid arm; with the arm it takes several times
            as long.
        placement, heuristic, execution: Settings of camera, preshape and execution.
        physics: Contact simulation. Its step is twice that of trials, which changes slightly more
            labels than chance; its fewer iterations lose 0.8% of grasps (docs/notebook.md). With
            the arm: `with_the_whole_arm`.
    """

    hand_alone: bool = True
    placement: CameraPlacement = field(default_factory=CameraPlacement)
    heuristic: HeuristicConfig = field(default_factory=HeuristicConfig)
    physics: PhysicsConfig = field(
        default_factory=lambda: PhysicsConfig(step=1 / 240, iterations=140)
    )
    execution: ExecutorConfig = field(default_factory=ExecutorConfig)

    def with_the_whole_arm(self) -> AttemptConfig:
        """Settings with the whole arm simulated, as in a trial."""
        return replace(self, hand_alone=False, physics=PhysicsConfig())

    def as_dict(self) -> dict[str, Any]:
        """Settings for `config_json`."""
        plain = asdict(self)
        return plain | {"placement": with_sensor_parameters(plain["placement"])}


@dataclass(frozen=True)
class ObservedScene:
    """An object on the table, and its observation by the camera.

    Attributes:
        T_world_object, T_world_camera: [4, 4].
        cloud: [N, 3], the segmented object, camera frame, m.
        evidence: Observed space around it.
    """

    T_world_object: Array
    T_world_camera: Array
    cloud: Array
    evidence: ViewEvidence


@dataclass(frozen=True)
class PlannedPreshape:
    """A preshape that a planner proposes.

    Attributes:
        kind: One of `GRASP_KINDS`.
        T_world_palm: [4, 4].
        q: [J], its configuration.
    """

    kind: str
    T_world_palm: Array
    q: Array


Propose = Callable[[ObservedScene, np.random.Generator], list[PlannedPreshape]]
"""Function from a scene, of which it sees only the view, to at most `SCENE_ATTEMPTS` preshapes."""


class PreshapeSource(Hashable, Protocol):
    """Protocol of a planner's settings: they cross to worker processes and are loaded there."""

    def load(self) -> Propose:
        """The function that proposes preshapes."""

    def as_dict(self) -> dict[str, Any]:
        """Settings that determine the preshapes, for `config_json`."""


@dataclass(frozen=True)
class Attempt:
    """One attempt with one object; `Grasps` stores it."""

    index: int
    scene: ObservedScene
    cloud: NDArray[np.float32]
    kind: str
    T_world_palm: Array
    reach: PreshapePath
    outcome: Outcome | None

    @property
    def label(self) -> int:
        """As in `Grasps`."""
        if self.outcome is None:
            return self.reach.label
        if not self.outcome.valid:
            return INVALID
        return HELD if self.outcome.held else LOST

    @property
    def cause(self) -> str:
        """One of `CAUSES`."""
        return self.reach.cause if self.outcome is None else self.outcome.cause

    @property
    def unshaken(self) -> int:
        """As in `Grasps`."""
        if self.outcome is None or not self.outcome.valid:
            return UNTRIED
        return self.outcome.unshaken


def as_grasps(attempts: list[Attempt]) -> Grasps:
    """Arrays of attempts with one object, for storage."""

    def measured(name: str) -> NDArray[np.float32]:
        values = [np.nan if a.outcome is None else getattr(a.outcome, name) for a in attempts]
        return np.array(values, np.float32)

    return Grasps(
        cloud=np.array([a.cloud for a in attempts], np.float32),
        T_world_camera=np.array([a.scene.T_world_camera for a in attempts], np.float64),
        T_world_object=np.array([a.scene.T_world_object for a in attempts], np.float64),
        T_world_palm=np.array([a.T_world_palm for a in attempts], np.float64),
        q=np.array([a.reach.q for a in attempts], np.float64),
        label=np.array([a.label for a in attempts], np.int8),
        kind=np.array([GRASP_KINDS.index(a.kind) for a in attempts], np.int8),
        cause=np.array([CAUSES.index(a.cause) for a in attempts], np.int8),
        lift_height=measured("lift_height"),
        slip=measured("slip"),
        attempt=np.array([a.index for a in attempts], np.int32),
        scene=np.array([a.index // SCENE_ATTEMPTS for a in attempts], np.int32),
        evidence=tuple(a.scene.evidence for a in attempts),
        unshaken=np.array([a.unshaken for a in attempts], np.int8),
    )
