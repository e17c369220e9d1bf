"""Checkpoints: a directory with `model.safetensors`, `config.json` and `train_state.pt` to resume.

Weights are safetensors and the training state is read with `weights_only=True`, so a checkpoint
from a stranger cannot run code. A checkpoint is replaced as a whole: the new directory is complete
and flushed beside the old one before it takes its place.
"""

from __future__ import annotations

import ctypes
import io
import os
import shutil
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from safetensors import SafetensorError

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.atomic import (
    TEMPORARY_MARK,
    UnwritableError,
    abandoned_beside,
    require_folder,
    temporary_beside,
    unwritable,
)
from pointsdf_cli.io.input_files import open_input, read_input
from pointsdf_cli.io.strict_json import to_json
from pointsdf_cli.io.untrusted import read_json

if TYPE_CHECKING:
    from torch import Tensor

WEIGHTS, CONFIG, TRAIN_STATE = "model.safetensors", "config.json", "train_state.pt"
SCHEMA, VERSION = "checkpoint", 1


@dataclass(frozen=True)
class Checkpoint:
    """One checkpoint as read.

    Attributes:
        weights: Tensors by name, as stored (half precision where it was shipped so).
        config: Everything in config.json: `architecture`, `model` (its arguments), provenance.
        path: Path it was read from.
    """

    weights: dict[str, Tensor]
    config: dict[str, Any]
    path: Path = field(default_factory=Path)


def write_checkpoint(
    path: Path | str,
    *,
    config: Mapping[str, Any],
    weights: Mapping[str, Tensor] | None = None,
    train_state: Mapping[str, Any] | None = None,
    half: bool = False,
) -> None:
    """Write or replace a checkpoint directory in one step.

    Args:
        path: The directory, or a link to one. What else is in it is kept.
        config: Written as config.json, with schema and version added.
        weights: By name; None keeps the weights that are there.
        train_state: Plain types and tensors; None keeps the state that is there.
        half: Store floating-point weights in float16.

    Raises:
        InputError: The place cannot be written, or is a file.
    """
    import torch
    from safetensors.torch import save

    path = Path(path).resolve()
    if path.exists() and not path.is_dir():
        raise InputError("is a file, and a checkpoint is a directory", where=path)
    _put_back(path)
    temporary = temporary_beside(path)
    try:
        temporary.mkdir(parents=True)
        if path.exists():
            shutil.copymode(path, temporary)
        # In memory first: both libraries answer to a full disk with errors of their own.
        if weights is not None:
            (temporary / WEIGHTS).write_bytes(save(_storable(weights, half)))
        if train_state is not None:
            image = io.BytesIO()
            torch.save(dict(train_state), image)
            (temporary / TRAIN_STATE).write_bytes(image.getbuffer())
        text = to_json({"schema": SCHEMA, "schema_version": VERSION, **config}, indent=1)
        (temporary / CONFIG).write_text(text + "\n", encoding="utf-8")
        for written in temporary.iterdir():
            with open(written, "rb") as handle:
                os.fsync(handle.fileno())
        for kept in path.iterdir() if path.exists() else ():
            if not (temporary / kept.name).exists() and kept.is_file():
                _link(kept, temporary / kept.name)
        _move_rest(_take_place(temporary, path), path)
    except OSError as error:
        raise unwritable(path, error) from error
    finally:
        _put_back(path)  # or the old files would be taken for what is left over
        for emptied in (temporary, _aside(path)):
            _remove_ours(emptied, path)


def _link(kept: Path, place: Path) -> None:
    try:
        os.link(kept, place)
    except OSError:  # a file system without links
        shutil.copy2(kept, place)


def _move_rest(aside: Path, path: Path) -> None:
    """Move everything else in the old directory into the new one; what cannot be moved stays."""
    for rest in list(aside.iterdir()) if aside.exists() else ():
        if not os.path.lexists(path / rest.name):
            os.rename(rest, path / rest.name)


def _remove_ours(folder: Path, path: Path) -> None:
    """Remove a directory's copies of a checkpoint's files, and the directory if nothing is left.

    Never more: it may hold what is the user's and could not be moved.
    """
    if not folder.is_dir():
        return
    for file in list(folder.iterdir()):
        ours = file.name in (WEIGHTS, TRAIN_STATE, CONFIG) or (path / file.name).is_file()
        if ours and (file.is_file() or file.is_symlink()):
            file.unlink(missing_ok=True)
    with suppress(OSError):
        folder.rmdir()


def require_checkpoint_place(path: Path | str, replace: bool) -> None:
    """Refuse a place where no checkpoint can be written, before the training begins.

    Args:
        path: Checkpoint directory.
        replace: Whether a run in it may be resumed or overwritten.

    Raises:
        InputError: It is a file or the working directory, cannot be written, or holds a run.
    """
    named, path = path, Path(os.path.realpath(path))
    if path.is_symlink():
        raise UnwritableError("is a link that leads to itself", where=named)
    if path == Path.cwd():
        what = "is the working directory, which the checkpoint would replace"
        raise InputError(what, where="--out", allowed="a directory of its own, such as --out ckpt")
    if path.exists() and not path.is_dir():
        raise InputError("is a file, and a checkpoint is a directory", where=path)
    try:
        require_folder(path.parent)
    except UnwritableError as error:
        raise UnwritableError(error.what, where=path, hint=error.hint) from error
    _put_back(path)
    for leftover in abandoned_beside(path):
        if leftover.is_dir():
            _remove_ours(leftover, path)
    if replace:
        return
    if has_train_state(named):
        raise InputError(
            "holds a training run already", where=f"--out {named}", hint="add --resume, or --force"
        )
    if any((path / name).exists() for name in (WEIGHTS, CONFIG)):
        raise InputError(
            "holds a checkpoint already, without what --resume needs",
            where=f"--out {named}",
            hint="add --force to replace it, or choose another --out",
        )


