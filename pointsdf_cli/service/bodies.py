"""Bodies of requests: their fields, checks, and conversion to the planner's types."""

from __future__ import annotations

from typing import Any, Literal, TypeVar

import numpy as np
from pydantic import Field, ValidationError

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.trees import tree_of_npz
from pointsdf_cli.io.untrusted import parse_json
from pointsdf_cli.planning.environment import Environment
from pointsdf_cli.planning.mesh_choices import MeshChoices
from pointsdf_cli.planning.object_choice import TargetChoice
from pointsdf_cli.planning.option_checks import MARGIN, SPEED
from pointsdf_cli.planning.plan_request import PlanChoices, PlanRequest
from pointsdf_cli.service.body_parts import Body, CloudBody, EnvironmentBody, numbers

JSON, NPZ, HDF5 = "application/json", "application/x-npz", "application/x-hdf5"


class ExpectedPlanner(Body):
    """Version, robot and weights that the client expects; those left out are not checked."""

    version: str | None = None
    robot: str | None = None
    checkpoint: str | None = None
    grasp_checkpoint: str | None = None


class SceneBody(Body):
    """Views of one scene, and the chosen object."""

    clouds: list[CloudBody] = Field(min_length=1, max_length=16)
    segment: Literal["auto", "none"] = Field(
        "auto", description="none: the clouds hold the object alone"
    )
    target: int | list[float] | Literal["any"] | None = Field(
        None,
        description="Number in the list of `rgrasp segment`, pixel [u, v] or place [x, y, z] m; "
        "any for the first object that can be grasped",
    )
    workspace: numbers(2, 3) | None = Field(None, description="Corners of what is looked at [m]")  # type: ignore[valid-type]
    start: numbers(None) | None = Field(  # type: ignore[valid-type]
        None, description="The arm's joints, or all [rad or m]; home if null"
    )
    clean: bool = True
    seed: int = Field(0, ge=0, lt=2**63)
    expects: ExpectedPlanner = Field(default_factory=ExpectedPlanner)

    def check(self) -> None:
        """Refuse an invalid request before it enters the queue.

        Raises:
            InputError: A view or an option makes no sense.
        """
        for each in self.clouds:
            each.cloud()

    def wanted(self) -> TargetChoice | None:
        """The object that is meant.

        Raises:
            InputError: Neither a number nor a pixel nor a place.
        """
        given = self.target
        if given is None:
            return None
        if isinstance(given, str):
            return TargetChoice(any=True)
        if isinstance(given, int):
            return TargetChoice(number=given)
        if len(given) == 2:
            return TargetChoice(pixel=(given[0], given[1]))
        if len(given) == 3:
            return TargetChoice(place=np.array(given))
        raise InputError(
            f"{given} is not a target", where="target", allowed="N, [u, v] or [x, y, z]"
        )

    def corners(self) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
        """The workspace.

        Raises:
            InputError: The lower corner is not the lower one.
        """
        if self.workspace is None:
            return None
        low, high = self.workspace
        if not (low < high).all():
            raise InputError(
                f"{self.workspace.tolist()}", where="workspace", allowed="the lower corner first"
            )
        return tuple(low.tolist()), tuple(high.tolist())


class PlanBody(SceneBody):
    """A question for a plan; all but the clouds is as for `rgrasp plan`."""

    method: str = "reconstruction"
    solver: str = "sqp"
    kind: str = "auto"
    clearance: float | None = None
    margin: float = MARGIN
    speed: float = SPEED
    min_success: float | None = None
    ignore_others: bool = False
    obstacles: str = Field("reconstruction", description="Other objects: reconstruction or hull")
    environment: EnvironmentBody = Field(default_factory=EnvironmentBody)

    def choices(self) -> PlanChoices:
        """Options of the search.

        Raises:
            InputError: As `PlanChoices`.
        """
        names = PlanChoices.__dataclass_fields__
        return PlanChoices(**{name: getattr(self, name) for name in names})

    def request(self) -> PlanRequest:
        """The question, checked.

        Raises:
            InputError: With the message of `rgrasp plan`.
        """
        around = self.environment
        request = PlanRequest(
            [each.cloud() for each in self.clouds],
            [each.name for each in self.clouds],
            self.choices(),
            Environment(tuple(each.obstacle() for each in around.obstacles), around.table),
            self.start,
            self.seed,
            self.segment,
            self.wanted(),
            not self.ignore_others,
            self.corners(),
            self.clean,
            self.obstacles,
        )
        request.check()
        return request

    def check(self) -> None:
        """Refuse a scene that makes no sense; see `SceneBody.check`."""
        self.request()


class ScoreBody(PlanBody):
    """A question for the success of given grasps."""

    q: numbers(None, None) = Field(description="Grasps [G, J], rad, in the robot's joint order")  # type: ignore[valid-type]


class MeshBody(SceneBody):
    """A question for the whole shape of one object."""

    clouds: list[CloudBody] = Field(min_length=1, max_length=1)
    segment: Literal["auto", "none"] = "none"
    resolution: int = 128
    smooth: int = Field(25, ge=0, le=1000)
    all_parts: bool = False
    exact: bool = False

    def choices(self) -> MeshChoices:
        """Meshing options.

        Raises:
            InputError: As `MeshChoices`.
        """
        return MeshChoices(self.resolution, self.smooth, self.all_parts, self.exact, seed=self.seed)

    def check(self) -> None:
        """Refuse a view or an option that makes no sense; see `SceneBody.check`."""
        super().check()
        self.choices()
        self.wanted()
        self.corners()
        for_scenes = (self.target, self.workspace, self.start)
        if self.segment == "none" and any(given is not None for given in for_scenes):
            raise InputError(
                "target, workspace or start without segment auto", hint="add segment: auto"
            )


AnyBody = TypeVar("AnyBody", bound=SceneBody)


def read_body(kind: type[AnyBody], data: bytes, content_type: str) -> AnyBody:
    """A body of either form.

    Raises:
        InputError: Not of the form that its type says, or with parts that make no sense.
    """
    form = content_type.partition(";")[0].strip().lower()
    if form in ("", JSON):
        tree = parse_json(data, "body")
    elif form in (NPZ, "application/octet-stream"):
        tree = tree_of_npz(data, "body")
    else:
        raise InputError(f"a body of type {form}", where="Content-Type", allowed=f"{JSON}, {NPZ}")
    try:
        return kind.model_validate(tree)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        place = ".".join(str(part) for part in first["loc"]) or "body"
        said = first["msg"].removeprefix("Value error, ")
        raise InputError(
            f"{said[0].lower()}{said[1:]}", where=place[:200], hint="/docs lists what may be sent"
        ) from error


def schema_of(kind: type[Body]) -> tuple[dict[str, Any], dict[str, Any]]:
    """OpenAPI description of a body, and the schemas that it refers to, by name."""
    schema = kind.model_json_schema(ref_template="#/components/schemas/{model}")
    parts = schema.pop("$defs", {})
    binary = {"type": "string", "format": "binary"}
    content = {JSON: {"schema": schema}, NPZ: {"schema": binary}}
    return {"requestBody": {"required": True, "content": content}}, parts
