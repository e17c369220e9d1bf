"""bfloat16 is taken where it is faster, not where the processor only knows it."""

from __future__ import annotations

import pytest
import torch

from pointsdf_cli.errors import InputError
from pointsdf_cli.training import precision

CPU = torch.device("cpu")


@pytest.fixture(autouse=True)
def _asked_anew() -> None:
    precision.bfloat16_is_faster.cache_clear()


@pytest.mark.parametrize(("bfloat16_seconds", "chosen"), [(0.2, torch.bfloat16), (1.7, None)])
def test_auto_takes_the_faster_type(
    monkeypatch: pytest.MonkeyPatch, bfloat16_seconds: float, chosen: torch.dtype | None
) -> None:
    seconds = {torch.float32: 1.0, torch.bfloat16: bfloat16_seconds}
    monkeypatch.setattr(precision, "_product_seconds", lambda rows, weights: seconds[rows.dtype])
    monkeypatch.setattr(
        precision.Path, "read_text", lambda *args, **options: "flags: avx512f avx512_bf16"
    )
    assert precision.autocast_dtype("auto", CPU) is chosen


def test_a_processor_without_bfloat16_is_not_timed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(precision.Path, "read_text", lambda *args, **options: "flags: avx512f")
    monkeypatch.setattr(precision, "_product_seconds", lambda *args: pytest.fail("timed"))
    assert precision.autocast_dtype("auto", CPU) is None


def test_the_timed_products_are_done() -> None:
    assert precision._product_seconds(torch.ones(64, 32), torch.ones(32, 32)) > 0


def test_what_is_asked_for_is_used() -> None:
    assert precision.autocast_dtype("bfloat16", CPU) is torch.bfloat16
    assert precision.autocast_dtype("float32", CPU) is None
    with pytest.raises(InputError, match="no precision"):
        precision.autocast_dtype("float8", CPU)
