"""Views of one object over a table, as measured by a depth camera and segmented with errors.

Each view: a random scene (`table_scene.py`), what a sensor measures of it (`sensor.py`), what a
segmentation takes for the object (`seen_object.py`), and what cleaning keeps of that, as at run
time. The cloud, the free space around it and the support plane are stored.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import trimesh
from numpy.typing import NDArray

from pointsdf_cli.camera.cleaning import clean
from pointsdf_cli.camera.pinhole import Camera
from pointsdf_cli.camera.raycast import MeshCaster
from pointsdf_cli.camera.seen_object import SeenObject, SegmentationErrors, segment_scene
from pointsdf_cli.camera.sensor import DepthSensor
from pointsdf_cli.camera.sensor_presets import SENSORS, load_sensor
from pointsdf_cli.camera.table_scene import OBJECT, RenderedScene, SceneConfig, draw_scene
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.stable_poses import StablePose, stable_poses
from pointsdf_cli.geometry.visibility import ViewEvidence
from pointsdf_cli.io.meshes import LoadedMesh

FEWEST_POINTS = 60
"""A view of fewer points of the object is drawn again."""
MOST_HIDDEN = 0.5
"""A view in which more of the object's pixels are hidden is drawn again."""
DRAWS = 30
DARK = (0.05, 0.5)
"""Shares of a dark or shiny thing's pixels without a return; a black marker loses 40%."""
DARK_PATCH = (5.0, 30.0)
"""Lengths over which these are correlated [px of the sensor]."""
STEEP, STEEP_FROM = (0.5, 1.0), (0.6, 1.2)
"""Half of the dark or shiny things lose what is seen steeply instead: share of pixels without a
return at an incidence of 90°, and the incidence [rad] from which returns are lost."""
STRIP = 1.5
"""Mean width of the strips beside a shadow from which nothing returns [px of the sensor]. A mustard
bottle before a far table loses one of 6 px on one side and none on the other."""
STRIP_EDGES = 0.3
"""Factor of `missing_at_edge` in views with such strips: they lose edges already."""
NO_ERRORS = SegmentationErrors(
    masked=1.0, offset=(0.0, 0.0), uneven=0.0, ragged=0.0, height=0.0, tilt=0.0, cut=0.0, holed=0.0
)


@dataclass(frozen=True)
class SceneViewConfig:
    """Settings of a view.

    Attributes:
        sensors: Names in `SENSORS`; each view is measured by one of them.
        scene: Placement of the objects.
        errors: Errors of the segmentation.
        exact: Share of exact views: ideal sensor, object alone, exact mask. They teach shapes; the
            others teach the errors.
        exact_resting: Share of these in which the object rests on a table; in the others it is
            turned at random.
        sensor_spread: Spread of the errors of each view's sensor (`DepthSensor.varied`).
        dark: Share of the other views whose surfaces return little, as dark or shiny ones do.
        strips: Share of the other views in which nothing returns from strips beside shadows.

    Raises:
        InputError: No sensor, or one that does not exist.
    """

    sensors: tuple[str, ...] = ("structured-light", "stereo")
    scene: SceneConfig = field(default_factory=SceneConfig)
    errors: SegmentationErrors = field(default_factory=SegmentationErrors)
    exact: float = 0.0
    exact_resting: float = 0.6
    sensor_spread: float = 0.0
    dark: float = 0.0
    strips: float = 0.0

    def __post_init__(self) -> None:
        for name in ("exact", "dark", "strips"):
            if not 0 <= getattr(self, name) <= 1:
                raise InputError(
                    f"{getattr(self, name)} is no share", where=f"--{name}", allowed="0 to 1"
                )
        if not 0 <= self.sensor_spread <= 2:
            raise InputError(f"sensor_spread = {self.sensor_spread}", allowed="0 to 2")
        if not self.sensors:
            raise InputError("no sensor", where="--sensor", allowed=", ".join(SENSORS))
        for name in self.sensors:
            load_sensor(name)


