"""Checkpoints: whole or not there, rebuilt from config.json, and safe to open from a stranger."""

from __future__ import annotations

import json
import os
import pickle
from pathlib import Path

import pytest
import torch

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.atomic import temporary_beside
from pointsdf_cli.io.checkpoints import (
    has_train_state,
    read_checkpoint,
    read_train_state,
    require_checkpoint_place,
    write_checkpoint,
)
from pointsdf_cli.models.registry import build_model, load_model


@pytest.fixture
def checkpoint(tmp_path: Path) -> Path:
    model = build_model("pointsdf-ray", seed=2)
    path = tmp_path / "ckpt"
    write_checkpoint(
        path,
        config={"architecture": model.architecture, "model": model.config()},
        weights=model.state_dict(),
        train_state={"step": 7},
    )
    return path


def test_a_model_comes_back_as_it_was(checkpoint: Path) -> None:
    model = build_model("pointsdf-ray", seed=2)
    again = load_model(checkpoint)
    assert not again.training
    for name, tensor in model.state_dict().items():
        assert torch.equal(again.state_dict()[name], tensor)


def test_what_was_not_measured_is_null(tmp_path: Path) -> None:
    write_checkpoint(tmp_path / "c", config={"best": {"view_loss": float("nan")}}, weights={})
    text = (tmp_path / "c" / "config.json").read_text(encoding="utf-8")

    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is no JSON")

    assert json.loads(text, parse_constant=refuse)["best"] == {"view_loss": None}


def test_weights_and_state_are_replaced_one_without_the_other(checkpoint: Path) -> None:
    weights = read_checkpoint(checkpoint).weights
    config = read_checkpoint(checkpoint).config
    write_checkpoint(checkpoint, config=config, train_state={"step": 8})
    assert read_train_state(checkpoint) == {"step": 8}
    assert all(torch.equal(weights[n], t) for n, t in read_checkpoint(checkpoint).weights.items())
    assert [p.name for p in checkpoint.parent.iterdir()] == [checkpoint.name]


def test_half_precision_is_half_the_size_and_loads_as_float32(tmp_path: Path) -> None:
    model = build_model("pointsdf-ray")
    write_checkpoint(
        tmp_path / "half",
        config={"architecture": model.architecture, "model": model.config()},
        weights=model.state_dict(),
        half=True,
    )
    size = (tmp_path / "half" / "model.safetensors").stat().st_size
    count = sum(p.numel() for p in model.parameters())
    assert size == pytest.approx(2 * count, rel=0.02)
    assert next(load_model(tmp_path / "half").parameters()).dtype == torch.float32
    assert not has_train_state(tmp_path / "half")


class _Bomb:
    def __reduce__(self) -> tuple[object, ...]:
        return (open, ("bomb-went-off", "w"))


