"""Depth sensors: each effect alone against geometry computed by hand."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import REPOSITORY, run_cli

from pointsdf_cli.camera import sensor_effects as effects
from pointsdf_cli.camera.noise import DepthNoise
from pointsdf_cli.camera.pinhole import CAMERAS, Camera
from pointsdf_cli.camera.sensor import DepthSensor
from pointsdf_cli.camera.sensor_presets import SENSORS, load_sensor
from pointsdf_cli.errors import InputError
from pointsdf_cli.io.meshes import LoadedMesh
from pointsdf_cli.objects.generate import make_object

CAMERA = Camera(320, 240, 575.0, 575.0, 159.5, 119.5)
"""As fine as the sensors of these tests: their pixels are its pixels."""
NAMES = ("ideal", "structured-light", "stereo")


def flat(depth: float) -> np.ndarray:
    return np.full((CAMERA.height, CAMERA.width), depth, dtype=np.float32)


def step(near: float = 1.0, far: float = 1.5) -> np.ndarray:
    """A near strip in columns 100 to 199 before a far wall."""
    depth = flat(far)
    depth[:, 100:200] = near
    return depth


def slanted(degrees: float, depth: float = 1.0) -> np.ndarray:
    """A plane that meets the optical axis at `depth` and whose normal is turned about y."""
    slope = math.tan(math.radians(degrees))
    x = (np.arange(CAMERA.width) - CAMERA.cx) / CAMERA.fx
    row = (depth / (1 - slope * x)).astype(np.float32)
    row[row <= 0] = 0
    return np.broadcast_to(row, (CAMERA.height, CAMERA.width)).copy()


def observe(sensor: DepthSensor, depth: np.ndarray, seed: int = 0) -> np.ndarray:
    return sensor.observe(depth, CAMERA, np.random.default_rng(seed))


def test_the_presets_are_those_that_help_names() -> None:
    assert tuple(SENSORS) == NAMES
    for command in ("render", "collect-grasps", "trial"):
        assert "ideal|structured-light|stereo" in run_cli(command, "--help").out
    with pytest.raises(InputError) as refused:
        load_sensor("kinect")
    assert all(name in str(refused.value.allowed) for name in NAMES)


@pytest.mark.parametrize(
    ("name", "value"),
    [("focal", 0.0), ("missing_at_edge", 1.1), ("displacement", -1.0), ("bias", math.nan)],
)
def test_parameters_out_of_range_are_refused(name: str, value: float) -> None:
    with pytest.raises(InputError, match=name):
        DepthSensor("odd", **{name: value})


def test_disparities_need_a_baseline() -> None:
    with pytest.raises(InputError, match="baseline"):
        DepthSensor("odd", quantisation=0.125)


def test_the_ideal_sensor_adds_the_noise_of_the_paper_and_nothing_else() -> None:
    depth = step()
    depth[:50] = 0
    depth[50:60] = np.inf
    seen = np.isfinite(depth) & (depth > 0)
    expected = DepthNoise().apply(depth[seen], np.random.default_rng(3))
    measured = observe(load_sensor("ideal"), depth, 3)
    np.testing.assert_array_equal(measured[seen], expected)
    assert (measured[~seen] == 0).all()


@pytest.mark.parametrize("name", NAMES)
def test_the_same_seed_gives_the_same_image_and_the_scene_is_left_alone(name: str) -> None:
    depth = step()
    kept = depth.copy()
    first = observe(load_sensor(name), depth, 1)
    np.testing.assert_array_equal(first, observe(load_sensor(name), depth, 1))
    assert (first != observe(load_sensor(name), depth, 2)).any()
    np.testing.assert_array_equal(depth, kept)
    assert first.dtype == np.float32


@pytest.mark.parametrize("name", NAMES)
def test_nothing_returns_from_nothing(name: str) -> None:
    assert not observe(load_sensor(name), flat(0)).any()
    assert not observe(load_sensor(name), flat(np.inf)).any()
    one = np.ones((1, 1), dtype=np.float32)  # the smallest window
    assert load_sensor(name).observe(one, CAMERA, np.random.default_rng(0)).shape == (1, 1)


@pytest.mark.parametrize("name", NAMES)
def test_the_middle_of_a_wall_that_faces_the_camera_is_measured_everywhere(name: str) -> None:
    # Dark or shiny patches are of the surface, not of the geometry.
    sensor = replace(load_sensor(name), missing_patches=0.0)
    measured = observe(sensor, flat(1.0))
    assert (measured > 0).all()
    sigma = math.hypot(sensor.deviation(1.0), sensor.bias)
    assert np.abs(measured - 1).max() < 5.5 * sigma < 0.025


def test_disparity_is_quantised_in_steps_of_its_own() -> None:
    # Δz = z²·q/(f·b) = 1·0.125/(575·0.075) = 2.9 mm at 1 m.
    sensor = DepthSensor("quantised", baseline=0.075, quantisation=0.125)
    found = np.unique(observe(sensor, slanted(30)))
    middle = (found > 0.99) & (found < 1.01)
    np.testing.assert_allclose(np.diff(found[middle]), 0.125 / (575 * 0.075), rtol=0.02)
    disparity = 575 * 0.075 / found / 0.125
    np.testing.assert_allclose(disparity, np.rint(disparity), atol=1e-3)


@pytest.mark.parametrize(("side", "edge"), [("right", 200), ("left", 100)])
def test_a_shadow_is_as_wide_as_the_disparities_differ(side: str, edge: int) -> None:
    # b·f·(1/1.0 − 1/1.5) = 0.075·575/3 = 14.4 px of the wall beside the strip.
    sensor = DepthSensor("shadow", **{f"shadow_{side}": 0.075})
    dark = np.flatnonzero((observe(sensor, step()) == 0).all(axis=0))
    assert abs(len(dark) - 14.4) < 1
    beside = dark[0] == edge if side == "right" else dark[-1] == edge - 1
    assert beside
    assert np.ptp(dark) == len(dark) - 1
    # A wall alone throws no shadow, however slanted.
    assert (observe(sensor, slanted(40)) > 0).all()


@pytest.mark.parametrize(("side", "edge"), [("right", 200), ("left", 100)])
def test_a_strip_beside_a_shadow_is_lost(side: str, edge: int) -> None:
    shadow = DepthSensor("shadow", **{f"shadow_{side}": 0.075})
    strip = replace(shadow, **{f"margin_{side}": 8.0})
    lost = (observe(strip, step()) == 0) & (observe(shadow, step()) > 0)
    near = slice(100, 200)  # the columns of the near strip, which throws the shadow
    assert not lost[:, :100].any()
    assert not lost[:, 200:].any()
    widths = lost[:, near].sum(axis=1)
    # The logarithm of a strip's width has σ = 0.4 and mean ln 8.
    assert np.log(np.maximum(widths, 1)).mean() == pytest.approx(math.log(8), abs=0.15)
    assert 0.2 < np.log(np.maximum(widths, 1)).std() < 0.6
    outermost = lost[:, edge - 1 if side == "right" else edge]
    assert outermost[widths > 0].all()
    # The other side, and a strip beside no shadow, lose nothing.
    other = "left" if side == "right" else "right"
    same = observe(replace(shadow, **{f"margin_{other}": 8.0}), step())
    np.testing.assert_array_equal(same, observe(shadow, step()))


def test_edges_are_displaced_by_the_stated_deviation_and_planes_are_not() -> None:
    sensor = DepthSensor("displaced", displacement=1.5, displacement_window=4.0)
    measured = np.concatenate([observe(sensor, step(), seed) for seed in range(20)])
    near = (measured[:, 50:150] < 1.2).sum(axis=1)  # columns of the strip left of its middle
    assert near.mean() == pytest.approx(50, abs=0.3)
    assert near.std() == pytest.approx(1.5, abs=0.35)
    plane = slanted(50)
    inside = np.s_[8:-8, 8:-8]
    np.testing.assert_allclose(observe(sensor, plane)[inside], plane[inside], rtol=2e-3)


def test_displacement_is_scaled_to_the_camera() -> None:
    sensor = DepthSensor("displaced", displacement=1.0, displacement_window=4.0)
    double = Camera(320, 240, 1150.0, 1150.0, 159.5, 119.5)
    measured = [sensor.observe(step(), double, np.random.default_rng(seed)) for seed in range(20)]
    near = (np.concatenate(measured)[:, 50:150] < 1.2).sum(axis=1)
    assert near.std() == pytest.approx(2.0, abs=0.5)


def test_a_misregistration_moves_whole_objects() -> None:
    sensor = DepthSensor("shifted", registration=2.0, registration_window=1000.0)
    near = np.array([(observe(sensor, step(), seed)[:, 50:150] < 1.2) for seed in range(60)])
    counts = near.sum(axis=2)
    assert np.ptp(counts, axis=1).max() <= 2  # the edge stays a straight line
    assert counts[:, 120].std() == pytest.approx(2.0, abs=0.6)


def test_returns_are_missing_at_edges_as_often_as_stated() -> None:
    sensor = DepthSensor("edges", missing_at_edge=0.6, missing_reach=2.0)
    missing = np.mean([observe(sensor, step(), seed) == 0 for seed in range(10)], axis=(0, 1))
    assert missing[[99, 100, 199, 200]] == pytest.approx(0.6, abs=0.05)
    # Two pixels from the edge: 0.6·exp(−1).
    assert missing[[97, 102]] == pytest.approx(0.6 / math.e, abs=0.05)
    assert missing[[80, 120, 180, 220]].max() == 0


def test_returns_are_missing_at_grazing_incidence() -> None:
    sensor = DepthSensor("grazing", missing_grazing=1.0, missing_angle=math.radians(60))
    facing = observe(sensor, slanted(40))
    assert (facing[:, 140:180] > 0).all()
    steep = observe(sensor, slanted(75))
    # Halfway from 60° to 90°, on the optical axis.
    assert (steep[:, 158:162] == 0).mean() == pytest.approx(0.5, abs=0.15)


def test_patches_return_nothing_as_often_as_stated() -> None:
    sensor = DepthSensor("patches", missing_patches=0.1, patch_window=5.0)
    share = np.mean([(observe(sensor, flat(1.0), seed) == 0).mean() for seed in range(10)])
    assert share == pytest.approx(0.1, abs=0.02)


def test_flying_pixels_lie_between_both_sides_of_an_edge() -> None:
    measured = observe(DepthSensor("flying", flying=0.5), step())
    edge = np.isin(np.arange(CAMERA.width), (99, 100, 199, 200))
    np.testing.assert_array_equal(measured[:, ~edge], step()[:, ~edge])
    between = (measured[:, edge] > 1.001) & (measured[:, edge] < 1.499)
    assert between.mean() == pytest.approx(0.5, abs=0.05)
    assert measured.min() >= 0.999
    assert measured.max() <= 1.501


def test_near_surfaces_grow_over_far_ones_and_slants_stay() -> None:
    sensor = DepthSensor("fat", fattening=2.0)
    measured = observe(sensor, step())
    assert (measured[10:-10, 98:202] < 1.01).all()
    assert (measured[:, :98] > 1.49).all()
    np.testing.assert_allclose(observe(sensor, slanted(50)), slanted(50), rtol=1e-5)


def test_a_matching_window_flattens_round_surfaces_at_their_silhouette() -> None:
    # A cylinder of radius 50 px, 100 px high, before a far wall: w = w0 + h·√(1 − (x/50)²).
    x = np.arange(CAMERA.width) - 160.0
    inside = np.abs(x) < 50
    row = np.where(inside, 1.0 + 0.05 * np.sqrt(np.clip(1 - (x / 50) ** 2, 0, 1)), 0.5)
    inverse = np.broadcast_to(row.astype(np.float32), (100, CAMERA.width)).copy()
    found = effects.averaged(inverse, 4.0, 0.02)
    # In the middle only the curvature counts; at the rim the 4 pixels of the near side alone.
    assert found[50, 160] == pytest.approx(row[156:165].mean(), abs=1e-6)
    rim = 160 + 49
    assert found[50, rim] == pytest.approx(row[rim - 4 : rim + 1].mean(), abs=1e-6)
    assert found[50, rim] > row[rim] + 0.005
    np.testing.assert_allclose(found[:, ~inside], 0.5, atol=1e-6)


def test_a_matching_window_keeps_planes_and_steps() -> None:
    sensor = DepthSensor("window", matching_window=9.0)
    np.testing.assert_allclose(observe(sensor, step()), step(), rtol=1e-6)
    interior = np.s_[:, 10:-10]
    np.testing.assert_allclose(
        observe(sensor, slanted(50))[interior], slanted(50)[interior], rtol=1e-5
    )


def test_axial_noise_follows_nguyen_by_depth_and_incidence() -> None:
    sensor = DepthSensor("axial", axial_floor=0.0012, axial_depth=0.0019, axial_incidence=0.0001)
    # Face on: 1.2 + 1.9·(1.4 − 0.4)² = 3.1 mm.
    facing = observe(sensor, flat(1.4))[:, 150:170]
    assert (facing - 1.4).std() == pytest.approx(0.0031, rel=0.05)
    # At θ = 60° and 1 m: 1.2 + 1.9·0.36 + 0.1·(θ/(π/2 − θ))² = 1.884 + 0.4 mm.
    steep = (observe(sensor, slanted(60)) - slanted(60))[:, 155:165]
    assert steep.std() == pytest.approx(0.002284, rel=0.06)


def test_stereo_noise_grows_with_the_square_of_the_depth() -> None:
    # σ_z = z²·σ_d/(f·b): 2.6 mm at 1 m, 10.4 mm at 2 m.
    sensor = DepthSensor("stereo", focal=615.0, baseline=0.05, disparity_noise=0.08)
    for depth in (1.0, 2.0):
        expected = depth**2 * 0.08 / (615 * 0.05)
        assert observe(sensor, flat(depth)).std() == pytest.approx(expected, rel=0.05)
        assert sensor.deviation(depth) == pytest.approx(expected)


def test_the_bias_is_the_same_over_an_object_and_differs_between_images() -> None:
    sensor = DepthSensor("biased", bias=0.002, bias_window=200.0)
    errors = np.array([observe(sensor, flat(1.0), seed) - 1 for seed in range(60)])
    window = errors[:, 100:120, 140:160]
    assert window.mean(axis=(1, 2)).std() == pytest.approx(0.002, rel=0.35)
    assert window.std(axis=(1, 2)).max() < 0.0006


def test_the_incidence_of_a_plane_is_found_in_any_window() -> None:
    rows, columns = np.arange(40, 90), np.arange(100, 230)
    plane = slanted(50)[np.ix_(rows, columns)]
    inverse = effects.inverse_depth(plane)
    cosine = effects.cos_incidence(inverse, effects.gradient(inverse), CAMERA, (100, 40))
    x, y = np.meshgrid((columns - CAMERA.cx) / CAMERA.fx, (rows - CAMERA.cy) / CAMERA.fy)
    slope = math.tan(math.radians(50))
    normal = np.array([-slope, 0, 1]) / math.hypot(slope, 1)
    rays = np.stack([x, y, np.ones_like(x)], axis=-1)
    by_hand = np.abs(rays @ normal) / np.linalg.norm(rays, axis=-1)
    np.testing.assert_allclose(cosine, by_hand, atol=2e-3)


def test_smooth_noise_has_unit_variance_everywhere_and_is_correlated() -> None:
    drawn = effects.smooth_noise((4000, 20, 30), 4.0, np.random.default_rng(0))
    assert drawn.std(axis=0) == pytest.approx(np.ones((20, 30)), abs=0.06)
    next_one = (drawn[:, :, 1:] * drawn[:, :, :-1]).mean()
    far = (drawn[:, :, 20:] * drawn[:, :, :-20]).mean()
    assert next_one > 0.9
    assert abs(far) < 0.03


def test_a_varied_sensor_has_other_errors_of_the_same_kinds() -> None:
    preset, rng = load_sensor("structured-light"), np.random.default_rng(0)
    ratios = []
    for _ in range(400):
        varied = preset.varied(0.5, rng)
        assert (varied.focal, varied.baseline) == (preset.focal, preset.baseline)
        assert varied.fattening == 0.0  # an error that this kind of sensor does not have
        ratios.append(varied.axial_floor / preset.axial_floor)
    assert np.std(np.log(ratios)) == pytest.approx(0.5, abs=0.06)
    assert preset.varied(0.0, rng) == preset
    assert load_sensor("ideal").varied(0.5, rng) == load_sensor("ideal")
    once, again = (preset.varied(0.5, np.random.default_rng(1)) for _ in range(2))
    assert once == again != preset


def test_arrays_of_other_shapes_are_refused() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match="shape"):
        load_sensor("stereo").observe(np.ones(5, np.float32), CAMERA, rng)
    with pytest.raises(InputError, match="cosines"):
        load_sensor("stereo").observe(flat(1.0), CAMERA, rng, (0, 0), np.ones((2, 2), np.float32))


@pytest.fixture(scope="module")
def household() -> list[LoadedMesh]:
    """TableObjects of the sizes and shapes of those that the bins were measured on."""
    families = ("box", "can", "bottle", "mug", "bowl", "banana")
    known = [name for name in families if _exists(name)]
    made = [make_object(5, k, [name]) for k, name in enumerate(known * 2)]
    return [LoadedMesh(m.name, m.vertices, m.faces.astype(np.int32), "0", "none") for m in made]


def _exists(family: str) -> bool:
    try:
        make_object(0, 0, [family])
    except InputError:
        return False
    return True


def test_structured_light_errs_as_often_as_a_real_camera(household: list[LoadedMesh]) -> None:
    """The bins of seven YCB-Video frames (docs/method.md), on generated objects."""
    sys.path.insert(0, str(REPOSITORY / "benchmarks"))  # the benchmark counts the same way
    try:
        import sensor_scenes as scenes
    finally:
        sys.path.pop(0)
    rng = np.random.default_rng(0)
    tables = [scenes.clutter(household, rng) for _ in range(8)]
    counts = scenes.count_errors(load_sensor("structured-light"), tables)
    for name, measured in scenes.MEASURED.items():
        np.testing.assert_allclose(counts.shares(name), measured, atol=0.1, err_msg=name)
    np.testing.assert_allclose(counts.missing(), scenes.MEASURED_MISSING_BY_ANGLE, atol=0.12)
    ratio = counts.sigma() / scenes.MEASURED_SIGMA_BY_ANGLE
    assert 0.5 < ratio.min() <= ratio.max() < 2
    # An ideal camera is far from all of it.
    ideal = scenes.count_errors(load_sensor("ideal"), tables[:2])
    assert ideal.missing().max() == 0


def test_render_records_its_sensor_and_ideal_is_the_default(
    mesh_folder: Path, tmp_path: Path
) -> None:
    from pointsdf_cli.io.hdf5 import open_hdf5

    def render(out: str, *options: object) -> tuple[np.ndarray, dict[str, object]]:
        command = ("render", "--views", 3, "--jobs", 1, "-q", "--meshes", mesh_folder)
        assert run_cli(*command, "--out", tmp_path / out, *options).code == 0
        with open_hdf5(tmp_path / out / "box.h5") as file:
            return file["cloud"][()], json.loads(file.attrs["config_json"])

    default, config = render("default")
    assert config["sensor"] == SENSORS["ideal"].as_dict()
    np.testing.assert_array_equal(render("ideal", "--sensor", "ideal")[0], default)
    cloud, config = render("stereo", "--sensor", "stereo")
    assert config["sensor"] == SENSORS["stereo"].as_dict()
    assert (cloud != default).any()
    # Depths of a box of 10 cm at 1.5 m.
    assert np.abs(np.median(cloud[..., 2]) - 1.5) < 0.06


@pytest.mark.parametrize("command", ["render", "collect-grasps", "trial"])
def test_an_unknown_sensor_is_refused(command: str, mesh_folder: Path, tmp_path: Path) -> None:
    arguments = (command, "--meshes", mesh_folder, "--out", tmp_path / "out", "--sensor", "lidar")
    result = run_cli(*arguments)
    assert result.code == 2
    assert "--sensor" in result.err
    assert "structured-light" in result.err


def test_only_the_ideal_sensor_takes_another_noise(mesh_folder: Path, tmp_path: Path) -> None:
    options = ("--meshes", mesh_folder, "--out", tmp_path, "--sensor", "stereo", "--noise", 0.002)
    result = run_cli("render", *options)
    assert result.code == 2
    assert "--noise" in result.err


def test_a_displaced_silhouette_stays_in_the_image() -> None:
    """An object that the image's border cuts: no pixel from beyond it."""
    from pointsdf_cli.camera.raycast import DepthPatch
    from pointsdf_cli.camera.views import measured_patch

    camera = CAMERAS["reference"]
    u, v = (a.ravel() for a in np.meshgrid(np.arange(600, 640), np.arange(0, 40)))
    patch = DepthPatch(u, v, np.full(len(u), 1.5, np.float32), len(u) / (640 * 480))
    sensor = DepthSensor("wild", displacement=3.0)
    found = [measured_patch(patch, camera, sensor, np.random.default_rng(k)) for k in range(5)]
    assert max(p.u.max() for p in found) == 639
    assert min(p.v.min() for p in found) == 0
    assert max(p.v.max() for p in found) > 40  # beyond the exact silhouette
    assert min(p.u.min() for p in found) < 600


def test_edges_reach_as_far_as_the_parameter_allows() -> None:
    camera = Camera(200, 40, 3200.0, 3200.0, 99.5, 19.5)
    depth = np.full((40, 200), 1.0, np.float32)
    depth[:, :20] = 2.0
    sensor = replace(load_sensor("structured-light"), missing_reach=50.0)
    measured = sensor.observe(depth, camera, np.random.default_rng(0))
    assert measured.shape == depth.shape
    assert (measured[:, 30:90] == 0).mean() > 3 * (measured[:, 190:] == 0).mean()
