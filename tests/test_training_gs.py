"""Success networks: metrics by hand, calibration of a known case, a rule learned, exact resume."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from grasp_worlds import write_balls
from scipy.special import expit
from sklearn import metrics as reference

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.grasps import read_grasps, write_grasps
from pointsdf_cli.models.grasp_success import EmbeddingNet, GeometryNet
from pointsdf_cli.models.hand_sweep import SweepConfig
from pointsdf_cli.models.registry import build_model, default_checkpoint
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.training import gs_baselines, gs_metrics
from pointsdf_cli.training.gs_calibration import Platt, fit_platt, negative_log_likelihood
from pointsdf_cli.training.gs_data import (
    GraspData,
    Split,
    fold_grasps,
    read_grasp_data,
    split_grasps,
)
from pointsdf_cli.training.gs_evaluation import table_lines
from pointsdf_cli.training.gs_evidence import evidence_of
from pointsdf_cli.training.gs_inputs import CloudInputs, FixedInputs, turn_numbers
from pointsdf_cli.training.gs_loop import (
    Fitted,
    SuccessTraining,
    _Run,
    scene_order,
    train_success,
    weights_of,
)
from pointsdf_cli.training.gs_variants import POINTSDF, VOXELCNN, Variant, reconstruction_of

ROBOT = load_robot()


def labels_and_scores(count: int = 400, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    score = rng.normal(size=count).round(1)  # rounded, so that there are ties
    return (rng.random(count) < expit(2 * score - 1)).astype(float), score


def test_metrics_agree_with_scikit_learn() -> None:
    label, score = labels_and_scores()
    assert np.isclose(
        gs_metrics.average_precision(label, score), reference.average_precision_score(label, score)
    )
    assert np.isclose(gs_metrics.roc_auc(label, score), reference.roc_auc_score(label, score))
    assert np.isclose(gs_metrics.f1(label, score > 0.5), reference.f1_score(label, score > 0.5))
    p = expit(score)
    assert np.isclose(gs_metrics.brier(label, p), reference.brier_score_loss(label, p))


def test_metrics_of_saying_yes_always_follow_from_the_base_rate() -> None:
    label = np.array([1.0] * 3 + [0.0] * 9)
    same = np.full(12, 0.7)
    assert np.isclose(gs_metrics.f1(label, same > 0.5), 2 * 0.25 / 1.25)
    assert np.isclose(gs_metrics.average_precision(label, same), 0.25)
    assert np.isclose(gs_metrics.roc_auc(label, same), 0.5)
    assert np.isnan(gs_metrics.roc_auc(np.ones(3), same[:3]))
    assert np.isnan(gs_metrics.average_precision(np.zeros(3), same[:3]))


def test_the_best_threshold_has_the_highest_f1_of_all() -> None:
    label, score = labels_and_scores(80)
    best = gs_metrics.best_threshold(label, score)
    every = max(gs_metrics.f1(label, score >= t) for t in score)
    assert np.isclose(gs_metrics.f1(label, score >= best), every)


def test_calibration_error_of_what_is_known_to_be_off_by_a_tenth() -> None:
    rng = np.random.default_rng(0)
    p = rng.uniform(0.15, 0.85, 60_000)
    label = (rng.random(len(p)) < p).astype(float)
    assert gs_metrics.calibration_error(label, p) < 0.01
    assert abs(gs_metrics.calibration_error(label, p + 0.1) - 0.1) < 0.01


def test_the_top_choice_of_a_perfect_score_always_holds() -> None:
    groups = np.repeat(np.arange(5), 30)
    label = np.tile(np.array([1.0] * 12 + [0.0] * 18), 5)
    rng = np.random.default_rng(0)
    top, random = gs_metrics.top_choice(label, label, groups, rng)
    assert (top == 1.0).all()
    assert np.allclose(random, 0.4)
    top, _ = gs_metrics.top_choice(label, np.zeros(150), groups, rng, draws=400)
    assert np.allclose(top, 0.4, atol=0.1)


def test_intervals_are_wider_for_fewer_objects() -> None:
    rng = np.random.default_rng(0)
    rate = rng.uniform(0, 1, 40)
    label = (rng.random((40, 25)) < rate[:, None]).astype(float).ravel()
    groups = np.repeat(np.arange(40), 25)
    mean = {"mean": lambda i: float(label[i].mean())}
    whole = gs_metrics.over_objects(mean, groups)["mean"]
    alone = gs_metrics.over_objects(mean, np.arange(1000))["mean"]
    assert whole.low < whole.value < whole.high
    # Grasps of one object go together: pretending that they do not makes the interval too narrow.
    assert whole.high - whole.low > 2 * (alone.high - alone.low)


def test_one_object_has_no_interval() -> None:
    label = np.array([1.0, 0.0, 1.0, 1.0])
    mean = {"mean": lambda i: float(label[i].mean())}
    found = gs_metrics.over_objects(mean, np.zeros(4, int))["mean"]
    assert found.value == 0.75
    assert np.isnan([found.low, found.high]).all()
    told: dict[str, Any] = {"f1": found._asdict(), "average_precision": found._asdict()}
    told["top_choice"] = {"top": told["f1"], "random": told["f1"]}
    assert table_lines({"net": told})[1].split()[:3] == ["net", "0.750", "–"]


def test_calibration_finds_the_temperature_and_shift_that_labels_were_drawn_with() -> None:
    rng = np.random.default_rng(0)
    logit = 4 * rng.normal(size=20_000)
    label = (rng.random(len(logit)) < expit(0.5 * logit - 1.0)).astype(float)
    found = fit_platt(label, logit)
    assert abs(found.scale - 0.5) < 0.03
    assert abs(found.shift + 1.0) < 0.06
    before = negative_log_likelihood(label, logit, Platt(1.0, 0.0))
    after = negative_log_likelihood(label, logit, found)
    true = negative_log_likelihood(label, logit, Platt(0.5, -1.0))
    assert after < before - 0.1
    assert abs(after - true) < 1e-3


def test_calibration_neither_reverses_a_bad_ranking_nor_trusts_a_perfect_one_forever() -> None:
    label = np.array([1.0, 1, 1, 0, 0, 0])
    assert fit_platt(label, np.array([-1.0, -2, -3, 1, 2, 3])).scale > 0
    assert np.isfinite(fit_platt(label, np.array([3.0, 2, 1, -1, -2, -3])).shift)


def rule_data(objects: int = 8, each: int = 60) -> tuple[GraspData, torch.Tensor]:
    """Features in which a grasp holds if x₀ x₁ > 0 (no single one tells anything)."""
    rng = np.random.default_rng(0)
    count = objects * each
    x = rng.normal(size=(count, 4)).astype(np.float32)
    object_of = np.repeat(np.arange(objects), each)
    data = GraspData(
        names=[str(k) for k in range(objects)],
        files=[Path(str(k)) for k in range(objects)],
        meshes=[str(k) for k in range(objects)],
        held_out=np.arange(objects) % 4 == 0,
        object_of=object_of,
        planned=np.zeros(count, bool),
        scene_of=object_of * 3 + np.arange(count) % 3,
        preshape=np.zeros((count, 8)),
        T_world_palm=np.tile(np.eye(4), (count, 1, 1)),
        T_world_camera=np.tile(np.eye(4), (count, 1, 1)),
        cloud=np.zeros((count, 1, 3), np.float32),
        kind=np.zeros(count, np.int8),
        label=(x[:, 0] * x[:, 1] > 0.3).astype(np.float32),
    )
    return data, torch.from_numpy(x)


CONFIG = SuccessTraining(epochs=25, batch_size=64, learning_rate=0.01, warmup=5, validation=0.25)


def rule_learner(x: torch.Tensor) -> FixedInputs:
    torch.manual_seed(0)
    network = GeometryNet(4, members=2, widths=(24, 12), dropout=0.05, input_dropout=0.0)
    network.scale.fit(x)
    return FixedInputs(network, x)


def test_a_rule_is_learned_and_holds_for_objects_that_were_not_seen() -> None:
    data, x = rule_data()
    split = split_grasps(data, 0.25, 0)
    learner = rule_learner(x)
    fitted = train_success(data, split, learner, CONFIG)
    learner.network.load_state_dict(
        {n.removeprefix("network."): t for n, t in fitted.weights.items()}
    )
    logits = learner.logits(split.test)
    truth = data.label[split.test]
    assert gs_metrics.average_precision(truth, logits) > 0.95
    probability = expit(fitted.platt.scale * logits + fitted.platt.shift)
    assert gs_metrics.calibration_error(truth, probability) < 0.1
    assert fitted.best["loss"] == min(entry["loss"] for entry in fitted.history)


def test_a_run_ends_when_validation_stops_getting_better() -> None:
    data, x = rule_data(6, 20)
    data = replace(data, label=np.random.default_rng(1).integers(0, 2, 120).astype(np.float32))
    config = replace(CONFIG, epochs=200, patience=3)
    fitted = train_success(data, split_grasps(data, 0.25, 0), rule_learner(x), config)
    assert fitted.finished
    assert len(fitted.history) < 100


def interrupted(  # type: ignore[no-untyped-def]
    make,
    data: GraspData,
    split: Split,
    config: SuccessTraining,
    after: int,
    later: Split | None = None,
    spoilt: dict[str, object] | None = None,
) -> Fitted:
    """A run stopped after some epochs and resumed by another learner, maybe with another split, or
    from a state with other values; {} for an empty one."""
    states = []
    train_success(
        data, split, make(), config,
        on_epoch=lambda fitted, state: states.append({**state, "history": list(state["history"])}),
        should_stop=lambda: len(states) >= after,
    )  # fmt: skip
    assert len(states) == after
    state = states[-1] if spoilt is None else {**states[-1], **spoilt} if spoilt else {}
    return train_success(data, later or split, make(), config, resume=state)


def same(a: Fitted, b: Fitted) -> bool:
    return all(torch.equal(a.weights[name], b.weights[name]) for name in a.weights) and [
        e["loss"] for e in a.history
    ] == [e["loss"] for e in b.history]


def test_a_stopped_and_resumed_run_equals_an_uninterrupted_one() -> None:
    data, x = rule_data(6, 30)
    split = split_grasps(data, 0.25, 0)
    config = replace(CONFIG, epochs=6)
    whole = train_success(data, split, rule_learner(x), config)
    assert same(whole, interrupted(lambda: rule_learner(x), data, split, config, 2))
    with pytest.raises(InputError, match="other settings"):
        train_success(data, split, rule_learner(x), config, resume={"config": {}})
    for wrong in (
        {}, {"config": 3}, {"epoch": "x"}, {"epoch": -1}, {"seconds": None}, {"history": [{}]},
        {"history": 3}, {"weights": {}}, {"best": {}}, {"best": {"network.a": torch.zeros(1)}},
        {"optimiser": {}}, {"rng": torch.zeros(3)},
    ):  # fmt: skip
        with pytest.raises(InputError, match=r"does not fit|other settings"):
            interrupted(lambda: rule_learner(x), data, split, config, 2, spoilt=wrong)
    with pytest.raises(InputError, match="held out"):
        interrupted(lambda: rule_learner(x), data, split, config, 2, split_grasps(data, 0.5, 0))


@pytest.fixture(scope="module")
def balls(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("grasps")
    write_balls(folder, ROBOT)
    return folder


@pytest.mark.parametrize("architecture", ["pointsdf-ray", "voxelcnn"])
def test_an_encoder_trained_along_resumes_exactly_too(balls: Path, architecture: str) -> None:
    data = read_grasp_data(balls, ROBOT)
    split = split_grasps(data, 0.3, 0)
    small = {
        "centres": (16, 8, 4, 2), "neighbours": (4, 4, 4, 2), "hidden": (8, 8, 8, 8),
        "channels": (8, 8, 8, 8), "width": 16, "blocks": 1, "local": 8,
    }  # fmt: skip

    def make() -> CloudInputs:
        encoder = build_model(architecture, small if architecture == "pointsdf-ray" else {})
        torch.manual_seed(0)
        return CloudInputs(EmbeddingNet(8), encoder, data, None)

    before = weights_of(make())
    config = SuccessTraining(epochs=2, batch_size=32, warmup=1)
    whole = train_success(data, split, make(), config)
    moved = [n for n in before if not torch.equal(before[n], whole.weights[n])]
    assert any(name.startswith("encoder.to_embedding") for name in moved)
    assert same(whole, interrupted(make, data, split, config, 1))


def test_only_executed_grasps_are_read_and_objects_are_never_shared(balls: Path) -> None:
    data = read_grasp_data(balls, ROBOT)
    assert len(data) == 6 * 2 * 10  # the twelfth row of each file had no motion
    split = split_grasps(data, 0.3, 0)
    parts = [set(data.object_of[part]) for part in (split.train, split.validation, split.test)]
    assert parts[2] == {3}
    assert set.union(*parts) == set(range(6))
    assert sum(map(len, parts)) == 6


def test_a_grasp_that_is_lost_in_a_push_counts_as_lost(balls: Path, tmp_path: Path) -> None:
    grasps, meta = read_grasps(balls / "balls" / "0.h5")
    pushed = np.where(grasps.label == 1, np.arange(len(grasps.label)) % 2, 0).astype(np.int8)
    write_grasps(tmp_path / "0.h5", replace(grasps, unshaken=pushed), meta, seed=0)
    before, after = read_grasp_data(balls, ROBOT), read_grasp_data(tmp_path, ROBOT)
    held = before.label[before.object_of == 0] == 1
    assert np.array_equal(after.label == 1, held & (pushed[grasps.executed] == 1))
    assert 0 < after.label.sum() < held.sum()


def test_embeddings_asked_for_alone_are_those_asked_for_with_distances(
    balls: Path, tmp_path: Path
) -> None:
    data = read_grasp_data(balls, ROBOT)
    one = replace(data, names=data.names[:1], files=data.files[:1])
    rows = np.flatnonzero(data.object_of == 0)
    fields = (
        "object_of",
        "planned",
        "scene_of",
        "preshape",
        "T_world_palm",
        "T_world_camera",
        "cloud",
    )
    one = replace(one, **{n: getattr(data, n)[rows] for n in (*fields, "kind", "label")})
    asked = (one, default_checkpoint(), tmp_path)
    alone = evidence_of(*asked, sweep=None)
    both = evidence_of(*asked, sweep=SweepConfig(stages=2, grid=(1, 1, 1)))
    for name in ("centre", "scale", "size"):
        assert np.allclose(getattr(alone, name), getattr(both, name), atol=1e-5)
    assert np.corrcoef(alone.embedding.ravel(), both.embedding.ravel())[0, 1] > 0.999
    assert alone.distance.shape == (20, 0)
    # Distances in the world: a palm's own points are outside of the ball it has not reached.
    assert (both.distance[:, -1] > -0.06).all()


def test_in_folds_every_object_teaches_some_members_and_validates_one(balls: Path) -> None:
    data = read_grasp_data(balls, ROBOT)
    split = fold_grasps(data, 5, 0)
    assert split.folds is not None
    assert set(data.object_of[split.train]) == {0, 1, 2, 4, 5}
    for number in (0, 1, 2, 4, 5):
        assert len(set(split.folds[data.object_of == number])) == 1
    network = GeometryNet(3, members=5)
    learner = FixedInputs(network, torch.randn(len(data), 3), folds=split.folds)
    weights = learner.member_weights(split.train)
    assert weights.shape == (5, 100)
    assert (weights.sum(0) == 4).all()
    found = learner.validation_logits(split.train)
    each = network.members(learner.columns[0][split.train]).detach().numpy()
    for row, fold in enumerate(split.folds[split.train]):
        assert weights[fold, row] == 0
        assert np.isclose(found[row], each[fold, row])


def test_mirror_images_teach_as_often_as_the_grasps_themselves() -> None:
    torch.manual_seed(0)
    network = GeometryNet(3, members=2, dropout=0.0, input_dropout=0.0)
    x = torch.randn(400, 3)
    image = (torch.tensor([1, 0, 2]), torch.tensor([1.0, 1.0, -1.0]))
    learner = FixedInputs(network, x, mirrors=[image])
    every = np.arange(400)
    found = learner.training_logits(every, np.random.default_rng(0))
    itself, other = network.members(x), network.members(x[:, image[0]] * image[1])
    as_it_is = torch.isclose(found, itself, atol=1e-6).all(0)
    assert (as_it_is ^ torch.isclose(found, other, atol=1e-6).all(0)).all()
    assert 0.4 < as_it_is.float().mean() < 0.6
    # Predictions are of the grasp itself.
    assert np.allclose(learner.logits(every), itself.mean(0).detach().numpy(), atol=1e-6)


def test_grasps_of_one_scene_come_together(balls: Path) -> None:
    data = read_grasp_data(balls, ROBOT)
    order = scene_order(data, np.arange(len(data)), np.random.default_rng(0))
    assert sorted(order) == list(range(len(data)))
    scenes = data.scene_of[order]
    assert (np.diff(scenes) != 0).sum() == len(np.unique(scenes)) - 1


def test_turning_numbers_is_turning_the_palm() -> None:
    c, s = np.cos(0.4), np.sin(0.4)
    turn = torch.tensor([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).float()[None]
    numbers = torch.cat([torch.arange(8.0), torch.tensor([1.0, 0, 0, 0, 1, 0, 0, 0, 1])])[None]
    found = turn_numbers(numbers, turn)[0]
    assert torch.allclose(found[:8], torch.arange(8.0))
    assert torch.allclose(found[8:11], torch.tensor([c, s, 0.0]).float())
    assert torch.allclose(found[11:14], torch.tensor([-s, c, 0.0]).float())
    assert torch.allclose(found[14:17], torch.tensor([0.0, 0.0, 1.0]))


def test_nearest_neighbours_know_a_rule_that_depends_on_the_gap_alone(balls: Path) -> None:
    data = read_grasp_data(balls, ROBOT)
    everything = np.arange(len(data))
    score = gs_baselines.nearest_neighbours(data, everything)
    assert ((score >= 0) & (score <= 1)).all()
    assert np.allclose(gs_baselines.always(data, everything), data.base_rate)


def test_nonsense_settings_are_refused() -> None:
    for wrong in ({"epochs": 0}, {"validation": 1.0}, {"learning_rate": -1.0}):
        with pytest.raises(InputError):
            SuccessTraining(**wrong)  # type: ignore[arg-type]


def test_a_run_stopped_within_an_epoch_carries_on_from_the_last_whole_one() -> None:
    data, x = rule_data(6, 30)
    split = split_grasps(data, 0.25, 0)
    config = replace(CONFIG, epochs=6, batch_size=32)
    whole = train_success(data, split, rule_learner(x), config)
    states: list[dict] = []
    asked = iter(range(10**6))
    train_success(
        data, split, rule_learner(x), config,
        on_epoch=lambda fitted, state: states.append(state),
        should_stop=lambda: bool(states) and next(asked) >= 1,
    )  # fmt: skip
    assert len(states) == 1
    states[0]["history"] = states[0]["history"][:1]
    again = train_success(data, split, rule_learner(x), config, resume=states[0])
    assert same(whole, again)


def test_a_mesh_that_tests_in_one_file_teaches_in_none(balls: Path, tmp_path: Path) -> None:
    grasps, meta = read_grasps(balls / "balls" / "0.h5")
    for name, split in (("a", "test"), ("b", "train")):
        write_grasps(tmp_path / f"{name}.h5", grasps, replace(meta, split=split), seed=0)
    assert read_grasp_data(tmp_path, ROBOT).held_out.tolist() == [True]


def test_other_seeds_validate_on_other_objects(balls: Path) -> None:
    data = read_grasp_data(balls, ROBOT)
    chosen = {
        tuple(np.unique(data.object_of[split_grasps(data, 0.3, k).validation])) for k in range(9)
    }
    assert len(chosen) > 1


def test_rare_successes_weigh_more() -> None:
    label = np.array([1, 0, 0, 0, 0], np.float32)
    data: Any = SimpleNamespace(
        label=label, names=[], object_of=np.arange(5), T_world_palm=np.zeros((5, 4, 4))
    )
    split: Any = SimpleNamespace(train=np.arange(5), validation=np.arange(5))
    learner: Any = SimpleNamespace(modules={"network": torch.nn.Linear(1, 1)})
    run = _Run(data, split, learner, SuccessTraining())
    assert run._class_weight.tolist() == pytest.approx([0.5 / 0.8, 0.5 / 0.2])


def test_each_encoder_has_a_bundled_reconstruction() -> None:
    for encoder, name in ((VOXELCNN, "voxelcnn"), (POINTSDF, "pointsdf_real")):
        assert reconstruction_of(Variant(encoder, "fixed"), None).name == name
