"""Training: the loss by hand, batches in the right frame, exact resume, a sphere learned."""

from __future__ import annotations

import itertools
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from safetensors.torch import load_file

from pointsdf_cli.errors import InputError, RgraspError
from pointsdf_cli.geometry.sdf_sampling import BOX, SamplingConfig, sample_sdf
from pointsdf_cli.io.atomic import temporary_beside
from pointsdf_cli.io.checkpoints import (
    read_checkpoint,
    read_train_state,
)
from pointsdf_cli.io.labels import Labels, read_labels, write_labels
from pointsdf_cli.io.views import Views, write_views
from pointsdf_cli.models.pointsdf_ray import PointSDFRay
from pointsdf_cli.models.reconstruction import Reconstruction
from pointsdf_cli.models.registry import build_model, load_model
from pointsdf_cli.training import sdf_loop
from pointsdf_cli.training.ema import WeightAverage
from pointsdf_cli.training.presets import settings
from pointsdf_cli.training.sdf_config import SdfLoss, TrainConfig
from pointsdf_cli.training.sdf_data import (
    augment,
    held_out_names,
    read_batch,
    split_views,
    training_views,
)
from pointsdf_cli.training.sdf_loop import train_sdf
from pointsdf_cli.training.sdf_loss import label_iou, label_volumes, sdf_loss, soft_iou
from pointsdf_cli.training.sdf_pack import Pack, open_pack, pair_artifacts, read_pack
from pointsdf_cli.training.sdf_progress import Progress, TrainResult
from pointsdf_cli.training.sdf_run import held_out_before

VIEWS, LABELS = 4, 3000


def _front(radius: float, rng: np.random.Generator) -> np.ndarray:
    """1000 points of the half of a sphere that a camera at the origin sees, 1.5 m before it."""
    directions = rng.normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    centre = np.array([0.02, -0.01, 1.5])
    seen = directions[(directions * (centre + radius * directions)).sum(1) < 0][:1000]
    return centre + radius * seen


