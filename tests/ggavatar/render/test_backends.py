"""The choice of a backend, and the gsplat adapter with a stand-in for the library."""

from __future__ import annotations

import dataclasses
import importlib
import importlib.util
import sys
import types
from collections.abc import Iterator
from typing import Any

import pytest
import torch
from torch import Tensor

from ggavatar.core import Camera, Gaussians
from ggavatar.errors import InputError
from ggavatar.jit import device_kernels
from ggavatar.render import backends, reference
from ggavatar.render.backends import pick
from ggavatar.render.cpu import rasterizer
from tests.support.render_scenes import gradients, random_camera, random_gaussians


def test_the_cpu_gets_the_compiled_rasterizer() -> None:
    assert pick("cpu") is rasterizer.rasterize
    assert pick(torch.device("cpu"), "cpu") is rasterizer.rasterize
    assert pick("cpu", "reference") is reference.rasterize


@pytest.mark.parametrize(
    ("device", "backend", "remedy"),
    [
        ("cpu", "cpu", "pip install numba"),
        ("cuda", "gsplat", r"pip install ggavatar\[cuda\]"),
        ("cuda", "triton", "no triton here"),
    ],
)
def test_without_its_library_the_reference_runs_and_says_so(
    device: str, backend: str, remedy: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(backends, "importable", lambda module: False)
    monkeypatch.setattr(device_kernels, "missing", lambda kind: "no triton here")
    assert pick(device) is reference.rasterize
    assert remedy.replace("\\", "") in capsys.readouterr().err
    with pytest.raises(InputError, match=remedy):
        pick(device, backend)


@pytest.mark.skipif(importlib.util.find_spec("triton") is None, reason="triton is on Linux only")
def test_cuda_gets_a_triton_rasterizer_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """A new one for every user of it: it learns from what it renders."""
    from ggavatar.render.triton.rasterizer import TileRasterizer

    monkeypatch.setattr(device_kernels, "missing", lambda kind: "" if kind == "cuda" else "wrong device")
    first, second = pick("cuda"), pick("cuda:1", "triton")
    assert isinstance(first, TileRasterizer) and isinstance(second, TileRasterizer) and first is not second


def planted(monkeypatch: pytest.MonkeyPatch, backend: types.ModuleType | None) -> None:
    """An installed gsplat with this module for its compiled part."""
    for name in ("gsplat", "gsplat.cuda"):
        monkeypatch.setitem(sys.modules, name, types.ModuleType(name))
    sys.modules["gsplat"].rasterization = stand_in  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "gsplat.cuda._backend", backend)
    monkeypatch.delitem(sys.modules, "ggavatar.render.gsplat", raising=False)
    monkeypatch.setattr(device_kernels, "missing", lambda kind: "no triton here")


