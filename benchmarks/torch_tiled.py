"""The baseline of the benchmark, a tiled rasterizer in plain PyTorch: vectorized binning, then a loop over tiles.

As fast as this design gets: only Gaussians that overlap a tile are blended there, all lists come from one sort, each
tile blends with one matrix product, and autograd computes the gradients.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ggavatar.core import Camera, Gaussians, Rendering
from ggavatar.render.projection import Projected, project, visible
from ggavatar.render.reference import alphas_at, blend_weights, colors_of

TILE = 16


def rasterize(gaussians: Gaussians, camera: Camera, background: Tensor) -> Rendering:
    """Rasterize with the same contract and numerics as `ggavatar.render.reference.rasterize`."""
    projected = project(gaussians, camera)
    is_visible = visible(projected, gaussians.opacities, camera)
    features = torch.cat((colors_of(gaussians, camera), projected.depths[:, None]), dim=1)
    rows, starts = _tile_lists(projected, is_visible, camera)
    per_row = torch.cat((projected.means2d, projected.conics, gaussians.opacities[:, None], features), dim=1)
    tiles_x, tiles_y = -(-camera.width // TILE), -(-camera.height // TILE)
    bounds = starts.tolist()
    tiles = []
    for tile in range(tiles_x * tiles_y):
        found = per_row[rows[bounds[tile] : bounds[tile + 1]]]
        tiles.append(_blend_tile(found, tile % tiles_x, tile // tiles_x))
    grid = torch.stack(tiles).view(tiles_y, tiles_x, TILE, TILE, 5).permute(0, 2, 1, 3, 4)
    blended = grid.reshape(tiles_y * TILE, tiles_x * TILE, 5)[: camera.height, : camera.width]
    image = blended[..., :3] + blended[..., 4:] * background
    radii = torch.where(is_visible, projected.extents.amax(-1), 0)
    return Rendering(image, 1 - blended[..., 4:], blended[..., 3:4], projected.means2d, radii)


@torch.no_grad()
def _tile_lists(projected: Projected, is_visible: Tensor, camera: Camera) -> tuple[Tensor, Tensor]:
    """Rows of all tiles in sequence, front to back within each, and the start of every tile."""
    tiles_x, tiles_y = -(-camera.width // TILE), -(-camera.height // TILE)
    limit = torch.tensor([tiles_x, tiles_y])
    order = torch.argsort(projected.depths, stable=True)
    order = order[is_visible[order]]
    low = ((projected.means2d - projected.extents)[order] / TILE).floor().long().clamp_min(0)
    high = torch.minimum(((projected.means2d + projected.extents)[order] / TILE).floor().long() + 1, limit)
    spans = (high - low).clamp_min(0)
    counts = spans.prod(-1)
    owner = torch.repeat_interleave(torch.arange(len(order)), counts)
    within = torch.arange(len(owner)) - (counts.cumsum(0) - counts)[owner]
    width = spans[owner, 0]
    tile = (low[owner, 1] + within // width) * tiles_x + low[owner, 0] + within % width
    by_tile = torch.argsort(tile, stable=True)
    starts = torch.zeros(tiles_x * tiles_y + 1, dtype=torch.long)
    starts[1:] = torch.bincount(tile, minlength=tiles_x * tiles_y).cumsum(0)
    return order[owner[by_tile]], starts


def _blend_tile(rows: Tensor, column: int, row: int) -> Tensor:
    """Blended features and remaining transmittance [256, 5] of one tile."""
    if len(rows) == 0:
        return torch.cat((rows.new_zeros(TILE * TILE, 4), rows.new_ones(TILE * TILE, 1)), dim=1)
    step = torch.arange(TILE, dtype=rows.dtype) + 0.5
    pixels = torch.cartesian_prod(row * TILE + step, column * TILE + step).flip(-1)
    alphas = alphas_at(pixels, rows[:, :2], rows[:, 2:5], rows[:, 5])
    weights, transmittance = blend_weights(alphas)
    return torch.cat((weights @ rows[:, 6:], transmittance[:, None]), dim=1)