@pytest.fixture(scope="module")
def artifacts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Views and labels of three spheres, with distances in closed form."""
    folder = tmp_path_factory.mktemp("spheres")
    rng = np.random.default_rng(0)
    for number, radius in enumerate((0.03, 0.05, 0.08)):
        T = np.tile(np.eye(4), (VIEWS, 1, 1))
        T[:, :3, 3] = [0.02, -0.01, 1.5]
        clouds = np.stack([_front(radius, rng) for _ in range(VIEWS)]).astype(np.float32)
        points = rng.uniform(-2.0 * radius, 2.0 * radius, (LABELS, 3))
        sdf = np.linalg.norm(points, axis=1) - radius
        name, digest = f"sphere{number}.ply", f"{number:064d}"
        views = Views(clouds, T, np.eye(3), (640, 480), 0.0, name, digest)
        write_views(folder / "views" / "balls" / f"{number}.h5", views, seed=0)
        labels = Labels(points.astype(np.float32), sdf.astype(np.float32), name, digest)
        write_labels(folder / "labels" / "balls" / f"{number}.h5", labels, seed=0)
    return folder


@pytest.fixture(scope="module")
def pack(artifacts: Path, tmp_path_factory: pytest.TempPathFactory) -> Pack:
    pairs = pair_artifacts(artifacts / "views", artifacts / "labels")
    return open_pack(pairs, tmp_path_factory.mktemp("pack"))


def _small() -> PointSDFRay:
    torch.manual_seed(0)
    return PointSDFRay(
        centres=(32, 16, 8, 4),
        neighbours=(8, 4, 4, 4),
        hidden=(8, 8, 8, 8),
        channels=(16, 16, 16, 16),
        width=32,
        blocks=2,
        local=16,
    )


CONFIG = TrainConfig(
    steps=8, batch_size=4, queries=64, warmup=2, validate_every=4, precision="float32"
)


def test_held_out_views_do_not_depend_on_how_many_are_used(pack: Pack) -> None:
    starts = np.flatnonzero(np.diff(pack.object_of_view, prepend=-1))
    split = split_views(pack, 0.34, 0)
    assert set(split.held_out_views) <= set(starts)
    known = set(pack.object_of_view[split.train])
    assert held_out_names(pack, split) == sorted(
        name for number, name in enumerate(pack.names) if number not in known
    )


def test_batch_norm_wants_two_clouds(pack: Pack, tmp_path: Path) -> None:
    model = build_model("pointsdf", {}, seed=0)
    alone = replace(CONFIG, batch_size=1)
    with pytest.raises(InputError, match="batch norm"):
        train_sdf(pack, split_views(pack, 0.34, 0), model, alone, tmp_path / "run")
    _run(pack, tmp_path / "ray", replace(alone, steps=1))


def _run(
    pack: Pack, out: Path, config: TrainConfig = CONFIG, stop_at: int | None = None, **more: object
) -> TrainResult:
    calls = iter(range(10**9))
    return train_sdf(
        pack,
        split_views(pack, 0.34, 0),
        _small(),
        config,
        out,
        should_stop=lambda: stop_at is not None and next(calls) >= stop_at,
        **more,  # type: ignore[arg-type]
    )


def test_the_loss_by_hand() -> None:
    predicted, sdf = torch.tensor([[0.1, -0.2]]), torch.tensor([[0.15, -0.05]])
    # |0.1 − 0.15| / 0.2 = 0.25 and |−0.2 + 0.05| / 0.1 = 1.5; both signs are right.
    assert sdf_loss(SdfLoss(sign_weight=0.0), predicted, sdf) == pytest.approx(0.875)
    cross_entropy = (np.log1p(np.exp(-0.1 / 0.02)) + np.log1p(np.exp(-0.2 / 0.02))) / 2
    assert sdf_loss(SdfLoss("sign", sign_weight=1.0), predicted, sdf) == pytest.approx(
        cross_entropy, rel=1e-4
    )
    assert sdf_loss(SdfLoss("mse"), predicted, sdf) == pytest.approx((0.05**2 + 0.15**2) / 2)
    wrong_side = sdf_loss(SdfLoss(), torch.tensor([[-0.01]]), torch.tensor([[0.01]]))
    right_side = sdf_loss(SdfLoss(), torch.tensor([[0.03]]), torch.tensor([[0.01]]))
    assert wrong_side > right_side


def test_the_quantile_is_where_the_loss_is_least() -> None:
    """A place that is 0.01 inside in 40% of worlds and 0.01 outside in 60%: the plain loss says
    outside, a quantile of 0.3 says inside."""
    sdf = torch.tensor([[-0.01] * 4 + [0.01] * 6])
    levels = torch.linspace(-0.02, 0.02, 401)

    def best(quantile: float) -> float:
        loss = SdfLoss(sign_weight=0.5, quantile=quantile)
        values = [sdf_loss(loss, sdf * 0 + s, sdf) for s in levels]
        return float(levels[int(torch.stack(values).argmin())])

    assert best(0.5) > 0 > best(0.3)
    logits = torch.linspace(-3, 3, 601) * -0.02
    sign = SdfLoss("sign", sign_weight=1.0, quantile=0.4)
    level = logits[int(torch.stack([sdf_loss(sign, sdf * 0 + s, sdf) for s in logits]).argmin())]
    assert level == pytest.approx(0.0, abs=2e-4)


def test_the_overlap_keeps_a_wall_of_uncertain_place() -> None:
    """One place that is inside in every world, and a wall in two of five places: each of them is
    inside in 40% of the worlds. Without the wall the IoU is 1/3, with all five places 3/6."""
    walls = torch.tensor(list(itertools.combinations(range(1, 6), 2)))
    sdf = torch.full((10, 6), 0.01).scatter(1, walls, -0.01)
    sdf[:, 0] = -0.01
    levels = torch.linspace(-0.1, 0.1, 401)

    def best(weight: float) -> float:
        loss = SdfLoss("sign", sign_weight=1.0, overlap_weight=weight)
        guesses = [torch.where(sdf[:1] * 0 + torch.arange(6) > 0, s, -0.1) for s in levels]
        values = [sdf_loss(loss, guess.expand(10, 6), sdf) for guess in guesses]
        return float(levels[int(torch.stack(values).argmin())])

    assert best(0.0) > 0 > best(10.0)
    inside, likely = torch.tensor([[True, True, False]]), torch.tensor([[1.0, 0.5, 0.25]])
    assert soft_iou(likely, inside, torch.ones(1, 3)).item() == pytest.approx(1.5 / 2.25)
    assert soft_iou(likely, inside, torch.tensor([[1.0, 2, 4]])).item() == pytest.approx(2 / 4)
    assert soft_iou(likely, ~inside & inside, torch.ones(1, 3)).item() == 0.0


def test_labels_stand_for_volumes() -> None:
    """Of a ball's labels, the volumes of those inside and in the box tell its share of the box."""
    mesh, rng = trimesh.creation.icosphere(subdivisions=4, radius=0.5), np.random.default_rng(0)
    samples = sample_sdf(mesh.vertices, mesh.faces, SamplingConfig(200_000), rng)
    unit = 1.03
    points, sdf = samples.points / unit, torch.from_numpy(samples.sdf / unit)
    in_box = (np.abs(points) < BOX).all(axis=1)
    volumes = label_volumes(sdf).numpy()[in_box]
    share = volumes[samples.sdf[in_box] < 0].sum() / volumes.sum()
    assert share == pytest.approx(4 / 3 * np.pi * (0.5 / unit) ** 3 / (2 * BOX) ** 3, rel=0.3)


