"""The Geometry Morph Adjuster: identity at first, Eq. 9–12 term by term, compiled equals float64 autograd.

Also covers `ggavatar/gaussians/offsets_kernel.py`.
"""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor
from torch.nn.functional import normalize

from ggavatar.gaussians.offsets import COLOR_ROWS, GEOMETRY_ROWS, Offsets, refine, refine_in_torch
from ggavatar.geometry.transforms import quaternion_multiply, quaternion_to_matrix
from ggavatar.networks.fields import Box, FourierFeatures, HashTriplane, HashTriplaneConfig
from ggavatar.networks.morph_adjuster import AdjusterConfig, BasisAdjuster

CONDITIONS, COUNT = 12, 300
BOX = Box((0.0, 0.0, 0.0), 2.0)
SIZES = AdjusterConfig(latent=6, hidden=32, latent_hidden=16)


def adjuster(kind: str = "triplane", config: AdjusterConfig = SIZES, trained: bool = True) -> BasisAdjuster:
    generator = torch.Generator().manual_seed(1)
    triplane = HashTriplaneConfig(levels=4, base=4, finest=64, log2_size=8)
    field = HashTriplane(triplane, BOX, generator) if kind == "triplane" else FourierFeatures(BOX, 4)
    made = BasisAdjuster(field, CONDITIONS, config, generator)
    if trained:
        for parameter in (made.last_weight, made.last_bias):
            torch.nn.init.normal_(parameter, std=0.3, generator=generator)
        if isinstance(field, HashTriplane):
            torch.nn.init.normal_(field.tables, generator=generator)
    return made


def draw(*shape: int, seed: int = 2) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def relative(ours: Tensor, reference: Tensor) -> float:
    ours, reference = ours.detach().double(), reference.detach().double()
    return float((ours - reference).norm() / reference.norm().clamp_min(1e-12))


@pytest.mark.parametrize("kind", ["triplane", "fourier"])
def test_starts_as_the_identity_with_gradient_into_the_last_layer(kind: str) -> None:
    made = adjuster(kind, trained=False)
    offsets = made(draw(COUNT, 3), draw(CONDITIONS))
    assert torch.equal(offsets.rows, torch.zeros(COUNT, 10))
    (offsets.rows * draw(COUNT, 10)).sum().backward()
    for parameter in (made.last_weight, made.last_bias):
        assert parameter.grad is not None and parameter.grad.abs().max() > 0


@pytest.mark.parametrize("kind", ["triplane", "fourier"])
@pytest.mark.parametrize("rows", [GEOMETRY_ROWS, GEOMETRY_ROWS + COLOR_ROWS])
def test_contraction_equals_explicit_basis_times_latent(kind: str, rows: int) -> None:
    """Eq. 9–11: W·f with W built."""
    made, x, condition = adjuster(kind, replace(SIZES, rows=rows)), draw(COUNT, 3), draw(CONDITIONS)
    explicit = torch.einsum("nrl,l->nr", made.basis(x), made.latent(condition))
    offsets = made(x, condition)
    assert relative(offsets.rows, explicit) < 1e-5
    assert torch.equal(torch.cat((offsets.means, offsets.rotations, offsets.log_scales), -1), offsets.rows[:, :10])
    assert (offsets.colors is None) == (rows == 10)


def test_latent_vector_is_three_layers_with_rectifiers() -> None:
    """Eq. 10 written out in float64: two hidden layers with max(x, 0), a linear output (docs/paper.md, A8, A30)."""
    made, condition = adjuster(), draw(CONDITIONS)
    x = condition.double()
    layers = [layer for layer in made.latent_network if isinstance(layer, torch.nn.Linear)]
    for number, layer in enumerate(layers):
        x = layer.weight.detach().double() @ x + layer.bias.detach().double()
        x = x.clamp_min(0) if number < 2 else x
    assert [layer.out_features for layer in layers] == [16, 16, 6]
    assert torch.allclose(made.latent(condition).double(), x, atol=1e-6) and x.abs().max() > 0.05


@pytest.mark.parametrize("kind", ["triplane", "fourier"])
def test_cached_and_batched_equal_direct(kind: str) -> None:
    made, x, conditions = adjuster(kind), draw(COUNT, 3), draw(3, CONDITIONS)
    kept = made.cache(x)
    assert not kept.requires_grad
    batch = made(x, conditions)
    assert batch.rows.shape == (3, COUNT, 10)
    for number in range(3):
        direct = made(x, conditions[number]).rows
        assert relative(batch.rows[number], direct) < 1e-5
        assert relative(made.offsets(kept, made.latent(conditions[number])).rows, direct) < 1e-5


