"""Options of `ggavatar-export --format web`. Does not import torch."""

from __future__ import annotations

import re
from dataclasses import dataclass

from ggavatar.errors import InputError, nearest

CLIPS = ("test", "train", "all", "none")
_ORIGIN = re.compile(r"https?://[A-Za-z0-9.\-]+(:\d{1,5})?|https?://\[[0-9a-fA-F:.]+\](:\d{1,5})?")
FROM_DISK = "null"
"""The origin of pages that are opened from the disk."""


@dataclass(frozen=True)
class WebOptions:
    """Options of --format web."""

    clip: str = "test"
    """Web: frames of the capture to play: test, train, all or none."""
    prune: float = 0.001
    """Web: leave out the least visible Gaussians, which hold this share of the visible weight; 0 keeps all."""
    rank: int = 16
    """Web: columns kept of the adjuster's hidden layer."""
    exact: bool = False
    """Web: store every number as float32 (five times the size) and all columns; for comparisons."""
    embed: str | None = None
    """Web: origin of pages that may drive the avatar by messages, such as https://example.org; "null" for pages opened
    from the disk."""
    include_head_model: bool = False
    """Web and avatar: pass on a licensed head model with the file; only where its license allows that."""


def check_web_options(options: WebOptions) -> None:
    """Raise an `InputError` for options that cannot be."""
    if not 0 <= options.prune < 0.5:
        raise InputError(f"expected --prune from 0 to 0.5, found {options.prune:g}; 0.001 is the default")
    if not 1 <= options.rank <= 256:
        raise InputError(f"expected --rank from 1 to 256, found {options.rank}; 16 is the default")
    if options.embed is not None and options.embed != FROM_DISK and not _ORIGIN.fullmatch(options.embed):
        raise InputError(
            f"expected --embed with the origin of a site, such as https://example.org (no path), or {FROM_DISK} for "
            f"pages opened from the disk, found {options.embed!r}"
        )
    if options.clip not in CLIPS:
        raise InputError(f"expected --clip {', '.join(CLIPS)}, found {options.clip!r}{nearest(options.clip, CLIPS)}")