def test_gsplat_is_chosen_if_its_kernels_are_built_and_not_because_it_imports(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    compiled = types.ModuleType("gsplat.cuda._backend")
    planted(monkeypatch, compiled)
    for built, reason in ((None, "no CUDA toolkit found"), ("missing", "has no attribute '_C'")):
        if built is None:
            compiled._C = None  # type: ignore[attr-defined]
        else:
            del compiled._C
        assert pick("cuda") is reference.rasterize
        assert reason in capsys.readouterr().err
        with pytest.raises(InputError, match=r"gsplat cannot build its kernels .* install nvcc, g\+\+ and ninja"):
            pick("cuda", "gsplat")
    compiled._C = object()  # type: ignore[attr-defined]
    assert pick("cuda") is pick("cuda", "gsplat") is importlib.import_module("ggavatar.render.gsplat").rasterize
    monkeypatch.delitem(sys.modules, "ggavatar.render.gsplat")


@pytest.mark.parametrize(
    ("device", "backend"), [("cpu", "gsplat"), ("cpu", "triton"), ("cuda", "cpu"), ("cpu", "opengl")]
)
def test_impossible_choices_are_refused(device: str, backend: str) -> None:
    with pytest.raises(InputError):
        pick(device, backend)


def test_importable_says_no_to_missing_and_broken_modules(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "broken_for_pick.py").write_text("raise ImportError('no')\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert not backends.importable("broken_for_pick")
    assert not backends.importable("absent_for_pick")
    assert backends.importable("json")


def stand_in(**arguments: Any) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
    """gsplat.rasterization in the shapes of gsplat 1.5, drawn by the reference."""
    assert (
        arguments["render_mode"] == "RGB+D"
        and arguments["rasterize_mode"] == "classic"
        and arguments["packed"] is False
    )
    assert arguments["eps2d"] == 0.3 and arguments["near_plane"] == 0.01
    assert (
        arguments["viewmats"].shape == (1, 4, 4)
        and arguments["Ks"].shape == (1, 3, 3)
        and arguments["backgrounds"].shape == (1, 3)
    )
    cloud = Gaussians(
        *(arguments[name] for name in ("means", "quats", "scales", "opacities", "colors")), arguments["sh_degree"]
    )
    camera = Camera(arguments["Ks"][0], arguments["viewmats"][0], arguments["width"], arguments["height"])
    drawn = reference.rasterize(cloud, camera, arguments["backgrounds"][0])
    radii = drawn.radii.ceil().int()[:, None].repeat(1, 2)[None]
    meta = {"means2d": drawn.means2d[None], "radii": radii}
    # Gradients reach the batched tensor only if drawing depends on it, as it does in gsplat.
    image = drawn.image + 0 * meta["means2d"].sum() + (meta["means2d"] - meta["means2d"].detach()).sum() * 3
    return torch.cat((image, drawn.depth), -1)[None], drawn.alpha[None], meta


@pytest.fixture
def adapter() -> Iterator[Any]:
    """The adapter, loaded over the stand-in."""
    library = types.ModuleType("gsplat")
    library.rasterization = stand_in  # type: ignore[attr-defined]
    kept = {name: sys.modules.get(name) for name in ("gsplat", "ggavatar.render.gsplat")}
    sys.modules["gsplat"] = library
    sys.modules.pop("ggavatar.render.gsplat", None)
    yield importlib.import_module("ggavatar.render.gsplat")
    for name, module in kept.items():
        sys.modules.pop(name, None)
        if module is not None:
            sys.modules[name] = module


@pytest.mark.parametrize(("coefficients", "degree"), [(0, None), (16, None), (16, 1)])
def test_the_adapter_fits_the_contract(adapter: Any, coefficients: int, degree: int | None) -> None:
    camera, cloud = (
        random_camera(30, 20, torch.float32),
        random_gaussians(40, coefficients, torch.float32, degree=degree),
    )
    expected, _ = gradients(reference.rasterize, cloud, camera)
    found, leaves = gradients(adapter.rasterize, cloud, camera)
    for name in ("alpha", "depth", "means2d"):
        torch.testing.assert_close(getattr(found, name), getattr(expected, name))
    torch.testing.assert_close(found.image, expected.image)
    assert found.radii.shape == (40,) and ((found.radii > 0) == (expected.radii > 0)).all()
    # The stand-in adds 3 to the gradient of every position, for every channel and pixel, times the incoming gradient.
    generator = torch.Generator().manual_seed(7)
    incoming = torch.randn(20, 30, 3, generator=generator, dtype=torch.float64).sum() * 3
    assert leaves["means2d"].shape == (40, 2)
    torch.testing.assert_close(leaves["means2d"], incoming.expand(40, 2).double(), rtol=1e-3, atol=1e-3)


def test_the_adapter_refuses_nan(adapter: Any) -> None:
    cloud = random_gaussians(4, 0, torch.float32)
    cloud.scales[2, 1] = float("nan")
    with pytest.raises(InputError, match=r"gaussians\.scales"):
        adapter.rasterize(cloud, random_camera(10, 10, torch.float32), torch.ones(3))


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
@pytest.mark.parametrize("coefficients", [0, 16])
@pytest.mark.parametrize("backend", ["triton", "gsplat"])
def test_cuda_agrees_with_the_reference(backend: str, coefficients: int) -> None:
    """Opacities stay below 0.985: gsplat limits alpha at 0.999, we at 0.99.

    A pixel may differ by one Gaussian of alpha 1/255 that rounding puts on the other side of that limit: times a color
    that harmonics of these scenes keep below 2.5, 0.01. Gradients of such a pixel change with it.
    """
    if backend == "gsplat":
        pytest.importorskip("gsplat", reason="gsplat is an optional extra")
    camera = random_camera(67, 53, torch.float32)
    cloud = random_gaussians(200, coefficients, torch.float32, size=0.05)
    cloud = dataclasses.replace(cloud, opacities=0.985 * cloud.opacities)
    expected, slow = gradients(reference.rasterize, cloud, camera, torch.float64)
    draw = pick("cuda", backend)

    def on_device(gaussians: Gaussians, view: Camera, background: Tensor) -> Any:
        moved = Gaussians(*(getattr(gaussians, n).cuda() for n in ("means", "quats", "scales", "opacities", "colors")))
        return draw(moved, view, background)

    found, fast = gradients(on_device, cloud, camera)
    assert (found.image.cpu() - expected.image).abs().max() < 0.01
    assert (found.image.cpu() - expected.image).abs().mean() < 1e-5
    for name in ("means", "quats", "scales", "opacities", "colors"):
        assert (fast[name].cpu() - slow[name]).norm() < 0.01 * slow[name].norm(), name


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("gpu", "expected auto, cpu, cuda, cuda:N or mps, found 'gpu'"),
        ("cuda", "torch finds no CUDA device"),
        ("meta", "cannot allocate"),
        ("xla", "cannot allocate"),
    ],
)
def test_devices_that_do_not_work_here_are_refused(name: str, message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert backends.resolve_device("auto") == backends.resolve_device("cpu") == "cpu"
    with pytest.raises(InputError, match=message):
        backends.resolve_device(name)