def test_label_iou_counts_insides() -> None:
    truth = torch.tensor([[-1.0, -1.0, 1.0, 1.0], [1.0, 1.0, 1.0, 1.0]])
    predicted = torch.tensor([[-1.0, 1.0, -1.0, 1.0], [1.0, 1.0, 1.0, 1.0]])
    assert label_iou(predicted, truth).tolist() == [pytest.approx(1 / 3), 0.0]


def test_a_pack_holds_the_artifacts_in_the_network_frame(pack: Pack) -> None:
    assert pack.names == ("0", "1", "2")
    assert pack.clouds.shape == (3 * VIEWS, 1000, 3)
    extents = np.ptp(pack.clouds.astype(np.float32), axis=1).max(axis=1)
    np.testing.assert_allclose(extents, 1 / 1.03, atol=2e-3)
    # A batch's labels are a sphere's distances about its centre, in network units.
    batch = read_batch(pack, np.array([0, 5, 11]), 200, np.random.default_rng(0))
    for radius, view, x, sdf in zip(
        (0.03, 0.05, 0.08), (0, 5, 11), batch.x, batch.sdf, strict=True
    ):
        centre = pack.to_network[view, :, 3]
        expected = np.linalg.norm(x.numpy() - centre, axis=1) - radius * pack.scale[view]
        np.testing.assert_allclose(sdf, expected, atol=1e-5)


def test_the_packed_neighbours_are_the_nearest(pack: Pack) -> None:
    cloud = torch.from_numpy(pack.clouds[2].astype(np.float32))
    distances = torch.cdist(cloud[:20], cloud)
    packed = distances.gather(1, torch.from_numpy(pack.neighbours[2, :20].astype(np.int64)))
    best = distances.sort(dim=1).values[:, : packed.shape[1]]
    torch.testing.assert_close(packed, best, atol=1e-6, rtol=0.0)


def test_a_pack_is_built_once_and_again_for_other_files(artifacts: Path, tmp_path: Path) -> None:
    pairs = pair_artifacts(artifacts / "views", artifacts / "labels")
    built: list[int] = []
    open_pack(pairs, tmp_path, None, lambda n, _: built.append(n))
    open_pack(pairs, tmp_path, None, lambda n, _: built.append(n))
    assert built == [1, 2, 3]
    (tmp_path / "index.json").write_text("[1, 2]")  # somebody's own
    two = open_pack(pairs[:2], tmp_path, {"": 3})
    assert two.clouds.shape[0] == 6
    assert not list(tmp_path.rglob("*.bin"))
    # The first pack made room; what is not a pack stays.
    assert len([path for path in tmp_path.iterdir() if path.is_dir()]) == 1
    assert (tmp_path / "index.json").read_text() == "[1, 2]"
    assert read_pack(tmp_path).names == two.names
    with pytest.raises(InputError, match="no pack"):
        read_pack(tmp_path / "elsewhere")


def test_views_and_labels_are_of_one_mesh_in_one_unit(artifacts: Path, tmp_path: Path) -> None:
    shutil.copytree(artifacts / "labels", tmp_path / "labels")
    pairs = pair_artifacts(artifacts / "views", tmp_path / "labels")
    labels = read_labels(pairs[1][1])
    write_labels(pairs[1][1], labels, seed=0, config={"unit": "cm"})
    with pytest.raises(InputError, match="another unit of the mesh"):
        open_pack(pairs, tmp_path / "pack")
    write_labels(pairs[1][1], replace(labels, mesh_hash="another"), seed=0)
    with pytest.raises(InputError, match="another mesh"):
        open_pack(pairs, tmp_path / "pack")


