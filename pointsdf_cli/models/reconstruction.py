"""Reconstructed object in metres: the interface to the shape networks.

    shape = Reconstruction.from_cloud(load_model(), points, camera_position, R_frame_camera)
    s = shape.sdf(x)                        # [Q] metres, negative inside
    s, gradient = shape.sdf_and_gradient(x)

The cloud is encoded once; then every value is a pure function of x. Points and distances are in the
cloud's own frame and in metres; the network's frame is internal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.visibility import ViewEvidence
from pointsdf_cli.models.best_sampling import SAMPLINGS, best_sampling, float_tensor
from pointsdf_cli.models.processor import even_parts, fast_products, in_steps, map_in_parallel
from pointsdf_cli.models.shape_model import Encoding, ShapeModel
from pointsdf_cli.models.vessel_field import VesselField, vessel_in

CHUNK = 4096
"""Number of queries decoded at once: small enough for intermediate layers to stay in the cache."""
STEP, FINE_STEP = 128, 16
"""Queries are decoded in multiples of the first, few queries in multiples of the second: oneDNN
makes a kernel for each number of rows."""


@dataclass(frozen=True)
class Reconstruction:
    """See the module's docstring.

    Attributes:
        model: The network, in evaluation mode.
        encoding: Encoding of the cloud (batch of 1).
        centre: f8 [3], the network frame's origin in the cloud's frame, m.
        scale: Network units per metre.
        R_frame_camera: f8 [3, 3], the camera's axes in the cloud's frame.
        size: f8 [3], extents of the partial cloud along the camera's axes, m.
        low_precision: Type of the products in `sdf`, and the encoding for it; None for float32.
        vessel: Wall of a cup, bowl or mug in the cloud's frame, where the cloud shows one.
    """

    model: ShapeModel
    encoding: Encoding
    centre: NDArray[np.float64]
    scale: float
    R_frame_camera: NDArray[np.float64]
    size: NDArray[np.float64]
    low_precision: tuple[torch.dtype, Encoding] | None = None
    vessel: VesselField | None = None

    @classmethod
    def from_cloud(
        cls,
        model: ShapeModel,
        points: ArrayLike,
        camera_position: ArrayLike,
        R_frame_camera: ArrayLike | None = None,
        seed: int | Sequence[int] = 0,
        evidence: ViewEvidence | None = None,
        vessels: bool = True,
        tries: int = SAMPLINGS,
    ) -> Reconstruction:
        """Read one partial cloud.

        Args:
            model: A network; it is put into evaluation mode.
            points: [N, 3], m, in any frame; two places or more, resampled to the network's size.
            camera_position: [3], the camera's centre in that frame, m.
            R_frame_camera: [3, 3], the camera's axes (OpenCV: z forward, y down) in that frame;
                None if the frame already has the camera's axes.
            seed: Random seed of the points that are read.
            evidence: Observed space around the object, camera frame; ignored if None.
            vessels: Complete cups, bowls and mugs by their axis (`vessel_field.py`), if the
                architecture does.
            tries: Samplings of the points, of which the best is kept (`best_sampling.py`).

        Raises:
            InputError: The points are not a cloud, or the rotation is not one.
        """
        points = np.asarray(points, dtype=np.float64)
        position = np.asarray(camera_position, dtype=np.float64)
        rotation = np.eye(3) if R_frame_camera is None else np.asarray(R_frame_camera, float)
        _check(points, position, rotation)

        in_camera = (points - position) @ rotation
        model.eval()
        rng = np.random.default_rng(seed)
        known = evidence or ViewEvidence()
        frame, encoding = best_sampling(model, in_camera, known, tries, rng)
        centre, size = rotation @ frame.centre + position, np.ptp(in_camera, axis=0)
        shape = cls(model, encoding, centre, frame.scale, rotation, size)
        if not (vessels and model.completes_vessels):
            return shape
        plane = None if evidence is None else evidence.support_plane
        vessel = vessel_in(in_camera, plane, lambda x: shape.network_sdf(x @ rotation.T + position))
        return replace(shape, vessel=vessel and vessel.moved(rotation, position))

    @property
    def embedding(self) -> NDArray[np.float32]:
        """f4 [256], the shape embedding."""
        return self.encoding.embedding[0].cpu().numpy()

    def in_precision(self, precision: torch.dtype | None) -> Reconstruction:
        """The same with products of another type in `sdf`, such as bfloat16: values differ by a
        twentieth of a millimetre. None: this one."""
        if precision is None:
            return self
        reduced = self.model.in_precision(self.encoding, precision)
        return replace(self, low_precision=(precision, reduced))

    @property
    def in_fast_precision(self) -> Reconstruction:
        """The same in the processor's fastest precision."""
        return self.in_precision(fast_products(self.encoding.embedding.device))

    def sdf(self, x: ArrayLike, chunk: int = CHUNK) -> NDArray[np.float32]:
        """Signed distances, m.

        Args:
            x: [..., 3], m, in the cloud's frame.
            chunk: Queries at once; bounds the memory.

        Returns:
            f4 [...].
        """
        if self.vessel is None:
            return self.network_sdf(x, chunk)
        places = np.asarray(x, dtype=np.float64)
        values = self.vessel.sdf(places.reshape(-1, 3), partial(self.network_sdf, chunk=chunk))
        return values.astype(np.float32).reshape(places.shape[:-1])

    def sdf_and_gradient(
        self, x: ArrayLike, chunk: int = CHUNK
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Signed distances [...] m and their gradients [..., 3] at x [..., 3] m, in one pass."""
        if self.vessel is None:
            return self._network_sdf_and_gradient(x, chunk)
        places = np.asarray(x, dtype=np.float64)
        network = partial(self._network_sdf_and_gradient, chunk=chunk)
        values, gradients = self.vessel.sdf_and_gradient(places.reshape(-1, 3), network)
        distances = values.astype(np.float32).reshape(places.shape[:-1])
        return distances, gradients.astype(np.float32).reshape(places.shape)

    @torch.no_grad()
    def network_sdf(self, x: ArrayLike, chunk: int = CHUNK) -> NDArray[np.float32]:
        """The network's own signed distances; as `sdf`."""
        places = self._to_network(x)
        parts = even_parts(places, chunk)
        dtype, encoding = self.low_precision or (None, self.encoding)

        def values_of(part: Tensor) -> Tensor:
            step = STEP if len(part) > STEP // 2 else FINE_STEP
            return self.model.decode(encoding, in_steps(part, step)[None])[0, : len(part)]

        with torch.autocast(places.device.type, dtype, enabled=dtype is not None):
            values = map_in_parallel(values_of, parts)
        return self._distances(values, np.shape(x)[:-1])

    def _network_sdf_and_gradient(
        self, x: ArrayLike, chunk: int
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        def both(part: Tensor) -> Tensor:
            place = part[None].requires_grad_(True)
            with torch.enable_grad():
                value = self.model.decode(self.encoding, place)
                (gradient,) = torch.autograd.grad(value.sum(), place)
            return torch.cat([value[0].detach()[:, None], gradient[0]], dim=1)

        parts = map_in_parallel(both, even_parts(self._to_network(x), chunk))
        shape = np.shape(x)
        in_camera = torch.cat([part[:, 1:] for part in parts]).cpu().numpy()
        # Distances and coordinates scale alike, so the gradient is only rotated.
        turned = in_camera @ self.R_frame_camera.T
        values = self._distances([part[:, 0] for part in parts], shape[:-1])
        return values, turned.astype(np.float32).reshape(shape)

    def _to_network(self, x: ArrayLike) -> Tensor:
        places = np.asarray(x, dtype=np.float64).reshape(-1, 3)
        network = (places - self.centre) @ self.R_frame_camera * self.scale
        return float_tensor(network, self.encoding.embedding.device)

    def _distances(self, values: list[Tensor], shape: tuple[int, ...]) -> NDArray[np.float32]:
        metres = torch.cat(values).cpu().numpy() / np.float32(self.scale)
        return metres.astype(np.float32).reshape(shape)


def _check(
    points: NDArray[np.float64], position: NDArray[np.float64], rotation: NDArray[np.float64]
) -> None:
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"a cloud of shape {points.shape}", allowed="[N, 3]")
    if not np.isfinite(points).all():
        raise InputError("the cloud holds values that are not finite", allowed="finite coordinates")
    if position.shape != (3,) or not np.isfinite(position).all():
        raise InputError("the camera position is not three finite numbers", where="camera pose")
    is_rotation = rotation.shape == (3, 3) and np.allclose(
        rotation @ rotation.T, np.eye(3), atol=1e-4
    )
    if not is_rotation or np.linalg.det(rotation) < 0:
        raise InputError("the camera's axes are not a rotation matrix", where="camera pose")
