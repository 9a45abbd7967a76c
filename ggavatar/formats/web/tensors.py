"""The tensors of a web avatar: the head, its Gaussians and the adjuster as the page reads them (docs/web-avatar.md)."""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor
from torch.nn.functional import normalize

from ggavatar.formats.web.quantization import Quantized, dequantize, quantize
from ggavatar.gaussians.bound_parts import AdjusterParts, BoundParts
from ggavatar.head.head_pose import HeadPoses
from ggavatar.head.model import HeadModel

COARSEST_BASIS_STEP = 1e-4
"""Bases whose 8-bit steps exceed this have 16 bits, m."""
LOGITS = (-6.0, 9.0)
"""Opacity logits are limited to these: 0.0025 is invisible, 0.9999 opaque."""


class Tensors(dict[str, np.ndarray]):
    """Tensors by name, each with its scale beside it where it is quantized.

    Args:
        exact: Store floating-point numbers as they are.
    """

    def __init__(self, exact: bool) -> None:
        super().__init__()
        self.exact = exact

    def put(
        self, name: str, numbers: np.ndarray, bits: Literal[8, 16, 32], per: Literal["row", "column"] = "column"
    ) -> None:
        """Store a matrix: 8 or 16 bits with a scale per row or column, or float32."""
        array = np.ascontiguousarray(numbers, np.float32)
        if self.exact or bits == 32 or not array.size:
            self[name] = array
            return
        self[name], self[f"{name}.low"], self[f"{name}.step"] = quantize(array, bits, per)

    def numbers(self, name: str) -> np.ndarray:
        """A matrix as the page reads it."""
        if f"{name}.low" not in self:
            return self[name]
        return dequantize(Quantized(self[name], self[f"{name}.low"], self[f"{name}.step"]))

    def put_basis(self, name: str, basis: Tensor) -> None:
        """Store a basis [V, 3, E] coefficient by coefficient, in steps of at most a tenth of a millimeter."""
        rows = _array(basis).transpose(2, 0, 1).reshape(basis.shape[2], 3 * len(basis))
        widest = float(np.ptp(rows, axis=1).max(initial=0)) if rows.size else 0.0
        self.put(name, rows, 8 if widest / 255 <= COARSEST_BASIS_STEP else 16, "row")

    def put_indices(self, name: str, numbers: Tensor, below: int) -> None:
        """Store indices in 16 bits if they fit, else in 32."""
        self[name] = _array(numbers).astype(np.uint16 if below <= 1 << 16 else np.uint32)


def avatar_tensors(parts: BoundParts, exact: bool = False) -> Tensors:
    """All tensors but those of clips.

    Args:
        parts: The avatar, its Gaussians sorted by triangle (`chosen_rows`).
        exact: Store floating-point numbers as they are instead of in 8 or 16 bits.
    """
    tensors = Tensors(exact)
    _put_head(tensors, parts.head)
    _put_gaussians(tensors, parts)
    _put_poses(tensors, parts.poses)
    if parts.adjuster is not None:
        _put_adjuster(tensors, parts.adjuster)
    return tensors


def chosen_rows(parts: BoundParts, keep: Bool[Tensor, " N"]) -> BoundParts:
    """The parts of some Gaussians, sorted by their triangle, so that the page reads triangles in order."""
    rows = keep.nonzero().ravel()
    rows = rows[parts.face[rows].argsort(stable=True)]
    columns = ("face", "means", "quats", "log_scales", "opacity_logits", "harmonics")
    adjuster = parts.adjuster and dataclasses.replace(parts.adjuster, hidden=parts.adjuster.hidden[rows])
    return dataclasses.replace(parts, adjuster=adjuster, **{name: getattr(parts, name)[rows] for name in columns})


def rounded(parts: BoundParts, tensors: Tensors) -> BoundParts:
    """The parts as the page has them: with the numbers that the tensors give back."""

    def read(name: str) -> Tensor:
        array = tensors.numbers(name)
        return torch.from_numpy(array).to(parts.means)

    head, adjuster = parts.head, parts.adjuster

    def basis(name: str) -> Tensor:
        return read(name).view(-1, len(head.template), 3).permute(1, 2, 0)

    small_head = dataclasses.replace(
        head,
        template=read("template"),
        skinning_weights=read("skinning_weights"),
        expression_basis=basis("expression_basis"),
        eyelid_basis=basis("eyelid_basis"),
        pose_basis=basis("pose_basis"),
    )
    return dataclasses.replace(
        parts,
        head=small_head,
        means=read("means"),
        quats=read("quats"),
        log_scales=read("log_scales"),
        opacity_logits=read("opacity_logits")[:, 0],
        harmonics=read("harmonics").unflatten(1, (-1, 3)),
        adjuster=adjuster and dataclasses.replace(adjuster, hidden=read("adjuster.hidden")),
    )


def _put_head(tensors: Tensors, head: HeadModel) -> None:
    regressor = _array(head.joint_regressor)
    tensors.put("template", _array(head.template), 16)
    tensors.put_indices("faces", head.faces, len(head.template))
    tensors.put_basis("expression_basis", head.expression_basis)
    tensors.put_basis("pose_basis", head.pose_basis)
    tensors.put_basis("eyelid_basis", head.eyelid_basis)
    tensors.put("joints", regressor @ _array(head.template), 32)
    joints = np.einsum("jv,vce->ejc", regressor, _array(head.expression_basis))
    tensors.put("joint_basis", joints.reshape(len(joints), -1), 32)
    tensors.put("skinning_weights", _array(head.skinning_weights), 16)


def _put_gaussians(tensors: Tensors, parts: BoundParts) -> None:
    quats = normalize(parts.quats, dim=-1)
    quats = torch.where(quats[:, :1] < 0, -quats, quats)
    tensors.put_indices("face", parts.face, len(parts.head.faces))
    tensors.put("means", _array(parts.means), 16)
    tensors.put("quats", _array(quats), 8)
    tensors.put("log_scales", _array(parts.log_scales), 8)
    tensors.put("opacity_logits", _array(parts.opacity_logits.clamp(*LOGITS))[:, None], 8)
    tensors.put("harmonics", _array(parts.harmonics.flatten(1)), 8)


def _put_poses(tensors: Tensors, poses: HeadPoses) -> None:
    tensors.put("pose.reference", _array(poses.reference[:3].reshape(1, 12)), 32)
    tensors.put("pose.least", _array(poses.low[None]), 32)
    tensors.put("pose.most", _array(poses.high[None]), 32)


def _put_adjuster(tensors: Tensors, adjuster: AdjusterParts) -> None:
    tensors.put("adjuster.hidden", _array(adjuster.hidden), 8)
    tensors.put("adjuster.last_weight", _array(adjuster.last_weight.flatten(0, 1)), 32)
    tensors.put("adjuster.last_bias", _array(adjuster.last_bias), 32)
    for index, (weight, bias) in enumerate(adjuster.latent_layers):
        tensors.put(f"adjuster.latent.{index}.weight", _array(weight), 32)
        tensors.put(f"adjuster.latent.{index}.bias", _array(bias[None]), 32)


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().cpu().numpy()
