"""Bodies of requests: their fields, checks, and conversion to the planner's types."""

from __future__ import annotations

from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, WithJsonSchema

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import is_rigid
from pointsdf_cli.io.clouds import Cloud, DepthImage
from pointsdf_cli.io.trees import tree_of_json, tree_of_npz
from pointsdf_cli.planning.environment import Environment, Obstacle
from pointsdf_cli.planning.object_choice import TargetChoice
from pointsdf_cli.planning.plan_request import PlanChoices, PlanRequest

JSON, NPZ, HDF5 = "application/json", "application/x-npz", "application/x-hdf5"


def _numbers(*shape: int | None) -> Any:
    """Finite numbers as an array of a shape, in which None is any length."""
    text = ", ".join("N" if side is None else str(side) for side in shape)

    def check(value: Any) -> NDArray[np.float64]:
        try:
            array = np.asarray(value)
            if array.dtype.kind not in "buif":
                raise ValueError
        except (ValueError, TypeError, OverflowError):
            raise ValueError(f"not numbers [{text}]") from None
        fits = len(shape) == array.ndim and all(
            side in (None, length) for side, length in zip(shape, array.shape, strict=True)
        )
        if not fits:
            raise ValueError(f"numbers {list(array.shape)}, not [{text}]")
        if not np.isfinite(array).all():
            raise ValueError("holds NaN or infinity")
        return array.astype(np.float64)

    schema: dict[str, Any] = {"type": "number"}
    for _ in shape:
        schema = {"type": "array", "items": schema}
    return Annotated[
        Any, BeforeValidator(check), WithJsonSchema({**schema, "description": f"[{text}]"})
    ]


