"""Parts of requests' bodies: arrays, views of a scene, and obstacles."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, WithJsonSchema

from pointsdf_cli.errors import InputError, require_near
from pointsdf_cli.geometry.frames import is_rigid
from pointsdf_cli.io.clouds import Cloud, DepthImage
from pointsdf_cli.io.meshes import closed_body
from pointsdf_cli.io.poses import FARTHEST
from pointsdf_cli.planning.environment import Obstacle


def numbers(*shape: int | None) -> Any:
    """Finite numbers as an array of a shape, in which None is any length."""
    text = ", ".join("N" if side is None else str(side) for side in shape)

    def check(value: Any) -> NDArray[np.float64]:
        try:
            _require_numbers(value, len(shape))
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


def _require_numbers(value: Any, depth: int) -> None:
    """Refuse what is no number, `depth` lists down: NumPy would make text and lists of arrays many
    times larger than they were sent.

    Raises:
        ValueError: It is not such numbers.
    """
    if isinstance(value, np.ndarray):
        return
    if not isinstance(value, list):
        if not isinstance(value, int | float):
            raise ValueError
    elif depth == 0 or not all(isinstance(one, int | float | list) for one in value):
        raise ValueError
    else:
        for one in value:
            if isinstance(one, list):
                _require_numbers(one, depth - 1)


class Body(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class CloudBody(Body):
    """One view of the scene, in metres."""

    points: numbers(None, 3) = Field(description="[N, 3] m, in `frame`")  # type: ignore[valid-type]
    frame: Literal["camera", "world"] = "camera"
    T_world_camera: numbers(4, 4) | None = None  # type: ignore[valid-type]
    name: str = Field("cloud", max_length=4096, description="For messages")
    pixels: numbers(None, 2) | None = None  # type: ignore[valid-type]
    depth: numbers(None, None) | None = None  # type: ignore[valid-type]
    K: numbers(3, 3) | None = None  # type: ignore[valid-type]
    mask: numbers(None) | None = None  # type: ignore[valid-type]
    mask_rays: numbers(None, 2) | None = Field(  # type: ignore[valid-type]
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
        if pose is not None:
            away = float(np.linalg.norm(pose[:3, 3]))
            require_near(away, FARTHEST, "the camera is", f"T_world_camera of {self.name}")
        if (self.depth is None) != (self.K is None):
            raise InputError("a depth image without its K, or K alone", where=self.name)
        if self.K is not None and not (self.K[0, 0] > 0 and self.K[1, 1] > 0):
            raise InputError("focal lengths of K that are not above 0", where=self.name)
        for part in (self.pixels, self.mask):
            if part is not None and len(part) != len(self.points):
                what = f"{len(part)} pixels or mask values for {len(self.points)} points"
                raise InputError(what, where=self.name, allowed="one for each")
        image = None
        if self.depth is not None and self.K is not None:
            image = DepthImage(self.depth, self.K)
        if image is not None and self.pixels is not None and len(self.pixels):
            height, width = image.depth.shape
            if (self.pixels < -0.5).any() or (self.pixels >= np.array([width, height])).any():
                raise InputError("pixels lie outside of the depth image", where=self.name)
        mask = None if self.mask is None else self.mask != 0
        if mask is not None and not mask.any():
            raise InputError("the mask is 0 everywhere", where=self.name)
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


class ObstacleBody(Body):
    """A body that the robot may not touch."""

    name: str = Field(max_length=200)
    kind: Literal["box", "cylinder", "sphere", "mesh"]
    size: list[float] = Field(
        default_factory=list, max_length=3, description="box x y z, cylinder r h, sphere r [m]"
    )
    pose: numbers(4, 4)  # type: ignore[valid-type]
    vertices: numbers(None, 3) | None = None  # type: ignore[valid-type]
    faces: numbers(None, 3) | None = None  # type: ignore[valid-type]

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
        vertices = self.vertices
        if vertices is not None and faces is not None:
            # Collision libraries end the process on a flat mesh.
            vertices, faces = closed_body(vertices, faces, self.name)
        return Obstacle(self.name, self.kind, tuple(self.size), self.pose, vertices, faces)


class EnvironmentBody(Body):
    """Everything known but the robot and the object."""

    table: bool = True
    obstacles: list[ObstacleBody] = Field(default_factory=list, max_length=1000)