def test_a_mesh_rendered_twice_is_held_out_under_both_names(pack: Pack) -> None:
    twice = replace(pack, meshes=("one", "two", "one"))
    for seed in range(4):
        for held_before in ((), pack.names[:1]):
            split = split_views(twice, 0.34, seed, held_before)
            taught = {twice.meshes[k] for k in pack.object_of_view[split.train]}
            assert len(taught) == 1
            assert taught.isdisjoint(
                twice.meshes[k] for k in pack.object_of_view[split.held_out_objects]
            )
    with pytest.raises(InputError, match="1 object"):
        split_views(replace(pack, meshes=("one",) * 3), 0.34, 0)


def test_objects_held_out_before_are_known_by_their_meshes(pack: Pack) -> None:
    held = {"held_out": ["balls/0"], "held_out_meshes": [f"{2:064d}"]}
    assert held_out_before(pack, held) == {pack.names[2]}
    assert held_out_before(pack, {"held_out": [pack.names[0], "elsewhere"]}) == {pack.names[0]}
    assert held_out_before(pack, {}) == set()


@pytest.mark.parametrize(
    ("model", "preset", "option"),
    [("pointsdf", "paper", "temperature"), ("voxelcnn", "small", "near")],
)
def test_a_setting_that_the_loss_does_not_use_is_refused(
    model: str, preset: str, option: str
) -> None:
    with pytest.raises(InputError, match="does not use it"):
        settings(model, preset, {option: 0.1})
    assert settings("pointsdf-ray", "small", {option: 0.1})[1].loss != SdfLoss()


def test_a_damaged_pack_is_built_again(artifacts: Path, tmp_path: Path) -> None:
    pairs = pair_artifacts(artifacts / "views", artifacts / "labels")
    first = np.array(open_pack(pairs, tmp_path).clouds)
    (clouds,) = tmp_path.glob("*/clouds.npy")
    for damage in (clouds.unlink, *(partial(clouds.write_bytes, b) for b in (b"", b"\x93NUMPY"))):
        damage()
        assert np.array_equal(open_pack(pairs, tmp_path).clouds, first)


def test_two_that_pack_at_once_do_not_meet(artifacts: Path, tmp_path: Path) -> None:
    """One is stopped, or has other files, while another finishes in the same folder."""
    pairs = pair_artifacts(artifacts / "views", artifacts / "labels")

    class StoppedError(Exception):
        pass

    def meanwhile(stop: bool) -> Callable[[int, int], None]:
        def on_progress(done: int, _: int) -> None:
            if done == 1:
                open_pack(pairs, tmp_path)
                if stop:
                    raise StoppedError

        return on_progress

    with pytest.raises(StoppedError):
        open_pack(pairs, tmp_path, None, meanwhile(stop=True))
    built: list[int] = []
    whole = open_pack(pairs, tmp_path, None, lambda n, _: built.append(n))
    assert not built  # what the other one finished is whole
    assert whole.clouds.shape[0] == 3 * VIEWS
    two = open_pack(pairs[:2], tmp_path, None, meanwhile(stop=False))
    assert two.clouds.shape[0] == 2 * VIEWS
    assert len(two.names) == 2
    assert len(list(tmp_path.iterdir())) == 1
    # Both begin the same, and the other one is the first to finish.
    again = open_pack(pairs, tmp_path, None, meanwhile(stop=False))
    assert np.array_equal(again.clouds, whole.clouds)
    assert len(list(tmp_path.iterdir())) == 1
    # A folder that is named alike, and is no pack, stays.
    mine = tmp_path / "pack-cups"
    mine.mkdir()
    (mine / "index.json").write_text("{}")
    open_pack(pairs[:1], tmp_path)
    assert (mine / "index.json").is_file()


def test_what_a_killed_packing_left_is_removed(artifacts: Path, tmp_path: Path) -> None:
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    ours = temporary_beside(tmp_path / "pack").name
    left = tmp_path / ours.replace(f"-{os.getpid()}-", f"-{gone.pid}-")
    left.mkdir()
    (left / "clouds.bin").write_bytes(b"half")
    open_pack(pair_artifacts(artifacts / "views", artifacts / "labels"), tmp_path)
    assert not left.exists()