class _Body(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class CloudBody(_Body):
    """One view of the scene, in metres."""

    points: _numbers(None, 3) = Field(description="[N, 3] m, in `frame`")  # type: ignore[valid-type]
    frame: Literal["camera", "world"] = "camera"
    T_world_camera: _numbers(4, 4) | None = None  # type: ignore[valid-type]
    name: str = Field("cloud", max_length=4096, description="For messages")
    pixels: _numbers(None, 2) | None = None  # type: ignore[valid-type]
    depth: _numbers(None, None) | None = None  # type: ignore[valid-type]
    K: _numbers(3, 3) | None = None  # type: ignore[valid-type]
    mask: _numbers(None) | None = None  # type: ignore[valid-type]
    mask_rays: _numbers(None, 2) | None = Field(  # type: ignore[valid-type]
        None, description="[K, 2], tangents x/z, y/z of the mask's pixels without depth"
    )
    over_table: bool = Field(
        False, description="The pose was made from the table and is unrelated to the robot"
    )

    def cloud(self) -> Cloud:
        """The view.

        Raises:
            InputError: Parts that do not fit each other.
        """
        pose = self.T_world_camera
        if pose is not None and not is_rigid(pose):
            raise InputError("T_world_camera is not a rigid transform", where=self.name)
        if (self.depth is None) != (self.K is None):
            raise InputError("a depth image without its K, or K alone", where=self.name)
        if self.K is not None and not (self.K[0, 0] > 0 and self.K[1, 1] > 0):
            raise InputError("focal lengths of K that are not above 0", where=self.name)
        for part in (self.pixels, self.mask):
            if part is not None and len(part) != len(self.points):
                raise InputError(
                    f"{len(part)} pixels or mask values for {len(self.points)} points",
                    where=self.name,
                    allowed="one for each",
                )
        image = (
            DepthImage(self.depth, self.K)
            if self.depth is not None and self.K is not None
            else None
        )
        if image is not None and self.pixels is not None and len(self.pixels):
            height, width = image.depth.shape
            if (self.pixels < -0.5).any() or (self.pixels >= np.array([width, height])).any():
                raise InputError("pixels lie outside of the depth image", where=self.name)
        mask = None if self.mask is None else self.mask != 0
        return Cloud(
            self.points,
            frame=self.frame,
            T_world_camera=pose,
            pixels=self.pixels,
            image=image,
            mask=mask,
            mask_rays=None if mask is None else self.mask_rays,
            over_table=self.over_table,
        )


class ObstacleBody(_Body):
    """A body that the robot may not touch."""

    name: str = Field(max_length=200)
    kind: Literal["box", "cylinder", "sphere", "mesh"]
    size: list[float] = Field(
        default_factory=list, max_length=3, description="box x y z, cylinder r h, sphere r [m]"
    )
    pose: _numbers(4, 4)  # type: ignore[valid-type]
    vertices: _numbers(None, 3) | None = None  # type: ignore[valid-type]
    faces: _numbers(None, 3) | None = None  # type: ignore[valid-type]

    def obstacle(self) -> Obstacle:
        """The body.

        Raises:
            InputError: Sizes or triangles that make no sense.
        """
        faces = None if self.faces is None else self.faces.astype(np.int32)
        corners = 0 if self.vertices is None else len(self.vertices)
        if faces is not None and faces.size and not 0 <= faces.min() <= faces.max() < corners:
            raise InputError("triangles refer to vertices that do not exist", where=self.name)
        if not is_rigid(self.pose):
            raise InputError("pose is not a rigid transform", where=self.name)
        return Obstacle(self.name, self.kind, tuple(self.size), self.pose, self.vertices, faces)


class EnvironmentBody(_Body):
    """Everything known but the robot and the object."""

    table: bool = True
    obstacles: list[ObstacleBody] = Field(default_factory=list, max_length=1000)


class Served(_Body):
    """Version, robot and weights that the client expects; those left out are not checked."""

    version: str | None = None
    robot: str | None = None
    checkpoint: str | None = None
    grasp_checkpoint: str | None = None


class SceneBody(_Body):
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
    workspace: _numbers(2, 3) | None = Field(None, description="Corners of what is looked at [m]")  # type: ignore[valid-type]
    start: _numbers(None) | None = Field(None, description="All joints [rad]; home if null")  # type: ignore[valid-type]
    clean: bool = True
    seed: int = Field(0, ge=0, lt=2**63)
    expects: Served = Field(default_factory=Served)

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
    margin: float = 0.004
    speed: float = 0.5
    rehearse: int = Field(0, le=100)
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

    q: _numbers(None, None) = Field(description="Grasps [G, J], rad, in the robot's joint order")  # type: ignore[valid-type]


class MeshBody(SceneBody):
    """A question for the whole shape of one object."""

    clouds: list[CloudBody] = Field(min_length=1, max_length=1)
    segment: Literal["auto", "none"] = "none"
    resolution: int = 128
    smooth: int = Field(25, ge=0, le=1000)
    all_parts: bool = False
    exact: bool = False


Body = TypeVar("Body", bound=SceneBody)


def read_body(kind: type[Body], data: bytes, content_type: str) -> Body:
    """A body of either form.

    Raises:
        InputError: Not of the form that its type says, or with parts that make no sense.
    """
    form = content_type.partition(";")[0].strip().lower()
    if form in ("", JSON):
        tree = tree_of_json(data, "body")
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


def schema_of(kind: type[_Body]) -> dict[str, Any]:
    """OpenAPI description of a body."""
    binary = {"type": "string", "format": "binary"}
    content = {JSON: {"schema": _schema(kind)}, NPZ: {"schema": binary}}
    return {"requestBody": {"required": True, "content": content}}


def parts_of(kind: type[_Body]) -> dict[str, Any]:
    """The schemas that the one of a body refers to, by name."""
    return dict(_schema(kind, parts=True))


def _schema(kind: type[_Body], parts: bool = False) -> dict[str, Any]:
    schema = kind.model_json_schema(ref_template="#/components/schemas/{model}")
    inner = schema.pop("$defs", {})
    return dict(inner if parts else schema)