def _put_back(path: Path) -> None:
    """Undo the first rename of `_take_place`, if a run was killed between the two."""
    path = path.resolve()
    if not os.path.lexists(path) and (_aside(path) / CONFIG).is_file():
        with suppress(OSError):
            os.rename(_aside(path), path)


def read_checkpoint(path: Path | str) -> Checkpoint:
    """Read weights and configuration.

    Raises:
        InputError: No checkpoint is there, a file is damaged, holds NaN or infinity, or is of
            another version.
    """
    from safetensors.torch import load

    path = Path(path)
    config = read_config(path)
    weights_file = path / WEIGHTS
    if not weights_file.exists():
        raise InputError(f"has no {WEIGHTS}", where=path, allowed="a finished checkpoint directory")
    try:
        weights = load(read_input(weights_file, "checkpoint"))
    except (SafetensorError, OSError, ValueError) as error:
        raise InputError(
            f"is not a readable safetensors file ({error})", where=weights_file
        ) from error
    wrong = [n for n, t in weights.items() if t.is_floating_point() and not t.isfinite().all()]
    if wrong:
        raise InputError(
            f"{wrong[0]} holds NaN or infinity", where=weights_file, hint="train it again"
        )
    return Checkpoint(weights, config, path)


def read_config(path: Path | str) -> dict[str, Any]:
    """The configuration of a checkpoint, weights unread.

    Raises:
        InputError: As `read_checkpoint`.
    """
    path = Path(path)
    if path.is_file():
        raise InputError(
            "is a file, and a checkpoint is a directory",
            where=path,
            allowed=f"a directory with {WEIGHTS} and {CONFIG}; pickled weights are never opened",
        )
    config_file = path / CONFIG
    if not config_file.exists():
        raise InputError(
            f"is not a checkpoint: it has no {CONFIG}",
            where=path,
            allowed=f"a directory with {WEIGHTS} and {CONFIG}",
            hint="a directory that rgrasp train-sdf or rgrasp train-gs wrote",
        )
    config = read_json(config_file)
    if not isinstance(config, dict) or config.get("schema") != SCHEMA:
        raise InputError("does not describe a checkpoint", where=config_file)
    if config.get("schema_version") != VERSION:
        what = f"is of version {config.get('schema_version')}"
        raise InputError(what, where=config_file, allowed=f"version {VERSION}")
    return config


def read_train_state(path: Path | str) -> dict[str, Any]:
    """The state to resume from.

    Raises:
        InputError: There is none, or it holds more than plain types and tensors.
    """
    import torch

    state_file = Path(path) / TRAIN_STATE
    if not has_train_state(path):
        raise InputError(
            f"has no {TRAIN_STATE}, so there is nothing to resume", where=path, hint="drop --resume"
        )
    try:
        with open_input(state_file, "checkpoint") as handle:
            state = torch.load(handle, map_location="cpu", weights_only=True)
    except (InputError, MemoryError):
        raise
    except Exception as error:  # the unpickler raises whatever the bytes provoke
        what = "is damaged, or holds more than plain types and tensors, and is not opened"
        raise InputError(what, where=state_file, hint="start again without --resume") from error
    if not isinstance(state, dict):
        raise InputError("is not a training state", where=state_file)
    return state


def forget_train_state(path: Path | str) -> None:
    """Remove resumable state before another run begins."""
    (Path(path) / TRAIN_STATE).unlink(missing_ok=True)


def has_train_state(path: Path | str) -> bool:
    """Whether `path` holds something to resume."""
    _put_back(Path(path))
    return (Path(path) / TRAIN_STATE).exists()


def _storable(weights: Mapping[str, Tensor], half: bool) -> dict[str, Tensor]:
    storable = {}
    for name, tensor in weights.items():
        tensor = tensor.detach().cpu()
        if half and tensor.is_floating_point():
            tensor = tensor.half()
        storable[name] = tensor.contiguous().clone()
    return storable


def _aside(path: Path) -> Path:
    return path.with_name(f".{path.name}{TEMPORARY_MARK}old")


def _take_place(new: Path, old: Path) -> Path:
    """Put directory `new` at `old`; where the kernel can, both names are exchanged at once.

    Returns:
        Where the old directory is now, if there was one.
    """
    if not old.exists():
        os.rename(new, old)
        return new
    at_working_directory, exchange = -100, 2
    renameat2 = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if renameat2 is not None:
        arguments = (at_working_directory, os.fsencode(new), at_working_directory, os.fsencode(old))
        if renameat2(*arguments, exchange) == 0:
            return new
    # A file system without the exchange: two renames, the old one kept until the new is in place.
    aside = _aside(old)
    _remove_ours(aside, old)
    os.rename(old, aside)
    os.rename(new, old)
    return aside