def test_augmentation_keeps_distances_true_and_the_camera_with_its_cloud(pack: Pack) -> None:
    batch = read_batch(pack, np.array([3, 7]), 100, np.random.default_rng(0))
    turned = augment(batch, np.random.default_rng(1))
    assert not torch.allclose(turned.cloud, batch.cloud)
    assert np.ptp(turned.cloud.numpy(), axis=1).max(axis=1) == pytest.approx(1 / 1.03, abs=1e-3)
    # One similarity moves everything: distances between cloud, camera and labels scale alike.
    for k in range(2):
        before = torch.cdist(batch.x[k], torch.cat([batch.cloud[k], batch.camera[k : k + 1]]))
        after = torch.cdist(turned.x[k], torch.cat([turned.cloud[k], turned.camera[k : k + 1]]))
        scale = (after / before).median()
        torch.testing.assert_close(after, before * scale, rtol=2e-3, atol=2e-3)
        torch.testing.assert_close(turned.sdf[k], batch.sdf[k] * scale, rtol=2e-3, atol=2e-3)


def test_objects_are_held_out_whole(pack: Pack) -> None:
    split = split_views(pack, 0.34, 0)
    training = set(pack.object_of_view[split.train].tolist())
    held_out = set(pack.object_of_view[split.held_out_objects].tolist())
    assert training.isdisjoint(held_out)
    assert len(training) == 2
    assert set(split.held_out_views.tolist()).isdisjoint(split.train.tolist())
    assert set(pack.object_of_view[split.held_out_views].tolist()) <= training


def test_only_what_was_held_out_before_is_held_out_again(pack: Pack) -> None:
    # Of three objects a share of 0.67 is two, but of the second nobody knows what weights
    # that held out one have learned from.
    assert len(held_out_names(pack, split_views(pack, 0.67, 0))) == 2
    (before,) = held_out_names(pack, split_views(pack, 0.34, 0))
    for seed in range(3):
        assert held_out_names(pack, split_views(pack, 0.67, seed, [before])) == [before]
    # Other data: no name says anything.
    assert len(held_out_names(pack, split_views(pack, 0.67, 0, ["elsewhere"]))) == 2


def test_an_epoch_meets_every_view_once() -> None:
    views = np.arange(100, 124)
    epoch = np.concatenate([training_views(views, 4, step, seed=3) for step in range(6)])
    assert sorted(epoch) == sorted(views)
    other = np.concatenate([training_views(views, 4, step, seed=3) for step in range(6, 12)])
    assert sorted(other) == sorted(views)
    assert epoch.tolist() != other.tolist()


def test_a_stopped_and_resumed_run_equals_an_uninterrupted_one(pack: Pack, tmp_path: Path) -> None:
    whole = _run(pack, tmp_path / "whole")
    stopped = _run(pack, tmp_path / "parts", stop_at=5)
    assert whole.finished
    assert not stopped.finished
    assert stopped.step == 5
    resumed = _run(pack, tmp_path / "parts", resume=True)
    assert resumed.step == whole.step == 8
    for key in ("model", "average"):
        first = read_train_state(tmp_path / "whole")[key]
        second = read_train_state(tmp_path / "parts")[key]
        assert all(torch.equal(first[name], second[name]) for name in first)
    strip = [{k: v for k, v in entry.items() if k != "seconds"} for entry in whole.history]
    again = [{k: v for k, v in entry.items() if k != "seconds"} for entry in resumed.history]
    assert [e["object_loss"] for e in strip] == [e["object_loss"] for e in again]
    for one, other in zip(strip, again, strict=True):
        assert one == pytest.approx(other, rel=1e-5)  # sums of losses, added in other groups


SPOILT: dict[str, Any] = {
    "nothing at all": lambda state: state.clear(),
    "no settings": lambda state: state.pop("config"),
    "no loss since the last validation": lambda state: state.pop("total"),
    "settings that are none": lambda state: state.update(config=3),
    "a step in words": lambda state: state.update(step="x"),
    "a step that is no number": lambda state: state.update(step=float("nan")),
    "a step before the first": lambda state: state.update(step=-5),
    "endless seconds": lambda state: state.update(seconds=float("inf")),
    "a history of words": lambda state: state.update(history=[{"object_loss": "low"}]),
    "a history without losses": lambda state: state.update(history=[{"step": 1}]),
    "weights of another model": lambda state: state.update(model={"a": torch.zeros(1)}),
    "weights of another shape": lambda state: state.update(
        model={name: tensor[:0] for name, tensor in state["model"].items()}
    ),
    "no average": lambda state: state.update(average=None),
    "no optimiser": lambda state: state.update(optimiser={}),
    "an optimiser in words": lambda state: state["optimiser"]["param_groups"][0].update(betas="x"),
    "an optimiser of other weights": lambda state: state["optimiser"]["state"][0].update(
        exp_avg=torch.zeros(1, 2, 3)
    ),
    "another optimiser": lambda state: state["optimiser"]["state"][0].pop("exp_avg_sq"),
    "less than no steps": lambda state: state.update(since_validation="x"),
}