@pytest.mark.parametrize("kind", ["triplane", "fourier"])
@pytest.mark.parametrize("batch", [(), (2,)])
def test_fused_gradients_equal_float64_autograd(kind: str, batch: tuple[int, ...]) -> None:
    """Half of the rows have no gradient, as hidden Gaussians do."""
    made, x, condition = adjuster(kind), draw(COUNT, 3), draw(*batch, CONDITIONS)
    wide = adjuster(kind).double()
    upstream = draw(*batch, COUNT, 10, seed=3)
    upstream[..., ::2, :] = 0
    (made(x, condition).rows * upstream).sum().backward()
    expected = wide.offsets(wide.hidden(x.double()), wide.latent(condition.double()))
    (expected.rows * upstream).sum().backward()
    for (name, ours), reference in zip(made.named_parameters(), wide.parameters(), strict=True):
        assert ours.grad is not None and reference.grad is not None, name
        assert relative(ours.grad, reference.grad) < 3e-5, name


def test_fused_without_any_gradient_and_without_rows() -> None:
    made = adjuster()
    (made(draw(COUNT, 3), draw(CONDITIONS)).rows * 0).sum().backward()
    assert all(p.grad is None or torch.equal(p.grad, torch.zeros_like(p)) for p in made.parameters())
    assert made(torch.zeros(0, 3), draw(CONDITIONS)).rows.shape == (0, 10)


@pytest.mark.parametrize("threads", [2, 4])
def test_same_bits_for_any_number_of_threads(threads: int) -> None:
    before, found = torch.get_num_threads(), []
    x, condition, upstream = draw(5000, 3), draw(CONDITIONS), draw(5000, 10, seed=4)
    try:
        for count in (1, threads):
            torch.set_num_threads(count)
            made = adjuster()
            rows = made(x, condition).rows
            rows.backward(upstream)
            found.append([rows.detach(), *(p.grad for n, p in made.named_parameters() if not n.startswith("latent"))])
    finally:
        torch.set_num_threads(before)
    assert all(torch.equal(one, other) for one, other in zip(*found, strict=True))


def placed(dtype: torch.dtype = torch.float32) -> list[Tensor]:
    values = [draw(COUNT, 3), normalize(draw(COUNT, 4, seed=5), dim=-1), draw(COUNT, 3, seed=6).exp()]
    return [value.to(dtype).requires_grad_() for value in values]


@pytest.mark.parametrize("rotation", ["product", "add"])
def test_eq12_zero_offsets_change_nothing(rotation) -> None:
    before = placed()
    after = refine(*before, Offsets(torch.zeros(COUNT, 10)), rotation=rotation)
    for ours, reference in zip(after, before, strict=True):
        assert torch.allclose(ours, reference, atol=1e-6)


def test_eq12_term_by_term() -> None:
    means, quats, scales = placed(torch.float64)
    rows = 0.2 * draw(COUNT, 10, seed=7).double()
    after = refine(means, quats, scales, Offsets(rows), unit=0.01)
    assert torch.allclose(after.means, means + 0.01 * rows[:, :3])
    turn = normalize(rows[:, 3:7] + torch.tensor([1.0, 0, 0, 0], dtype=torch.float64), dim=-1)
    assert torch.allclose(after.quats, quaternion_multiply(turn, quats))
    assert torch.allclose(after.scales, scales * rows[:, 7:].exp())


def test_sign_of_the_quaternion_does_not_matter_for_products_only() -> None:
    """docs/paper.md, A4: `matrix_to_quaternion` flips signs between frames."""
    means, quats, scales = placed()
    offsets = Offsets(0.2 * draw(COUNT, 10, seed=8))
    turns = {
        rotation: [
            quaternion_to_matrix(refine(means, sign * quats, scales, offsets, rotation=rotation).quats)
            for sign in (1, -1)
        ]
        for rotation in ("product", "add")
    }
    assert torch.allclose(*turns["product"], atol=1e-5)
    assert not torch.allclose(*turns["add"], atol=1e-2)


@pytest.mark.parametrize("columns", [10, 13])
def test_compiled_refinement_equals_float64_autograd(columns: int) -> None:
    inputs, wide = placed(), placed(torch.float64)
    rows = (0.2 * draw(COUNT, columns, seed=9)).requires_grad_()
    wide_rows = rows.detach().double().requires_grad_()
    weights = [draw(COUNT, k, seed=10 + k) for k in (3, 4, 3)]
    ours, expected = refine(*inputs, Offsets(rows)), refine_in_torch(*wide, Offsets(wide_rows))
    torch.autograd.backward(tuple(ours), weights)
    torch.autograd.backward(tuple(expected), [weight.double() for weight in weights])
    for value, reference in zip(ours, expected, strict=True):
        assert relative(value.detach(), reference.detach()) < 1e-6
    for value, reference in zip([*inputs, rows], [*wide, wide_rows], strict=True):
        assert value.grad is not None and reference.grad is not None
        assert relative(value.grad, reference.grad) < 2e-6
