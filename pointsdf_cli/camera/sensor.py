"""Simulated depth sensors: the measurement of a real depth camera from the exact depth."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from pointsdf_cli.camera import sensor_effects as effects
from pointsdf_cli.camera.noise import REFERENCE_DEPTH, DepthNoise
from pointsdf_cli.camera.pinhole import Camera
from pointsdf_cli.errors import InputError

Image = NDArray[np.float32]

_VARIED = (
    *("displacement", "displacement_window", "registration", "registration_window"),
    *("fattening", "matching_window", "missing_at_edge", "missing_reach", "missing_patches"),
    *("missing_grazing", "flying", "quantisation", "axial_floor", "axial_depth", "axial_incidence"),
    *("disparity_noise", "noise_window", "bias", "bias_window"),
)
"""Errors that `varied` scales; geometry stays."""
_UNEVEN, _UNEVEN_WINDOW = 0.4, 4.0
"""σ of the logarithm of a strip's width, and the length over which it is correlated [px]."""


def _parameter(default: float, low: float, high: float) -> Any:
    """A field with its default and the range of its values."""
    return field(default=default, metadata={"range": (low, high)})


@dataclass(frozen=True)
class DepthSensor:
    """A depth camera's errors.

    Lengths in pixels are those of the sensor itself, at its focal length `focal`; they are scaled
    to the camera that is simulated. A parameter of 0 switches its effect off. Equations and
    sources: docs/method.md.

    Attributes:
        name: Its name in `sensor_presets.py`.
        noise: Gaussian noise of the ideal camera.
        focal: Focal length of the sensor's own images [px].
        baseline: Distance between imager and projector, or between both imagers [m].
        shadow_left, shadow_right: Baselines [m] of the shadows to the left and right of an object:
            distance of the projector or an imager to the right (shadow on the left) or to the left
            (shadow on the right) of the camera to which the depth image is registered.
        margin_left, margin_right: Width of the strip of the object beside such a shadow from which
            nothing returns [px]: the window in which patterns are matched reaches into the shadow.
        displacement: σ of the lateral displacement of edges [px].
        displacement_window: Length over which the displacement is correlated [px].
        registration: σ of the low-frequency displacement of whole objects [px].
        registration_window: Length over which it is correlated [px].
        fattening: Growth of near surfaces over far ones [px].
        matching_window: Side of the window in which disparities are matched, and so averaged [px].
        edge_slope: tan of the incidence beyond which two neighbouring pixels are a depth edge.
        missing_at_edge: Probability of no return at a depth edge.
        missing_reach: Distance from the edge at which it has fallen to 1/e [px].
        missing_patches: Share of surfaces without a return, in patches, like dark or shiny ones.
        patch_window: Length over which these are correlated [px].
        missing_grazing: Probability of no return at an incidence of 90°.
        missing_angle: Incidence from which returns are lost [rad].
        missing_window: Length over which missing returns are correlated [px].
        flying: Probability that a pixel at a depth edge measures a depth between both sides.
        quantisation: Step of the disparity [px].
        axial_floor, axial_depth, axial_incidence: Coefficients [m], [1/m], [m^1.5] of
            σ_z = floor + depth·(z − 0.4 m)² + incidence/√z·θ²/(π/2 − θ)².
        disparity_noise: σ of the disparity [px].
        noise_window: Length over which axial noise is correlated [px].
        bias: σ of the low-frequency error at 1 m [m]; grows with z².
        bias_window: Length over which it is correlated [px].

    Raises:
        InputError: A parameter is out of its range.
    """

    name: str
    noise: DepthNoise = field(default_factory=lambda: DepthNoise(0.0))
    focal: float = _parameter(575.0, 100.0, 10_000.0)
    baseline: float = _parameter(0.0, 0.0, 0.5)
    shadow_left: float = _parameter(0.0, 0.0, 0.5)
    shadow_right: float = _parameter(0.0, 0.0, 0.5)
    margin_left: float = _parameter(0.0, 0.0, 50.0)
    margin_right: float = _parameter(0.0, 0.0, 50.0)
    displacement: float = _parameter(0.0, 0.0, 10.0)
    displacement_window: float = _parameter(3.0, 0.5, 50.0)
    registration: float = _parameter(0.0, 0.0, 10.0)
    registration_window: float = _parameter(50.0, 10.0, 1000.0)
    fattening: float = _parameter(0.0, 0.0, 20.0)
    matching_window: float = _parameter(0.0, 0.0, 50.0)
    edge_slope: float = _parameter(6.0, 1.0, 100.0)
    missing_at_edge: float = _parameter(0.0, 0.0, 1.0)
    missing_reach: float = _parameter(2.0, 0.1, 50.0)
    missing_patches: float = _parameter(0.0, 0.0, 1.0)
    patch_window: float = _parameter(20.0, 0.5, 200.0)
    missing_grazing: float = _parameter(0.0, 0.0, 1.0)
    missing_angle: float = _parameter(1.0, 0.0, 1.57)
    missing_window: float = _parameter(2.0, 0.5, 50.0)
    flying: float = _parameter(0.0, 0.0, 1.0)
    quantisation: float = _parameter(0.0, 0.0, 2.0)
    axial_floor: float = _parameter(0.0, 0.0, 0.1)
    axial_depth: float = _parameter(0.0, 0.0, 0.1)
    axial_incidence: float = _parameter(0.0, 0.0, 0.01)
    disparity_noise: float = _parameter(0.0, 0.0, 5.0)
    noise_window: float = _parameter(1.0, 0.5, 50.0)
    bias: float = _parameter(0.0, 0.0, 0.1)
    bias_window: float = _parameter(100.0, 10.0, 1000.0)

    def __post_init__(self) -> None:
        for name, (low, high) in _RANGES.items():
            value = getattr(self, name)
            if not (math.isfinite(value) and low <= value <= high):
                what = f"{name} is {value}"
                raise InputError(what, where=f"sensor {self.name}", allowed=f"{low:g} to {high:g}")
        if self.baseline == 0 and (self.quantisation > 0 or self.disparity_noise > 0):
            raise InputError(
                "baseline is 0", where=f"sensor {self.name}", allowed="above 0 with disparities"
            )

    @property
    def is_ideal(self) -> bool:
        """Whether Gaussian noise is the only error; the others are 0 by default."""
        errors = (f.name for f in fields(self) if f.default == 0 and f.name != "baseline")
        return not any(getattr(self, name) for name in errors)

    def with_noise(self, noise: DepthNoise) -> DepthSensor:
        """The ideal camera with another noise; other sensors keep their own."""
        return replace(self, noise=noise) if self.is_ideal else self

    def varied(self, spread: float, rng: np.random.Generator) -> DepthSensor:
        """Sensor with each of these errors scaled at random: cameras of one kind differ, and no
        model is exact (Tobin et al. 2017, "Domain randomization").

        Args:
            spread: σ of the logarithm of each error's factor; 0 changes nothing.
            rng: Random generator of the factors.
        """
        if spread == 0 or self.is_ideal:
            return self
        factors = np.exp(spread * rng.standard_normal(len(_VARIED)))
        varied: dict[str, Any] = {
            name: float(np.clip(getattr(self, name) * factor, *_RANGES[name]))
            for name, factor in zip(_VARIED, factors, strict=True)
        }
        return replace(self, **varied)

    def deviation(self, depth: float) -> float:
        """σ [m] of the white noise of a surface seen face on at `depth` [m]."""
        gaussian = self.noise.sigma * (depth / REFERENCE_DEPTH) ** 2
        axial = self.axial_floor + self.axial_depth * (depth - 0.4) ** 2
        if not self.disparity_noise:
            return math.hypot(gaussian, axial)
        disparity = self.disparity_noise * depth**2 / (self.focal * self.baseline)
        return math.hypot(gaussian, axial, disparity)

    def as_dict(self) -> dict[str, Any]:
        """All parameters, for `config_json`."""
        known = {f.name: getattr(self, f.name) for f in fields(self)}
        return known | {"noise": self.noise.sigma}

    def observe(
        self,
        depth: Image,
        camera: Camera,
        rng: np.random.Generator,
        origin: tuple[int, int] = (0, 0),
        cos_incidence: Image | None = None,
    ) -> Image:
        """Measured depths of a scene.

        Args:
            depth: f4 [h, w], exact depths along z [m] in a window of the camera's image; 0 or inf
                for empty pixels.
            camera: Intrinsics of the whole image.
            rng: Random generator of the errors.
            origin: Column and row of the window's first pixel in the image.
            cos_incidence: f4 [h, w], cosine of the angle between ray and surface normal; None
                computes it from `depth`.

        Returns:
            f4 [h, w], measured depths along z [m]; 0 where nothing was returned.

        Raises:
            InputError: The arrays' shapes differ or have no pixels.
        """
        depth = np.asarray(depth, dtype=np.float32)
        if depth.ndim != 2 or depth.size == 0:
            raise InputError(f"a depth image of shape {depth.shape}", allowed="[h, w]")
        if cos_incidence is not None and np.shape(cos_incidence) != depth.shape:
            raise InputError(
                f"cosines of shape {np.shape(cos_incidence)} for depths of {depth.shape}"
            )
        if self.is_ideal:
            seen = (depth > 0) & np.isfinite(depth)
            measured = np.zeros_like(depth)
            measured[seen] = self.noise.apply(depth[seen], rng)
            return measured
        return self._measure(effects.inverse_depth(depth), cos_incidence, camera, origin, rng)

    def _measure(
        self,
        inverse: Image,
        cosine: Image | None,
        camera: Camera,
        origin: tuple[int, int],
        rng: np.random.Generator,
    ) -> Image:
        """Measured depths [m] of inverse depths [1/m]; the arguments of `observe`."""
        scale, jump = camera.fx / self.focal, self.edge_slope / camera.fx
        lit = inverse > 0
        lit &= ~self._shadows(inverse, camera.fx, rng)
        if self.fattening:
            inverse = effects.grown(inverse, self.fattening * scale, jump)
        slopes = effects.gradient(inverse)
        if cosine is None:
            cosine = effects.cos_incidence(inverse, slopes, camera, origin)
        if self.matching_window:
            inverse = effects.averaged(inverse, scale * self.matching_window / 2, jump)
            slopes = effects.gradient(inverse)
        incidence = effects.incidence_index(np.asarray(cosine, dtype=np.float32))
        if self.displacement or self.registration:
            shape = (2, *inverse.shape)
            fine = effects.smooth_noise(shape, scale * self.displacement_window, rng)
            coarse = effects.smooth_noise(shape, scale * self.registration_window, rng)
            fine *= np.float32(scale * self.displacement)
            coarse *= np.float32(scale * self.registration)
            inverse, at = effects.displaced(inverse, slopes, fine, coarse)
            incidence, lit = incidence.take(at), lit.take(at)
        edges = effects.depth_edges(inverse, jump)
        seen = lit & ~self._missing(edges, incidence, scale, rng)
        if self.flying:
            inverse = effects.flying_pixels(inverse, edges, self.flying, rng)
        return self._depths(inverse, incidence, seen, scale, rng)

    def _shadows(self, inverse: Image, focal: float, rng: np.random.Generator) -> NDArray[np.bool_]:
        """Shadows on both sides, and the strips beside them, for a focal length [px]."""
        scale = focal / self.focal
        found = np.zeros(inverse.shape, dtype=bool)
        for baseline, margin, side in (
            (self.shadow_left, self.margin_left, "left"),
            (self.shadow_right, self.margin_right, "right"),
        ):
            if not baseline:
                continue
            shadow = effects.shadow(inverse, baseline * focal, side)
            if margin:
                wave = effects.smooth_noise(inverse.shape, _UNEVEN_WINDOW * scale, rng)
                uneven = np.exp(np.float32(_UNEVEN) * wave)
                shadow = effects.widened(shadow, np.float32(margin * scale) * uneven, side)
            found |= shadow
        return found

    def _missing(
        self,
        edges: NDArray[np.bool_],
        incidence: NDArray[np.int32],
        scale: float,
        rng: np.random.Generator,
    ) -> NDArray[np.bool_]:
        """Pixels without a return, by distance from a depth edge and by incidence."""
        at_edge = self.missing_at_edge, self.missing_reach * scale
        limits = effects.missing_limits(*at_edge, self.missing_grazing, self.missing_angle)
        distance = effects.edge_distance(edges, len(limits) - 1).astype(np.int32)
        distance *= np.int32(limits.shape[1])
        distance += incidence
        drawn = effects.smooth_noise(edges.shape, self.missing_window * scale, rng)
        missing = drawn < limits.ravel().take(distance)
        if self.missing_patches:
            drawn = effects.smooth_noise(edges.shape, self.patch_window * scale, rng)
            missing |= drawn < np.float32(scipy.special.ndtri(self.missing_patches))
        return missing

    def _depths(
        self,
        inverse: Image,
        incidence: NDArray[np.int32],
        seen: NDArray[np.bool_],
        scale: float,
        rng: np.random.Generator,
    ) -> Image:
        """Depths [m] with axial noise, bias and quantised disparity; 0 where not `seen`."""
        depth = np.reciprocal(np.maximum(inverse, np.float32(1e-3)))
        white = effects.smooth_noise(inverse.shape, self.noise_window * scale, rng)
        deviation = effects.nguyen_deviation(
            depth, incidence, self.axial_floor, self.axial_depth, self.axial_incidence
        )
        factor = self.focal * self.baseline
        squared = depth * depth
        if self.disparity_noise:
            of_disparity = squared * np.float32(self.disparity_noise / factor)
            deviation = np.sqrt(deviation * deviation + of_disparity * of_disparity)
        depth = depth + deviation * white
        if self.bias:
            wave = effects.smooth_noise(inverse.shape, self.bias_window * scale, rng)
            depth += squared * (np.float32(self.bias) * wave)
        if self.noise.sigma:
            depth = self.noise.apply(depth, rng)
        if self.quantisation:
            depth = effects.quantised(depth, factor, self.quantisation)
        return np.where(seen & (depth > 0), depth, np.float32(0))


_RANGES = {f.name: f.metadata["range"] for f in fields(DepthSensor) if f.metadata}