def test_a_pickled_training_state_is_not_run(
    checkpoint: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(checkpoint.parent)
    for writer in (pickle.dump, torch.save):
        with open(checkpoint / "train_state.pt", "wb") as handle:
            writer(_Bomb(), handle)
        with pytest.raises(InputError, match="not opened"):
            read_train_state(checkpoint)
    assert not (checkpoint.parent / "bomb-went-off").exists()


def test_damage_and_strangers_are_refused(checkpoint: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not a checkpoint"):
        load_model(tmp_path / "nothing")
    pickled = tmp_path / "weights.pt"
    torch.save({}, pickled)
    with pytest.raises(InputError, match="directory"):
        load_model(pickled)

    config_file = checkpoint / "config.json"
    config = json.loads(config_file.read_text())
    config_file.write_text(json.dumps(config | {"architecture": "__import__('os')"}))
    with pytest.raises(InputError, match="no architecture"):
        load_model(checkpoint)
    config_file.write_text(json.dumps(config | {"schema_version": 99}))
    with pytest.raises(InputError, match="version 99"):
        load_model(checkpoint)
    config_file.write_text(json.dumps(config | {"model": config["model"] | {"width": 64}}))
    with pytest.raises(InputError, match="do not fit"):
        load_model(checkpoint)
    config_file.write_text("{")
    with pytest.raises(InputError, match="JSON"):
        load_model(checkpoint)

    config_file.write_text(json.dumps(config))
    weights = checkpoint / "model.safetensors"
    weights.write_bytes(weights.read_bytes()[:1000])
    with pytest.raises(InputError, match="safetensors"):
        load_model(checkpoint)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_weights_of_a_run_that_diverged_are_refused(tmp_path: Path, value: float) -> None:
    weights = {"scale": torch.ones(3), "count": torch.tensor(3), "shift": torch.tensor([0, value])}
    write_checkpoint(tmp_path / "c", config={"architecture": "any"}, weights=weights)
    with pytest.raises(InputError, match="shift holds NaN or infinity"):
        read_checkpoint(tmp_path / "c")


def test_a_file_is_never_overwritten_by_a_checkpoint(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("mine")
    with pytest.raises(InputError, match="is a file"):
        write_checkpoint(tmp_path / "taken", config={})
    assert (tmp_path / "taken").read_text() == "mine"


def test_what_else_lies_there_stays_and_a_link_stays_a_link(
    checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (checkpoint / "notes").mkdir()
    (checkpoint / "notes" / "thesis.txt").write_text("mine")
    link = tmp_path / "link"
    link.symlink_to(checkpoint)
    write_checkpoint(link, config=read_checkpoint(checkpoint).config, train_state={"step": 9})
    assert link.is_symlink()
    assert read_train_state(checkpoint) == {"step": 9}
    assert (checkpoint / "notes" / "thesis.txt").read_text() == "mine"
    assert sorted(p.name for p in tmp_path.iterdir()) == [checkpoint.name, "link"]
    monkeypatch.chdir(checkpoint)
    with pytest.raises(InputError, match="is the working directory"):
        require_checkpoint_place(Path("."), replace=True)


def test_a_folder_that_cannot_be_moved_costs_nothing_else(
    checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("a", "b", "c"):
        (checkpoint / name).mkdir()
        (checkpoint / name / "mine.txt").write_text(name)
    rename = os.rename

    def refused(source: Path, target: Path) -> None:
        if Path(source).name == "b":
            raise PermissionError(13, "Permission denied")
        rename(source, target)

    monkeypatch.setattr("pointsdf_cli.io.checkpoints.os.rename", refused)
    with pytest.raises(InputError, match="Permission denied"):
        write_checkpoint(checkpoint, config=read_checkpoint(checkpoint).config)
    kept = sorted(path.read_text() for path in tmp_path.rglob("mine.txt"))
    assert kept == ["a", "b", "c"]


def test_a_file_system_without_links_keeps_what_lies_there(
    checkpoint: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (checkpoint / "loss.png").write_bytes(b"picture")

    def none(*_: object) -> None:
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr("pointsdf_cli.io.checkpoints.os.link", none)
    write_checkpoint(checkpoint, config=read_checkpoint(checkpoint).config, train_state={"step": 3})
    assert (checkpoint / "loss.png").read_bytes() == b"picture"
    assert read_train_state(checkpoint) == {"step": 3}


def test_a_run_killed_between_two_renames_is_put_back(checkpoint: Path) -> None:
    # What a file system that cannot exchange two names leaves behind.
    checkpoint.rename(checkpoint.with_name(".ckpt.partial-old"))
    assert has_train_state(checkpoint)
    assert read_train_state(checkpoint)["step"] == 7
    assert load_model(checkpoint)


def test_a_rename_that_fails_loses_no_checkpoint(
    checkpoint: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rename = os.rename

    def failing(old: Path, new: Path) -> None:
        # The second of the two renames where names cannot be exchanged; the first is real.
        if Path(new) == checkpoint.resolve() and "partial-old" not in str(old):
            raise OSError(5, "Input/output error")
        rename(old, new)

    monkeypatch.setattr("ctypes.CDLL", lambda *_, **__: object())  # no renameat2
    monkeypatch.setattr(os, "rename", failing)
    with pytest.raises(InputError):
        write_checkpoint(checkpoint, config={}, train_state={"step": 8})
    assert read_train_state(checkpoint)["step"] == 7
    assert load_model(checkpoint)


def test_what_killed_runs_were_writing_is_removed(checkpoint: Path) -> None:
    # No process has a number above the kernel's largest.
    mine = temporary_beside(checkpoint).name
    killed = checkpoint.with_name(mine.replace(str(os.getpid()), "99999999"))
    for folder in (killed, checkpoint.with_name(mine)):
        folder.mkdir()
        (folder / "model.safetensors").write_bytes(b"half")
    require_checkpoint_place(checkpoint, replace=True)
    assert not killed.exists()
    assert checkpoint.with_name(mine).exists()  # this process is alive
    assert load_model(checkpoint)


def test_a_folder_keeps_its_permissions(checkpoint: Path) -> None:
    checkpoint.chmod(0o700)
    write_checkpoint(checkpoint, config={"architecture": "other", "model": {}})
    assert checkpoint.stat().st_mode & 0o777 == 0o700


def test_files_of_a_checkpoint_follow_the_umask(tmp_path: Path) -> None:
    before = os.umask(0o077)
    try:
        write_checkpoint(tmp_path / "mine", config={}, weights={"a": torch.zeros(1)})
    finally:
        os.umask(before)
    for file in (tmp_path / "mine").iterdir():
        assert file.stat().st_mode & 0o077 == 0, file
