"""A planner that stays loaded: one robot, its networks, and the planners made from them."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from functools import cached_property, lru_cache

import torch

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.models.registry import load_model
from pointsdf_cli.models.shape_model import ShapeModel
from pointsdf_cli.planning.complete_mesh import CompletedMesh, complete_mesh
from pointsdf_cli.planning.grasp_planner import GraspPlanner, PlanOptions
from pointsdf_cli.planning.grasp_problem import Clearances
from pointsdf_cli.planning.mesh_choices import MeshChoices
from pointsdf_cli.planning.motion import MotionConfig
from pointsdf_cli.planning.object_view import ObjectView
from pointsdf_cli.planning.plan_on_table import answer_request, look_for
from pointsdf_cli.planning.plan_request import PlanChoices, PlanRequest, PlanResult
from pointsdf_cli.planning.planner import PlannerConfig
from pointsdf_cli.planning.synthesis import SynthesisConfig
from pointsdf_cli.planning.variables import Variables
from pointsdf_cli.robot.description import RobotDescription, load_robot
from pointsdf_cli.robot.start import require_within_limits, start_configuration
from pointsdf_cli.service.identity import PlannerFiles

KEPT = 4
"""Largest number of cached planners, one for each set of choices; each takes up to 100 MB."""


class Resident:
    """Loaded networks and planners that answer requests; not for several threads at once.

    Args:
        files: Robot and weights.
        device: Device of the networks.
    """

    def __init__(self, files: PlannerFiles | None = None, device: str = "cpu") -> None:
        self.files, self.device = files or PlannerFiles(), device
        self._identity: dict[str, str] | None = None
        self._planners: OrderedDict[PlanChoices, GraspPlanner] = OrderedDict()

    def identity(self) -> dict[str, str]:
        """Digests of the files when this was first asked. A server asks before it loads them; from
        then on, changed files are refused.

        Raises:
            InputError: The robot or a checkpoint cannot be read.
        """
        if self._identity is None:
            self._identity = self.files.identity()
        return self._identity

    def planner(self, choices: PlanChoices) -> GraspPlanner:
        """The planner for these options, made at their first use.

        Raises:
            InputError: The robot or a checkpoint cannot be used.
        """
        # No `lru_cache`: one of a bound method would keep a dropped `Resident` in memory.
        if choices not in self._planners:
            self._planners[choices] = self._made(choices)
            if len(self._planners) > KEPT:
                self._planners.popitem(last=False)
        self._planners.move_to_end(choices)
        return self._planners[choices]

    def plan(self, request: PlanRequest, warn: Callable[[str], None] | None = None) -> PlanResult:
        """The answer to a request.

        Args:
            request: Checked.
            warn: Called with each warning about implausible input, before planning.

        Raises:
            InputError: The clouds or the start cannot be used.
        """
        return answer_request(self.planner(request.choices), request, warn)

    def score(self, request: PlanRequest, q: Array) -> Array:
        """Success probability of grasps.

        Args:
            request: The scene, checked.
            q: [G, J], rad.

        Returns:
            [G], probabilities.

        Raises:
            InputError: Other joints, one beyond its limit, or clouds that show no such object.
        """
        planner = self.planner(request.choices)
        robot = planner.robot
        joints = robot.joint_names
        if q.shape[1] != len(joints) or not len(q):
            raise InputError(
                f"{len(q)} grasps of {q.shape[1]} joints",
                where="q",
                allowed=f"one grasp or more, of {len(joints)}: " + ", ".join(joints),
            )
        for k, grasp in enumerate(q):
            require_within_limits(grasp, robot, f"q, grasp {k}")
        start = start_configuration(request.start, robot)
        seen = look_for(request.target, request, robot, start)
        perceived = planner.see(seen.views, request.seed, table=request.environment.table)
        variables = Variables(robot)
        with torch.no_grad():
            hand = torch.from_numpy(q[:, robot.preshape_columns])
            palm = planner.planner.kinematics.palm(
                variables.configuration_tensor(torch.from_numpy(variables.of(q)))
            )
            return perceived.target.score.log_success(hand, palm).double().exp().numpy()

    def mesh(self, view: ObjectView, choices: MeshChoices, name: str) -> CompletedMesh:
        """The whole shape of the object in a view.

        Args:
            view: The object.
            choices: Meshing options.
            name: Name of the cloud, for messages.

        Raises:
            EmptySurfaceError: The network sees nothing solid.
        """
        return complete_mesh(self._shape, view, choices, name)

    @cached_property
    def robot(self) -> RobotDescription:
        """The robot, read at its first use.

        Raises:
            InputError: It cannot be used.
        """
        self._require_unchanged()
        return load_robot(self.files.robot)

    @cached_property
    def _shape(self) -> ShapeModel:
        self._require_unchanged()
        return load_model(self.files.checkpoint, self.device)

    def _require_unchanged(self) -> None:
        """Refuse to load files that have changed since `identity` was first asked."""
        if self._identity not in (None, self.files.identity()):
            raise InputError(
                "the robot or the weights have changed since the server was started",
                hint="start `rgrasp serve` again",
            )

    def _made(self, choices: PlanChoices) -> GraspPlanner:
        self._require_unchanged()
        clearance = choices.clearance
        options = PlanOptions(
            method=choices.method,
            kind=choices.kind,
            **vars(self.files),
            device=self.device,
            planner=PlannerConfig(
                solver=choices.solver,
                clearances=Clearances() if clearance is None else Clearances(*[clearance] * 3),
                margin=choices.margin,
                synthesis=SynthesisConfig(acceptance=choices.acceptance()),
                motion=MotionConfig(speed=choices.speed),
            ),
        )
        return GraspPlanner(options)


@lru_cache(maxsize=1)
def loaded(files: PlannerFiles, device: str) -> Resident:
    """A planner that is loaded once a process, as long as the same one is asked for."""
    return Resident(files, device)
