"""Checks of a training state before a run resumes from it.

A state is read without running code (`io/checkpoints.py`), but it may be damaged, of another run or
of other data, and torch fails at that in many ways, sometimes steps later.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch

from pointsdf_cli.errors import InputError
from pointsdf_cli.models.shape_model import ShapeModel

LATER = ("steps", "minutes", "validate_every")
"""Settings that a resumed run may change: they only affect the remaining schedule."""
_ADAM = {"step", "exp_avg", "exp_avg_sq"}


@contextmanager
def state_as_input_error(where: Path | str | None = None) -> Iterator[None]:
    """Context for restoring a state: turns its failures into one error.

    Raises:
        InputError: The state is incomplete, or does not fit the run.
    """
    senseless = (LookupError, TypeError, ValueError, AttributeError, ArithmeticError, RuntimeError)
    try:
        yield
    except senseless as error:
        said = (str(error).splitlines() or [""])[0][:100]
        raise InputError(
            f"the training state does not fit this run ({type(error).__name__}: {said})",
            where=where,
            hint="begin anew without --resume, with --force or another --out",
        ) from error


def progress_of(
    state: Mapping[str, Any], counted: str, judged_by: str
) -> tuple[int, float, list[dict[str, float]]]:
    """Number of steps or epochs done, seconds spent, and one entry per validation.

    Args:
        state: The state.
        counted: "step" or "epoch".
        judged_by: Name of the entries' criterion for the best.

    Raises:
        TypeError, ValueError, KeyError: A value is missing, of another kind or not finite.
    """
    count, seconds, history = state[counted], state["seconds"], list(state["history"])
    if not isinstance(count, int) or count < 0:
        raise ValueError(f"{counted} is {count!r:.40}")
    if not (_is_number(seconds) and 0 <= seconds < math.inf):
        raise ValueError(f"seconds is {seconds!r:.40}")
    for entry in history:
        if not all(_is_number(value) for value in entry.values()) or math.isnan(entry[judged_by]):
            raise ValueError("an entry of the history holds no numbers")
    return count, seconds, history


def put_back_optimiser(optimiser: torch.optim.Optimizer, state: Mapping[str, Any]) -> None:
    """Load the state of AdamW.

    Raises:
        TypeError, ValueError, KeyError: It is not of these weights, or of another optimiser.
    """
    fresh = [_kinds(group) for group in optimiser.param_groups]
    optimiser.load_state_dict(dict(state))
    for kinds, group in zip(fresh, optimiser.param_groups, strict=True):
        if _kinds(group) != kinds:
            raise TypeError("settings of the optimiser of another kind")
        for weight in group["params"]:
            kept = optimiser.state.get(weight, {})
            if kept and (set(kept) != _ADAM or not all(map(torch.is_tensor, kept.values()))):
                raise ValueError("not the state of AdamW")
            if any(each.ndim and each.shape != weight.shape for each in kept.values()):
                raise ValueError("averages of gradients of another shape than the weights")


def require_same_run(
    state: Mapping[str, Any], model: ShapeModel, config: Mapping[str, Any], out: Path | str
) -> None:
    """Refuse to resume the training of a reconstruction with another model or other settings.

    Raises:
        InputError: The settings that differ, with both values.
    """
    found = {"model": state["architecture"], **state["arguments"], **state["config"]}
    wanted = {"model": model.architecture, **model.config(), **config}
    differing = [name for name in wanted if name in found and found[name] != wanted[name]]
    differing = [name for name in differing if name not in LATER]
    if differing:
        changes = ", ".join(f"{n}: {found.get(n)} → {wanted[n]}" for n in differing)
        raise InputError(
            f"was trained with other settings ({changes})",
            where=out,
            hint="give the same options as before, or choose another --out",
        )


def require_same_data(state: Mapping[str, Any], learned_from: str, out: Path | str) -> None:
    """Refuse to resume with other objects, views or labels, or another split: the run would be
    judged by its training data.

    Raises:
        InputError: One of these differs.
    """
    if state["data"] != learned_from:
        raise InputError(
            "was trained on other data, or with another part of it held out",
            where=out,
            hint="give the same --views, --labels, --held-out and --views-per-object as before, or "
            "start again with another --out",
        )


def _kinds(group: Mapping[str, Any]) -> dict[str, object]:
    """Type of each setting of a parameter group."""

    def kind(value: object) -> object:
        if isinstance(value, tuple | list):
            return tuple(kind(each) for each in value)
        return "number" if _is_number(value) else type(value)

    return {name: kind(value) for name, value in group.items() if name != "params"}


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
