"""The identity basis of the procedural head, as differences of heads."""

from __future__ import annotations

import torch
from torch import Tensor

from ggavatar.head.procedural.model import procedural_head, procedural_names


def identity_basis() -> Tensor:
    """Displacement of every vertex per unit of every identity coefficient [V, 3, I], m."""
    generic = procedural_head().template.double()
    units = torch.eye(len(procedural_names()[1])).tolist()
    return torch.stack([procedural_head(unit).template.double() - generic for unit in units], dim=2).float()
