"""What a demo is to show, as `ggavatar-demo` and the API are told it. Does not import torch."""

from __future__ import annotations

from dataclasses import dataclass

from ggavatar.errors import InputError

IDENTITIES, BACKGROUNDS = (1, 2, 3, 4, 5), ("plain", "busy")


@dataclass(frozen=True)
class DemoSettings:
    """What to write; see the options of `ggavatar-demo`."""

    identity: int = 1
    frames: int = 600
    size: int = 512
    noise: float = 0.0
    background: str = "plain"
    seed: int = 0


def check_settings(settings: DemoSettings) -> None:
    """Raise `InputError` for a setting that cannot be, by the name of its flag."""
    if settings.identity not in IDENTITIES:
        raise InputError(f"expected --id from {IDENTITIES[0]} to {IDENTITIES[-1]}, found {settings.identity}")
    if not 1 <= settings.frames <= 99_999:
        raise InputError(f"expected --frames from 1 to 99999, found {settings.frames}")
    if not 32 <= settings.size <= 4096 or settings.size % 2:
        raise InputError(f"expected an even --size from 32 to 4096 px, found {settings.size}")
    if not 0 <= settings.noise <= 10:
        raise InputError(f"expected --noise from 0 (exact) to 10 (1 is realistic), found {settings.noise}")
    if settings.background not in BACKGROUNDS:
        raise InputError(f"expected --background {' or '.join(BACKGROUNDS)}, found {settings.background!r}")
    if settings.seed < 0:
        raise InputError(f"expected a --seed of 0 or more, found {settings.seed}")
