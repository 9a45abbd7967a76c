"""Export of a run as a web avatar: what goes into the file, what is refused, and how far the copy is from the run."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch

from ggavatar.core import Drive
from ggavatar.data.frames import evenly_spaced
from ggavatar.errors import InputError
from ggavatar.formats.licensed_heads import check_license
from ggavatar.formats.output_folder import check_output_file
from ggavatar.formats.web.clips import Clip, capture_clip, clip_arrays
from ggavatar.formats.web.container import MAX_GAUSSIANS, MAX_UNPACKED_BYTES, pack
from ggavatar.formats.web.description import describe
from ggavatar.formats.web.options import WebOptions, check_web_options
from ggavatar.formats.web.page import page
from ggavatar.formats.web.pruning import VIEWS, kept_rows, visible_weights
from ggavatar.formats.web.reduction import reduced
from ggavatar.formats.web.tensors import Tensors, avatar_tensors, chosen_rows, rounded
from ggavatar.gaussians.bound_parts import BoundParts, condition, posed
from ggavatar.io.atomic import write_text
from ggavatar.training.run_folder import Run

RANK_FRAMES = 160
"""Training frames whose offsets decide which hidden columns are kept."""
COMPARED_FRAMES = 4
"""Test frames in which the copy is compared with the run."""


class WebExport(NamedTuple):
    """What was written.

    Attributes:
        path: The page.
        bytes: Its size.
        gaussians: How many Gaussians it has, of `before`.
        before: How many the run has.
        psnr: Of the page's arrays against the run, mean of a few test frames, dB; None without test frames.
        notes: What its user must know.
    """

    path: Path
    bytes: int
    gaussians: int
    before: int
    psnr: float | None
    notes: tuple[str, ...]


def export_web(run: Run, options: WebOptions, path: Path, overwrite: bool, clips: Sequence[Clip] = ()) -> WebExport:
    """Write the page of a run.

    Args:
        run: The avatar.
        options: What goes into the page.
        path: The file to write.
        overwrite: Replace an earlier file.
        clips: Performances besides that of the run's capture; they come first.

    Raises:
        InputError: The method cannot be shown by a page, the head is licensed, the avatar is too large for a
            browser, or the file exists.
    """
    check_web_options(options)
    check_output_file(path, overwrite)
    whole = parts_of(run)
    check_license(run.folder, whole.head, "page", options.include_head_model)
    own = capture_clip(run, options.clip)
    drives = [run.reader.drive(number) for number in run.split.train] or [whole.head.neutral_drive()]
    small = _smaller(run, whole, options, drives)
    tensors = avatar_tensors(small, options.exact)
    described = [_put_clip(tensors, index, clip, small) for index, clip in enumerate([*clips, *([own] if own else [])])]
    _check_size(run, tensors, len(small.face))
    title = f"{run.capture.subject} · {run.method}"
    description = describe(run, small, drives) | {"title": title, "clips": described, "embed": options.embed}
    text = page(title, pack(tensors, description))
    write_text(path, text)
    psnr = _psnr(run, rounded(small, tensors))
    notes = (
        () if description["controls"]["arkit"] else (f"ARKit's curves have no map to the head {small.head.version}",)
    )
    return WebExport(path, path.stat().st_size, len(small.face), len(whole.face), psnr, notes)


def parts_of(run: Run) -> BoundParts:
    """The arrays of a run's avatar; `InputError` if its method does not offer them."""
    offer: Callable[[], BoundParts] | None = getattr(run.avatar, "bound_parts", None)
    if offer is None:
        raise InputError(
            f"{run.folder}: {run.method} cannot be shown by a web page, which poses Gaussians on triangles only; "
            "render a video with ggavatar-render instead"
        )
    return offer()


def _smaller(run: Run, whole: BoundParts, options: WebOptions, drives: Sequence[Drive]) -> BoundParts:
    """The parts without what cannot be seen, and with fewer hidden columns."""
    keep = torch.ones(len(whole.face), dtype=torch.bool, device=whole.face.device)
    numbers = evenly_spaced(run.split.train, VIEWS)
    if options.prune and numbers:
        views = [(run.reader.drive(number), run.reader.camera(number)) for number in numbers]
        weights = visible_weights(run.avatar, run.rasterize, views)
        keep = kept_rows(weights, whole.opacity_logits.sigmoid(), options.prune)
    small = chosen_rows(whole, keep)
    if small.adjuster is None or options.exact:
        return small
    adjuster = small.adjuster
    chosen = evenly_spaced(range(len(drives)), RANK_FRAMES)
    latents = torch.stack([adjuster.latent(condition(small, drives[index])) for index in chosen])
    return dataclasses.replace(small, adjuster=reduced(adjuster, latents, options.rank))


def _put_clip(tensors: Tensors, index: int, clip: Clip, parts: BoundParts) -> dict[str, Any]:
    """Store a clip and return its description."""
    for name, array in clip_arrays(clip, parts.poses.reference).items():
        tensors.put(f"clip.{index}.{name}", array, 16)
    return {"name": clip.name, "fps": clip.fps, "frames": list(clip.frames)}


def _check_size(run: Run, tensors: Tensors, count: int) -> None:
    total = sum(array.nbytes for array in tensors.values())
    if total > MAX_UNPACKED_BYTES or count > MAX_GAUSSIANS:
        raise InputError(
            f"{run.folder}: a page holds at most {MAX_UNPACKED_BYTES >> 20} MiB and {MAX_GAUSSIANS:,} Gaussians, found "
            f"{total / 2**20:.0f} MiB and {count:,}; leave out --exact, or use a larger --prune or a smaller clip"
        )


@torch.no_grad()
def _psnr(run: Run, parts: BoundParts) -> float | None:
    """PSNR of the page's avatar against the run, over the pixels of a few test frames, dB."""
    numbers = evenly_spaced(run.split.test, COMPARED_FRAMES)
    if not numbers:
        return None
    errors = []
    for number in numbers:
        drive = dataclasses.replace(run.reader.drive(number), frame=None)
        images = [
            run.rasterize(gaussians, run.reader.camera(number), run.background).image
            for gaussians in (run.avatar.gaussians(drive), posed(parts, drive))
        ]
        errors.append(float((images[0] - images[1]).square().mean()))
    return -10 * math.log10(max(sum(errors) / len(errors), 1e-12))