@dataclass(frozen=True)
class SceneView:
    """One view.

    Attributes:
        points: [N, 3], the object's points, camera frame, m.
        T_camera_object: [4, 4].
        evidence: Observed space around it.
    """

    points: NDArray[np.float64]
    T_camera_object: NDArray[np.float64]
    evidence: ViewEvidence


class SceneViews:
    """Draws views of one mesh.

    Args:
        mesh: The object.
        camera: Intrinsics.
        config: Settings of the views.
    """

    def __init__(
        self, mesh: LoadedMesh, camera: Camera, config: SceneViewConfig | None = None
    ) -> None:
        self._camera, self._config = camera, config or SceneViewConfig()
        self._sensors = [load_sensor(name) for name in self._config.sensors]
        scene = self._config.scene
        self._alone = replace(scene, neighbours=0, resting=self._config.exact_resting)
        self._vertices = mesh.vertices
        self._caster = MeshCaster(mesh.vertices, mesh.faces, camera)
        self._poses = _resting(mesh)

    def draw(self, rng: np.random.Generator) -> tuple[SceneView, int]:
        """A view, and the number of rejected draws before it.

        Raises:
            InputError: The object is never seen well enough.
        """
        config, camera = self._config, self._camera
        exact = rng.random() < config.exact
        content = self._alone if exact else config.scene
        errors = NO_ERRORS if exact else config.errors
        for rejected in range(DRAWS):
            scene = draw_scene(self._caster, self._vertices, self._poses, camera, content, rng)
            if _hidden(scene) > MOST_HIDDEN:
                continue
            drawn = self._sensors[rng.integers(len(self._sensors))]
            sensor = load_sensor("ideal") if exact else sensor_of_view(drawn, config, rng)
            window = scene.window
            measured = sensor.observe(window.depth, camera, rng, window.origin, window.cosine)
            seen = segment_scene(scene, measured, camera, errors, rng)
            if len(seen.points) < FEWEST_POINTS:
                continue
            kept = clean(seen.points).kept
            if kept.sum() < FEWEST_POINTS:
                continue
            # Points that cleaning drops lie between surfaces: their pixels count as unknown.
            seen = SeenObject(seen.points[kept], seen.others, seen.support_plane, seen.rays)
            view = SceneView(seen.points, scene.T_camera_object, seen.evidence(1.0 / camera.fx))
            return view, rejected
        what = f"{DRAWS} scenes showed fewer than {FEWEST_POINTS} points of it"
        raise InputError(what, hint="check its size and unit, or choose another --camera")


def sensor_of_view(
    sensor: DepthSensor, config: SceneViewConfig, rng: np.random.Generator
) -> DepthSensor:
    """The sensor with one view's errors; an ideal one has none."""
    varied = sensor.varied(config.sensor_spread, rng)
    if varied.is_ideal:
        return varied
    if config.strips and rng.random() < config.strips:
        left, right = rng.exponential(STRIP, 2)
        at_edge = STRIP_EDGES * varied.missing_at_edge
        varied = replace(varied, margin_left=left, margin_right=right, missing_at_edge=at_edge)
    if not config.dark or rng.random() >= config.dark:
        return varied
    if rng.random() < 0.5:
        steep, angle = rng.uniform(*STEEP), rng.uniform(*STEEP_FROM)
        return replace(varied, missing_grazing=steep, missing_angle=angle)
    share, window = rng.uniform(*DARK), rng.uniform(*DARK_PATCH)
    return replace(varied, missing_patches=share, patch_window=window)


def _hidden(scene: RenderedScene) -> float:
    """Share of the object's pixels that something else hides."""
    total = int(scene.object_alone.sum())
    return 1.0 if total == 0 else 1.0 - int((scene.label == OBJECT).sum()) / total


def _resting(mesh: LoadedMesh) -> list[StablePose]:
    """Resting poses; none for a mesh whose centre of mass is not known."""
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    if not np.isfinite(solid.volume) or solid.volume <= 1e-9:
        return []
    try:
        return stable_poses(mesh.vertices, np.asarray(solid.center_mass))
    except InputError:
        return []
