"""Evaluation protocols: frozen, versioned and digested. Numbers are comparable only under the same digest."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from evaluate.metrics.catalogue import (
    FACES,
    METRICS,
    REGION_DEFINITION,
    REGION_METRICS,
    TEMPORAL,
    metric_of,
    require_metric,
)
from ggavatar.data.background import background_text, parse_background
from ggavatar.errors import InputError, nearest
from ggavatar.text.names import clean_text

GIVEN = "given"
"""Value of a field that depends on the caller's images and cannot be checked."""

DEFINITION_VERSION = 1
"""Version of the scoring arithmetic as a whole; raised when a fix changes numbers while all fields stay the same."""


@dataclass(frozen=True)
class Protocol:
    """Everything that determines a score apart from the images.

    Attributes:
        name: Base name; the id adds the version and every overridden field.
        version: Of the named protocol.
        split: Name of the capture's split whose test frames are scored, or `given`.
        background: `white`, `black`, `R,G,B` from 0 to 1 (sRGB), or `given`; both images are composited on it.
        mask: `as-stored` (the capture's soft or binary masks), `binary` (thresholded at 0.5) or `given`.
        region: `full`, or the region outside which both images are filled with the background before anything is
            measured; PSNR and L1 then count only the region's pixels (IMavatar's convention).
        resolution: `WIDTHxHEIGHT` in px at which images are compared, `native` (the capture's) or `given`.
        resize: Filter that brings the ground truth to `resolution`: `area` (OpenCV INTER_AREA).
        quantisation: `uint8-round`: both images are 8-bit, clamped and rounded to the nearest level.
        psnr_aggregation: `mean-of-images`; the pooled PSNR is always stored as well.
        metrics: Names of the metrics, of `evaluate.metrics.catalogue.METRICS` or of other packages.
        table_metrics: Subset shown in the main table.
        regions: Regions measured in addition, as `psnr@face`.
        test_time_optimisation: `none`: nothing is fitted to test frames.
        overrides: Names of the fields that differ from the named protocol, sorted.
    """

    # The digests of published protocols cover the names and values of these fields, British spelling included.
    name: str
    version: int = 1
    split: str = GIVEN
    background: str = GIVEN
    mask: str = GIVEN
    region: str = "full"
    resolution: str = GIVEN
    resize: str = "area"
    quantisation: str = "uint8-round"
    psnr_aggregation: str = "mean-of-images"
    metrics: tuple[str, ...] = ("psnr", "ssim", "ssim_3dgs", "lpips_alex")
    table_metrics: tuple[str, ...] = ("psnr", "ssim", "lpips_alex")
    regions: tuple[str, ...] = ()
    test_time_optimisation: str = "none"
    overrides: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in (*self.metrics, *self.table_metrics):
            require_metric(name)
        if missing := set(self.table_metrics) - set(self.metrics):
            raise InputError(f"--table-metrics: {', '.join(sorted(missing))} is not measured; add it to --metrics")
        _ = self.background_rgb, self.size

    @property
    def id(self) -> str:
        """Name, version and overridden fields; valid as a folder name."""
        changes = ",".join(f"{field}={_text(getattr(self, field))}" for field in self.overrides)
        return f"{self.name}-v{self.version}" + (f"+{changes}" if changes else "")

    @property
    def digest(self) -> str:
        """SHA-256 (hex) of `canonical_json`."""
        return hashlib.sha256(self.canonical_json().encode()).hexdigest()

    def canonical_json(self) -> str:
        """All fields and the full metric definitions as JSON: sorted keys, no spaces, ASCII."""
        return json.dumps(
            {**self.as_dict(), **self.definitions()}, sort_keys=True, separators=(",", ":"), ensure_ascii=True
        )

    def as_dict(self) -> dict[str, Any]:
        """The fields as plain JSON values."""
        return {field.name: _plain(getattr(self, field.name)) for field in dataclasses.fields(self)}

    def definitions(self) -> dict[str, Any]:
        """Definitions of the metrics and regions, which the digest covers."""
        words = {name: metric_of(name).definition for name in self.metrics}
        return {
            "definition_version": DEFINITION_VERSION,
            "metric_definitions": words,
            "region_definition": REGION_DEFINITION,
        }

    @property
    def background_rgb(self) -> tuple[float, float, float] | None:
        """Background color, sRGB in [0, 1]; None if it is `given`."""
        return None if self.background == GIVEN else parse_background(self.background)

    @property
    def size(self) -> tuple[int, int] | None:
        """Width and height in px; None if native or given."""
        if self.resolution in ("native", GIVEN):
            return None
        width, _, height = self.resolution.partition("x")
        if not (width.isdigit() and height.isdigit() and int(width) and int(height)):
            raise InputError(f"expected --resolution WIDTHxHEIGHT or native, found {self.resolution!r}")
        return int(width), int(height)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of all per-image values, including those of regions."""
        masked = tuple(f"{name}@{region}" for region in self.regions for name in self.metrics if name in REGION_METRICS)
        return self.metrics + masked

    def override(self, **changes: Any) -> Protocol:
        """The protocol with fields changed; those that differ from the named protocol become part of the id.

        Raises:
            InputError: Unknown field, or a value the field does not allow.
        """
        allowed = {field.name for field in dataclasses.fields(self)} - {"name", "version", "overrides"}
        for field in changes:
            if field not in allowed:
                suggestion, known = nearest(field, allowed), ", ".join(sorted(allowed))
                raise InputError(f"unknown protocol field {field!r}{suggestion}; known are {known}")
        if changes.get("background") not in (None, GIVEN):
            changes["background"] = background_text(parse_background(changes["background"]))
        base = PROTOCOLS.get(self.name, self)
        changed = dataclasses.replace(self, **changes)
        differing = tuple(sorted(field for field in allowed if getattr(changed, field) != getattr(base, field)))
        return dataclasses.replace(changed, overrides=differing)


# The metrics and regions of the named protocols; those of gaussian-avatars are what its code measures, as 3DGS does.
_PIXELS = ("psnr", "l1", "ssim", "ssim_luma", "ssim_3dgs", "ms_ssim")
_ALL = (*_PIXELS, "lpips_alex", "lpips_vgg", "lpips_squeeze", "lpips_vgg_unit_range", *TEMPORAL, *FACES)
_LAST_FRAMES_METRICS = ("psnr", "ssim", "ssim_3dgs", "lpips_alex", "lpips_vgg", *TEMPORAL)
CAPTURE_REGIONS = ("foreground", "face", "mouth", "eyes", "hair", "boundary")
"""Regions that can be found in a capture; folders of images may come with masks of others."""
_GAUSSIAN_AVATARS_METRICS = ("psnr", "ssim_3dgs", "lpips_vgg_unit_range")


def _on_white(name: str, split: str, **fields: Any) -> Protocol:
    """A protocol at 512×512 px on a white background, unless `fields` say otherwise."""
    common = {"background": "white", "mask": "as-stored", "resolution": "512x512"}
    return Protocol(name, split=split, **{**common, **fields})


_NAMED = (
    _on_white(
        "paper",
        "every-20th",
        metrics=("psnr", "l1", "ssim", "ssim_3dgs", "lpips_alex", "lpips_vgg", "lpips_vgg_unit_range"),
        table_metrics=("psnr", "ssim_3dgs", "lpips_alex"),
        regions=CAPTURE_REGIONS,
    ),
    _on_white("strict", "ratio-0.8", metrics=_ALL, regions=CAPTURE_REGIONS),
    _on_white("insta-350", "last-350", metrics=_LAST_FRAMES_METRICS),
    _on_white("flash-500", "last-500", metrics=_LAST_FRAMES_METRICS, table_metrics=("psnr", "ssim_3dgs", "lpips_vgg")),
    _on_white(
        "imavatar-face256",
        "file",
        region="face",
        resolution="256x256",
        metrics=("psnr", "l1", "ssim", "lpips_alex"),
    ),
    _on_white(
        "gaussian-avatars",
        "file",
        resolution="550x802",
        metrics=_GAUSSIAN_AVATARS_METRICS,
        table_metrics=_GAUSSIAN_AVATARS_METRICS,
    ),
    Protocol("folders"),
)

PROTOCOLS: Mapping[str, Protocol] = {protocol.name: protocol for protocol in _NAMED}


def protocol_by_name(name: str) -> Protocol:
    """A protocol by name, with or without its version: `paper`, `paper-v1`.

    Raises:
        InputError: There is no such protocol; the message suggests the nearest name.
    """
    for key, protocol in PROTOCOLS.items():
        if name in (key, protocol.id):
            return protocol
    raise InputError(f"unknown protocol {name!r}{nearest(name, PROTOCOLS)}; known are {', '.join(PROTOCOLS)}")


def protocol_from_dict(fields: Mapping[str, Any]) -> Protocol:
    """The protocol that a result file describes; id, digest and definitions are ignored.

    Raises:
        InputError: A field is missing or has an invalid value.
    """
    known = {field.name for field in dataclasses.fields(Protocol)}
    values: dict[str, Any] = {key: _frozen(value) for key, value in fields.items() if key in known}
    try:
        protocol = Protocol(**values)
    except TypeError as error:
        raise InputError(f"expected the fields of a protocol, found {sorted(fields)} ({error})") from error
    _require_same_definitions(protocol, fields.get("metric_definitions"))
    return protocol


def _require_same_definitions(protocol: Protocol, stored: object) -> None:
    """Raise `InputError` if a metric of another package meant something else when the result was written."""
    for name in protocol.metrics:
        if name in METRICS or not isinstance(stored, Mapping):
            continue
        if (then := stored.get(name)) != (now := metric_of(name).definition):
            raise InputError(
                f"the metric {name} was {clean_text(str(then))!r} when this was scored, and is {now!r} now; score the "
                "images again"
            )


def _plain(value: object) -> object:
    return list(value) if isinstance(value, tuple) else value


def _frozen(value: object) -> object:
    return tuple(value) if isinstance(value, list) else value


def _text(value: object) -> str:
    """A value in an id: readable if short, and without characters that are invalid in file names."""
    words = "-".join(value) if isinstance(value, tuple) else str(value)
    safe = re.sub(r"[^A-Za-z0-9._-]", "-", words)
    if len(safe) <= 40:
        return safe
    return f"{safe[:20]}-{hashlib.sha256(words.encode(errors='surrogatepass')).hexdigest()[:8]}"
