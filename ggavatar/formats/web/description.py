"""What a page must know besides the tensors: the plain values of `ggavatar-web` 1 (docs/web-avatar.md)."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from ggavatar import __version__
from ggavatar.core import Drive
from ggavatar.formats.drives import mean_training_view
from ggavatar.formats.web.controls import control_description
from ggavatar.gaussians.bound_parts import AdjusterParts, BoundParts
from ggavatar.head.model import HeadModel
from ggavatar.training.run_folder import Run


def describe(run: Run, parts: BoundParts, drives: list[Drive]) -> dict[str, Any]:
    """Head, Gaussians, adjuster, camera, rest and controls; the caller adds title, clips and the embedding origin.

    Args:
        run: Where the parts are from.
        parts: As they are stored.
        drives: Those of the training frames.
    """
    head = parts.head
    camera = run.reader.camera(run.capture.frames[0])
    return {
        "method": run.method,
        "created_by": {"ggavatar": __version__, "step": run.step, "run_sha256": run.sha256},
        "head": {
            "version": head.version,
            "vertices": len(head.template),
            "triangles": len(head.faces),
            "expressions": head.expression_basis.shape[2],
            "pose_correctives": head.pose_basis.shape[2],
            "joint_names": list(head.joint_names),
            "parents": list(head.parents),
        },
        "gaussians": len(parts.face),
        "sh_degree": math.isqrt(parts.harmonics.shape[1]) - 1,
        "follows_face": parts.follows_face,
        "holds_torso": parts.holds_torso and parts.poses.in_camera,
        "moves_camera": parts.poses.in_camera,
        "adjuster": None if parts.adjuster is None else _adjuster(parts.adjuster),
        "background": [round(value, 6) for value in run.background.tolist()],
        "camera": {
            "width": camera.width,
            "height": camera.height,
            "intrinsics": camera.intrinsics[[0, 1, 0, 1], [0, 1, 2, 2]].tolist(),
        },
        "rest": {
            "view": mean_training_view(head, parts.poses, drives)[:3].flatten().tolist(),
            "center": _center(head).tolist(),
        },
        "controls": control_description(head, parts.poses, drives),
    }


def _adjuster(adjuster: AdjusterParts) -> dict[str, Any]:
    return {
        "rows": len(adjuster.last_bias),
        "latent": adjuster.last_bias.shape[1],
        "rank": adjuster.hidden.shape[1],
        "layers": len(adjuster.latent_layers),
        "unit": adjuster.unit,
        "color_unit": adjuster.color_unit,
        "sees_pose": adjuster.sees_pose,
    }


def _center(head: HeadModel) -> Tensor:
    """The point about which the view turns: the center of the skull's box, m."""
    skull = [head.regions[name] for name in ("face", "scalp", "ears") if name in head.regions]
    points = head.template[torch.cat(skull)] if skull else head.template
    return (points.amin(0) + points.amax(0)) / 2