@pytest.fixture(scope="module")
def stopped(pack: Pack, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A training that was stopped."""
    folder = tmp_path_factory.mktemp("stopped")
    _run(pack, folder, stop_at=5)
    return folder


@pytest.mark.parametrize("wrong", SPOILT)
def test_a_state_that_does_not_fit_is_refused(
    pack: Pack, stopped: Path, tmp_path: Path, wrong: str
) -> None:
    state = read_train_state(stopped)
    SPOILT[wrong](state)
    shutil.copytree(stopped, tmp_path / "run")
    torch.save(state, tmp_path / "run" / "train_state.pt")
    with pytest.raises(InputError, match=r"does not fit|other settings"):
        _run(pack, tmp_path / "run", resume=True)


def test_dropout_resumes_where_it_stopped(pack: Pack, tmp_path: Path) -> None:
    split, config = split_views(pack, 0.34, 0), replace(CONFIG, steps=4, batch_size=2)

    def run(out: Path, drawn: int, **more: Any) -> None:
        model = build_model("pointsdf", seed=0)
        torch.manual_seed(drawn)  # another process, whatever it drew before
        train_sdf(pack, split, model, config, out, **more)

    run(tmp_path / "whole", 0)
    asked = iter(range(100))
    run(tmp_path / "parts", 1, should_stop=lambda: next(asked) >= 2)
    run(tmp_path / "parts", 2, resume=True)
    first, second = (read_train_state(tmp_path / name)["model"] for name in ("whole", "parts"))
    assert all(torch.equal(first[name], second[name]) for name in first)


def test_a_run_that_diverged_keeps_the_last_good_state(
    pack: Pack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _run(pack, tmp_path, stop_at=2)
    good = read_train_state(tmp_path)["model"]

    def lost(loss: SdfLoss, predicted: torch.Tensor, sdf: torch.Tensor) -> torch.Tensor:
        return sdf_loss(loss, predicted, sdf) * float("nan")

    monkeypatch.setattr(sdf_loop, "sdf_loss", lost)
    with pytest.raises(RgraspError, match="the loss is nan"):
        _run(pack, tmp_path, stop_at=1, resume=True)
    kept = read_train_state(tmp_path)["model"]
    assert all(torch.equal(kept[name], good[name]) for name in good)


@pytest.mark.parametrize("name", ["minutes", "learning_rate"])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), 0.0, -1.0])
def test_what_is_no_size_of_a_run_is_refused(name: str, value: float) -> None:
    with pytest.raises(InputError, match="not positive"):
        TrainConfig(**{name: value})  # type: ignore[arg-type]
    with pytest.raises(InputError, match="not positive"):
        SdfLoss(near=value)


def test_other_settings_are_not_resumed(pack: Pack, tmp_path: Path) -> None:
    _run(pack, tmp_path / "run", stop_at=2)
    with pytest.raises(InputError, match="queries: 64 → 32"):
        _run(pack, tmp_path / "run", replace(CONFIG, queries=32), resume=True)
    with pytest.raises(InputError, match="nothing to resume"):
        _run(pack, tmp_path / "other", resume=True)


def test_an_argument_newer_than_a_run_had_its_default(pack: Pack, tmp_path: Path) -> None:
    _run(pack, tmp_path, stop_at=2)
    state = read_train_state(tmp_path)
    name = next(name for name in ("sideways", "preset", "dropout") if name in state["arguments"])
    del state["arguments"][name]
    torch.save(state, tmp_path / "train_state.pt")
    assert _run(pack, tmp_path, resume=True).finished


def test_other_labels_of_the_same_objects_are_not_resumed(pack: Pack, tmp_path: Path) -> None:
    _run(pack, tmp_path, stop_at=2)
    other = replace(pack, sdf=pack.sdf + np.float32(1e-3))
    with pytest.raises(InputError, match="other data"):
        _run(other, tmp_path, resume=True)


def test_another_split_is_not_resumed(pack: Pack, tmp_path: Path) -> None:
    _run(pack, tmp_path, stop_at=2)
    with pytest.raises(InputError, match="held out"):
        train_sdf(pack, split_views(pack, 0.34, 1), _small(), CONFIG, tmp_path, resume=True)


def test_the_kept_weights_are_those_of_the_best_validation(pack: Pack, tmp_path: Path) -> None:
    seen: list[Progress] = []
    config = replace(CONFIG, steps=12, validate_every=2)
    result = _run(pack, tmp_path / "run", config, on_progress=seen.append)
    assert result.best is not None
    assert result.best["object_loss"] == min(e["object_loss"] for e in result.history)
    assert read_checkpoint(tmp_path / "run").config["best"]["step"] == result.best["step"]
    assert len([p for p in seen if p.validation]) == 6


def test_a_sphere_is_learned_and_its_unseen_half_found(pack: Pack, tmp_path: Path) -> None:
    config = TrainConfig(
        steps=160, batch_size=4, queries=128, warmup=10, average=0.9, validate_every=160,
        learning_rate=3e-3, precision="float32",
    )  # fmt: skip
    _run(pack, tmp_path / "run", config)
    cloud = _front(0.06, np.random.default_rng(9))
    shape = Reconstruction.from_cloud(load_model(tmp_path / "run"), cloud, np.zeros(3))
    x = np.array([0.02, -0.01, 1.5]) + np.random.default_rng(1).uniform(-0.1, 0.1, (4000, 3))
    truth = np.linalg.norm(x - [0.02, -0.01, 1.5], axis=1) < 0.06
    inside = shape.sdf(x) < 0
    assert (inside & truth).sum() / (inside | truth).sum() > 0.8


@pytest.mark.parametrize("architecture", ["pointsdf", "voxelcnn"])
def test_the_other_networks_train_too(architecture: str, pack: Pack, tmp_path: Path) -> None:
    from pointsdf_cli.training.presets import preset

    arguments, config = preset(architecture, "small")
    model = build_model(architecture, arguments)
    config = replace(config, steps=2, batch_size=2, queries=16, precision="float32")
    result = train_sdf(pack, split_views(pack, 0.34, 0), model, config, tmp_path / "run")
    assert result.finished
    assert np.isfinite(result.history[-1]["object_loss"])
    assert load_model(tmp_path / "run").architecture == architecture


def test_a_loss_that_is_no_number_ends_the_run_and_leaves_no_weights(
    pack: Pack, tmp_path: Path
) -> None:
    wild = replace(CONFIG, learning_rate=1e38, warmup=0, clip=0.0, steps=6, validate_every=2)
    with pytest.raises(RgraspError, match="lower --learning-rate"):
        _run(pack, tmp_path / "ckpt", wild)
    stored = tmp_path / "ckpt" / "model.safetensors"
    if stored.exists():
        assert all(torch.isfinite(t).all() for t in load_file(stored).values())


def test_weights_that_the_last_step_ruined_are_not_kept(pack: Pack, tmp_path: Path) -> None:
    wild = replace(CONFIG, learning_rate=1e38, warmup=0, clip=0.0, steps=1, validate_every=1)
    with pytest.raises(RgraspError, match="lower --learning-rate"):
        _run(pack, tmp_path / "ckpt", wild)
    assert not (tmp_path / "ckpt" / "model.safetensors").exists()


def test_the_published_recipe_is_a_hundred_epochs(  # type: ignore[no-untyped-def]
    cli, artifacts: Path, tmp_path: Path
) -> None:
    run = cli(
        "train-sdf", "--model", "voxelcnn", "--preset", "paper", "--views", artifacts / "views",
        "--labels", artifacts / "labels", "--out", tmp_path / "ckpt", "--queries", 16,
        "--held-out", 0.34, "--threads", 1, "--json",
    )  # fmt: skip
    assert run.code == 0, run.err
    # Two objects of four views, less one view that is held out: seven views, sixteen a batch.
    assert json.loads(run.out)["steps"] == 100 * 7 // 16


def test_a_checkpoint_without_a_state_is_not_replaced_unasked(  # type: ignore[no-untyped-def]
    cli, artifacts: Path, tmp_path: Path
) -> None:
    arguments = [
        "train-sdf", "--views", artifacts / "views", "--labels", artifacts / "labels",
        "--out", tmp_path / "ckpt", "--batch-size", 2, "--queries", 16, "--held-out", 0.34,
        "--threads", 1, "--steps", 1,
    ]  # fmt: skip
    assert cli(*arguments).code == 0
    (tmp_path / "ckpt" / "train_state.pt").unlink()
    before = (tmp_path / "ckpt" / "model.safetensors").read_bytes()
    run = cli(*arguments)
    assert run.code == 2
    assert "--force" in run.err
    assert (tmp_path / "ckpt" / "model.safetensors").read_bytes() == before
    assert cli(*arguments, "--force").code == 0


def test_nonsense_settings_are_refused() -> None:
    for wrong in ({"steps": 0}, {"schedule": "exponential"}, {"minutes": -1.0}, {"average": 1.0}):
        with pytest.raises(InputError):
            TrainConfig(**wrong)  # type: ignore[arg-type]
    with pytest.raises(InputError):
        SdfLoss("huber")


def test_the_command_trains_stops_and_resumes(cli, artifacts: Path, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    arguments = [
        "train-sdf", "--views", artifacts / "views", "--labels", artifacts / "labels",
        "--out", tmp_path / "ckpt", "--batch-size", 2, "--queries", 16, "--validate-every", 2,
        "--held-out", 0.34, "--threads", 1,
    ]  # fmt: skip
    done = cli(*arguments, "--steps", 2, "--json")
    assert done.code == 0, done.err
    assert '"finished": true' in done.out
    assert (tmp_path / "ckpt" / "loss.png").stat().st_size > 1000
    again = cli(*arguments, "--steps", 3)
    assert again.code == 2
    assert "--resume" in again.err
    carried_on = cli(*arguments, "--steps", 3, "--resume", "--json")
    assert carried_on.code == 0, carried_on.err
    assert '"steps": 3' in carried_on.out
    sharper = cli(
        *arguments[:5], "--out", tmp_path / "sharper", *arguments[7:], "--steps", 2,
        "--start-from", tmp_path / "ckpt", "--near", 0.02, "--temperature", 0.01,
    )  # fmt: skip
    assert sharper.code == 0, sharper.err
    config = read_checkpoint(tmp_path / "sharper").config
    assert config["training"]["loss"]["near"] == 0.02
    assert config["started_from"]["training"]["loss"]["near"] == 0.05
    # What the first was judged by judges the second, although another seed would draw others.
    first = read_checkpoint(tmp_path / "ckpt").config["data"]["held_out"]
    assert len(first) == 1
    begun = [*arguments[:5], "--out", tmp_path / "begun", *arguments[7:], "--seed", 5]
    begun += ["--start-from", tmp_path / "ckpt"]
    assert cli(*begun, "--steps", 2).code == 0
    config = read_checkpoint(tmp_path / "begun").config
    assert config["data"]["held_out"] == first
    # Weights that do not say what was held out from them make no list to be believed later.
    path = tmp_path / "ckpt" / "config.json"
    path.write_text(path.read_text().replace('"held_out', '"kept_aside'))
    vague = [*arguments[:5], "--out", tmp_path / "vague", *arguments[7:]]
    run = cli(*vague, "--start-from", tmp_path / "ckpt", "--steps", 2)
    assert run.code == 0, run.err
    assert "it may have been trained on those" in run.err
    assert read_checkpoint(tmp_path / "vague").config["data"]["held_out"] is None
    # A resumed run keeps where it began, and began nowhere else.
    assert cli(*begun[:-2], "--steps", 3, "--resume").code == 0
    assert read_checkpoint(tmp_path / "begun").config["started_from"] == config["started_from"]
    elsewhere = cli(*begun[:-1], tmp_path / "sharper", "--steps", 4, "--resume")
    assert elsewhere.code == 2
    assert "did not begin with" in elsewhere.err
    other = cli(*begun, "--model", "voxelcnn", "--steps", 2, "--force")
    assert other.code == 2
    assert "is a pointsdf-ray" in other.err
    for wrong, told in (
        (["--views", tmp_path / "none"], "no such folder"),
        (["--model", "resnet"], "pointsdf-ray"),
        (["--views-per-object", "many"], "FOLDER=N"),
        (["--held-out", "2"], "between 0 and 1"),
    ):
        refused = cli(*arguments, *wrong, "--resume")
        assert refused.code == 2
        assert told in refused.err


def test_averaged_weights_move_slowly() -> None:
    average, now = torch.nn.Linear(1, 1, bias=False), torch.nn.Linear(1, 1, bias=False)
    average.weight.data.fill_(0.0)
    now.weight.data.fill_(1.0)
    made = WeightAverage(average, 0.9, every=1)
    made.update(now, 1000)
    assert float(made.model.weight) == pytest.approx(0.1)  # type: ignore[arg-type]
