"""bfloat16 is taken where it is faster, not where the processor only knows it."""

from __future__ import annotations

import pytest
import torch

from pointsdf_cli.errors import InputError
from pointsdf_cli.models import processor
from pointsdf_cli.training import precision

CPU = torch.device("cpu")

pytestmark = pytest.mark.usefixtures("processor_read_anew")


@pytest.mark.parametrize(
    ("described", "chosen"),
    [
        ("vendor_id: AuthenticAMD flags: avx512f avx512_bf16", torch.bfloat16),
        ("vendor_id: GenuineIntel flags: avx512f avx512_bf16 amx_bf16", torch.bfloat16),
        ("vendor_id: GenuineIntel flags: avx512f avx512_bf16", None),
        ("vendor_id: AuthenticAMD flags: avx512f", None),
    ],
)
def test_auto_takes_the_faster_type(
    monkeypatch: pytest.MonkeyPatch, described: str, chosen: torch.dtype | None
) -> None:
    monkeypatch.setattr(processor.Path, "read_text", lambda *args, **options: described)
    assert precision.autocast_dtype("auto", CPU) is chosen


def test_an_unknown_processor_uses_float32(monkeypatch: pytest.MonkeyPatch) -> None:
    def unreadable(*args: object, **options: object) -> str:
        raise OSError

    monkeypatch.setattr(processor.Path, "read_text", unreadable)
    assert precision.autocast_dtype("auto", CPU) is None


def test_what_is_asked_for_is_used() -> None:
    assert precision.autocast_dtype("bfloat16", CPU) is torch.bfloat16
    assert precision.autocast_dtype("float32", CPU) is None
    with pytest.raises(InputError, match="no precision"):
        precision.autocast_dtype("float8", CPU)
