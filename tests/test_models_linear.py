"""The layer's products are those of `nn.Linear`, whichever library computes them."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from pointsdf_cli.models import linear, processor
from pointsdf_cli.models.linear import Linear, onednn_is_faster

pytestmark = pytest.mark.usefixtures("processor_read_anew")


def layers(bias: bool) -> tuple[Linear, nn.Linear]:
    layer, plain = Linear(37, 12, bias=bias), nn.Linear(37, 12, bias=bias)
    plain.load_state_dict(layer.state_dict())
    return layer, plain


@pytest.mark.parametrize("bias", [True, False])
@pytest.mark.parametrize("shape", [(37,), (5, 37), (2, 64, 37), (1, 16, 8, 37), (0, 37)])
def test_onednn_gives_the_same_products(
    monkeypatch: pytest.MonkeyPatch, bias: bool, shape: tuple[int, ...]
) -> None:
    if not hasattr(torch.ops.mkldnn, "_linear_pointwise"):
        pytest.skip("this PyTorch has no oneDNN")
    monkeypatch.setattr(linear, "onednn_is_faster", lambda: True)
    layer, plain = layers(bias)
    x = torch.randn(shape)
    with torch.no_grad():
        found, expected = layer(x), plain(x)
    assert found.shape == expected.shape
    torch.testing.assert_close(found, expected, atol=1e-5, rtol=1e-5)
    # Rows that do not lie one behind the other in memory.
    with torch.no_grad():
        wide = torch.randn(6, 3, 74)[:, :, ::2].transpose(0, 1)
        torch.testing.assert_close(layer(wide), plain(wide), atol=1e-5, rtol=1e-5)


def test_gradients_and_other_types_are_left_to_pytorch(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(linear, "onednn_is_faster", lambda: True)
    layer, plain = layers(True)
    x = torch.randn(4, 37, requires_grad=True)
    (gradient,) = torch.autograd.grad(layer(x).sum(), x)
    (expected,) = torch.autograd.grad(plain(x).sum(), x)
    assert torch.equal(gradient, expected)
    with torch.no_grad(), torch.autocast("cpu", torch.bfloat16):
        assert layer(x).dtype == torch.bfloat16
    with torch.no_grad():
        assert layer.double()(x.double()).dtype == torch.float64


@pytest.mark.parametrize(
    ("described", "chosen"),
    [
        ("vendor_id: AuthenticAMD flags: avx2 avx512f", True),
        ("vendor_id: AuthenticAMD flags: avx2", False),
        ("vendor_id: GenuineIntel flags: avx2 avx512f", False),
    ],
)
def test_the_processor_decides(
    monkeypatch: pytest.MonkeyPatch, described: str, chosen: bool
) -> None:
    monkeypatch.setattr(processor.Path, "read_text", lambda *args, **options: described)
    monkeypatch.setattr(torch.backends.mkldnn, "is_available", lambda: True)
    assert onednn_is_faster() is (chosen and hasattr(torch.ops.mkldnn, "_linear_pointwise"))
