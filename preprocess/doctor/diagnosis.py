"""Diagnosis of a capture: measurements, and findings with the flag that fixes each."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from ggavatar.data.capture import Capture
from ggavatar.head.model import HeadModel
from ggavatar.io.atomic import write_text
from ggavatar.io.json_files import readable_json
from preprocess.doctor import quality
from preprocess.doctor.convention_ranking import (
    IOU_TIE_MARGIN,
    ConventionTest,
    Ranking,
    explained_by_frame_offset,
    photometric_alternative,
    prepare_convention_test,
    rank_hypotheses,
)
from preprocess.doctor.conventions import AS_IS, AXES, EYES, FIXES, OTHERS
from preprocess.doctor.frame_offset import find_offset
from preprocess.doctor.letterbox import black_bars, crop_flags
from preprocess.doctor.mask_check import FLAGS, check_masks, lies_on_faces, sampled_faces
from preprocess.evidence.repeats import frozen_runs, kind_of_repeats, rate_without_repeats
from preprocess.tracking.geometry.projection import one_torch_thread

REPORT, PREVIEW = "doctor.json", "preview.jpg"
EXPECTED_IOU = 0.5
JITTER_PIXELS, JITTER_DEGREES = 1.5, 0.6
MAX_EYE_DIVERGENCE = 0.6
"""Mean divergence of the eyes, degrees, from which they are most likely swapped."""


Faces = Mapping[int, np.ndarray]
"""Landmarks by row of the tracking, px."""


@dataclass(frozen=True)
class Finding:
    """One finding of the doctor.

    Attributes:
        code: Short, stable name for scripts.
        severity: "fault" (training would suffer or fail), "warning" or "note".
        message: The finding in words.
        flag: What to add to the ggavatar-prep command, if a flag fixes it.
    """

    code: str
    severity: str
    message: str
    flag: str = ""


@dataclass(frozen=True)
class Diagnosis:
    """All findings and the measurements behind them."""

    findings: tuple[Finding, ...]
    measures: Mapping[str, Any]

    def __repr__(self) -> str:
        """The verdict and a line for every finding."""
        lines = [f"  {one.severity}: {one.message}{f' [{one.flag}]' if one.flag else ''}" for one in self.findings]
        return "\n".join([f"Diagnosis({'healthy' if self.healthy else 'not healthy'})", *lines])

    @property
    def healthy(self) -> bool:
        """Whether there are no faults; warnings may remain."""
        return not any(finding.severity == "fault" for finding in self.findings)

    def json(self) -> dict[str, Any]:
        """The content of doctor.json."""
        listed = [dataclasses.asdict(finding) for finding in self.findings]
        return {
            "schema": "ggavatar-doctor",
            "version": 1,
            "healthy": self.healthy,
            "findings": listed,
            "measures": dict(self.measures),
        }


def examine(capture: Capture, head: HeadModel, faces: Faces | None = None) -> Diagnosis:
    """Take all measurements and derive the findings; takes a few seconds for a usual clip.

    Args:
        capture: The capture.
        head: Its head.
        faces: Landmarks by row, px; looked for where they are needed if None.
    """
    with one_torch_thread():
        return _examined(capture, head, cache(lambda: sampled_faces(capture) if faces is None else faces))


def _examined(capture: Capture, head: HeadModel, faces: Callable[[], Faces]) -> Diagnosis:
    findings: list[Finding] = []
    measures: dict[str, Any] = {}
    test = prepare_convention_test(capture, head)
    measures["silhouette_iou"] = float(test.overlaps(capture.tracking, AS_IS).mean())
    # Where mesh and masks agree, each confirms the other; else the faces in the images decide whether the masks can be
    # believed, before anything is concluded from them.
    known = {} if measures["silhouette_iou"] >= EXPECTED_IOU else faces()
    fault, words, measures["masks"] = check_masks(capture, known)
    if fault is None:
        named = _agreement(capture, head, test, faces, measures)
        findings += named
    else:
        named = []
        findings.append(Finding(f"masks-{fault}", "fault", words, FLAGS[fault]))
    measures["lens"] = quality.lens(capture)
    explained = any(finding.code in FIXES for finding in named)
    findings += _lens(measures["lens"], capture, explained)
    findings += _offset(capture, head, measures) if not explained else []
    findings += _eyes(capture, measures)
    findings += _jitter(capture, measures)
    findings += _image_quality(capture, head, measures, masks_are_credible=fault is None)
    findings += _coverage(capture, measures)
    error = quality.landmark_error(capture, head)
    if error is not None:
        measures["landmark_error_pixels"] = error
        findings += _landmarks(error, capture)
    return Diagnosis(tuple(findings), measures)


def _agreement(
    capture: Capture,
    head: HeadModel,
    test: ConventionTest,
    faces: Callable[[], Faces],
    measures: dict[str, Any],
) -> list[Finding]:
    """Whether mesh and masks agree, and if not, the convention that explains it."""
    axes = rank_hypotheses(test, capture.tracking, AXES)
    others = rank_hypotheses(test, capture.tracking, (AXES[0], *OTHERS))
    measures["hypotheses"] = [list(item) for item in axes.scores]
    measures["other_hypotheses"] = [list(item) for item in others.scores]
    own = dict(axes.scores)["as-is"]
    scores = dict(axes.scores) | dict(others.scores)
    named = _convention(capture, head, (axes, others), faces) or _photometric_convention(capture, head, scores)
    return named or _overlap(
        own, lies_on_faces(capture, head, capture.tracking, faces()) if own < EXPECTED_IOU else None
    )


def _convention(
    capture: Capture, head: HeadModel, rankings: Sequence[Ranking], faces: Callable[[], Faces]
) -> list[Finding]:
    """The convention the tracking was most probably written in, if not ours.

    None where the head lies on the faces as it is and would not with the mistake undone: then the masks are wrong.
    """
    candidates = [ranking for ranking in rankings if ranking.best is not None]
    if not candidates:
        return []
    chosen = max(candidates, key=lambda ranking: ranking.scores[0][1])
    assert chosen.best is not None
    before, after = dict(chosen.scores)["as-is"], chosen.scores[0][1]
    if after - before < IOU_TIE_MARGIN and explained_by_frame_offset(capture, head, chosen.best):
        return []
    corrected = chosen.best.correct(capture.tracking, capture.width, capture.height)
    if lies_on_faces(capture, head, capture.tracking, faces()) and not lies_on_faces(capture, head, corrected, faces()):
        return []
    message = (
        f"{chosen.best.description}: undoing that raises the overlap of mesh and mask from {before:.2f} to {after:.2f}"
    )
    return [Finding(chosen.best.name, "fault", message, f"--resume --fix {chosen.best.name}")]


def _photometric_convention(capture: Capture, head: HeadModel, scores: dict[str, float]) -> list[Finding]:
    """A convention mistake that shows only in how the face moves; not tested for the built-in tracker."""
    if capture.source.get("tracking", {}).get("tracker") == "built-in":
        return []
    better = photometric_alternative(capture, head, scores)
    if better is None:
        return []
    message = f"{better.description}: undoing that makes the face move with the mesh"
    return [Finding(better.name, "fault", message, f"--resume --fix {better.name}")]


def _overlap(own: float, on_faces: bool | None) -> list[Finding]:
    if own >= EXPECTED_IOU:
        return []
    if on_faces:
        message = (
            f"the mesh and the masks overlap poorly (IoU {own:.2f}, expected at least {EXPECTED_IOU}), but the mesh "
            "lies on the faces in the images: the masks are probably wrong; look at preview.jpg"
        )
        return [Finding("overlap", "fault", message, "--masks")]
    message = (
        f"the mesh and the masks overlap poorly (IoU {own:.2f}, expected at least {EXPECTED_IOU}) and "
        "no known convention mistake explains it"
    )
    return [
        Finding(
            "overlap",
            "fault",
            message + "; check that the tracking belongs to this video and this crop",
            "--tracking, --crop",
        )
    ]


def _lens(lens: Mapping[str, float], capture: Capture, explained: bool) -> list[Finding]:
    """Implausible focal length, pixel aspect ratio or principal point."""
    findings = [] if 6 <= lens["field_of_view"] <= 95 else [_focal(lens["field_of_view"], capture)]
    if not 0.95 <= lens["aspect"] <= 1.05:
        findings.append(
            Finding(
                "aspect",
                "warning",
                f"pixels are not square (fy / fx = {lens['aspect']:.3f}); width and height may be swapped",
            )
        )
    off = max(abs(lens["principal_x"]), abs(lens["principal_y"]))
    if off > 0.15 and not explained:
        where = f"x {lens['principal_x']:+.0%}, y {lens['principal_y']:+.0%} of the image"
        message = (
            f"the principal point is far from the video's center ({where}): it was not scaled or moved with the images"
        )
        findings.append(Finding("centre", "fault", message, "--resume --fix centre"))
    return findings


def _focal(field_of_view: float, capture: Capture) -> Finding:
    """What an unusual field of view means: an assumption of ours, a wrong --tracker.focal, or a wrong tracking."""
    report = capture.source.get("tracking", {})
    report = report if isinstance(report, Mapping) else {}
    if report.get("camera_is_assumed") is True:
        message = (
            f"the field of view of {field_of_view:.0f}° is assumed, since the tracker knows none: the head appears "
            "where it should, but its distance in m means nothing"
        )
        return Finding("focal", "note", message)
    message = f"implausible field of view of {field_of_view:.0f}° (6° to 95° are usual)"
    if report.get("tracker") == "built-in":
        flag = f"--resume --tracker.focal {quality.usual_focal(capture.tracking):.0f}"
        return Finding("focal", "fault", f"{message}: the focal length was given or estimated wrongly", flag)
    message += ": the tracking's focal length belongs to another image size; correct it in the tracker's output"
    return Finding("focal", "fault", message)


def _offset(capture: Capture, head: HeadModel, measures: dict[str, Any]) -> list[Finding]:
    """Tracking that leads or lags the video."""
    found = find_offset(head, capture.tracking, capture.frames, capture.frames, capture.image)
    measures["offset_change"] = {str(offset): score for offset, score in found.scores.items()}
    if found.offset == 0:
        return []
    late = "behind" if found.offset < 0 else "ahead of"
    message = f"the tracking runs {abs(found.offset)} frame{'s'[: abs(found.offset) > 1]} {late} the video"
    report = capture.source.get("tracking", {})
    now = report.get("offset", 0) if isinstance(report, Mapping) else 0
    wanted = (now if isinstance(now, int) else 0) + found.offset
    return [Finding("offset", "fault", message, f"--resume --frame-offset {wanted}")]


def _eyes(capture: Capture, measures: dict[str, Any]) -> list[Finding]:
    measures["eye_divergence_degrees"] = quality.eye_divergence(capture.tracking)
    if measures["eye_divergence_degrees"] < MAX_EYE_DIVERGENCE:
        return []
    message = (
        f"{EYES.description}: they point apart by {measures['eye_divergence_degrees']:.1f}° on average, "
        "which human eyes do not do"
    )
    return [Finding(EYES.name, "fault", message, f"--resume --fix {EYES.name}")]


def _jitter(capture: Capture, measures: dict[str, Any]) -> list[Finding]:
    measures["jitter"] = quality.jitter(capture.tracking)
    pixels, degrees = measures["jitter"]["pixels"], measures["jitter"]["degrees"]
    scale = max(capture.width, capture.height) / 512
    if pixels <= JITTER_PIXELS * scale and degrees <= JITTER_DEGREES:
        return []
    message = f"the tracking jitters by {pixels:.1f} px and {degrees:.2f}° from frame to frame; the avatar will be soft"
    return [Finding("jitter", "warning", message + "; smooth it over time in the tracker")]


def _image_quality(
    capture: Capture, head: HeadModel, measures: dict[str, Any], masks_are_credible: bool
) -> list[Finding]:
    measures |= quality.image_quality(capture, head)
    findings, count = [], len(capture.frames)
    if masks_are_credible and len(measures["blurred"]) > 0.05 * count:
        message = f"{len(measures['blurred'])} of {count} frames are blurred; use more light or a shorter exposure"
        findings.append(Finding("blur", "warning", message))
    if len(measures["repeated"]) > 0.05 * count:
        findings.append(_repeats(capture, measures["repeated"]))
    return findings + (_bars(capture, measures) if masks_are_credible else [])


def _repeats(capture: Capture, repeated: Sequence[int]) -> Finding:
    """Frames that repeat the one before, with the probable cause."""
    flags = np.isin(capture.frames, repeated)
    kind, message = kind_of_repeats(flags), f"{len(repeated)} of {len(flags)} frames repeat the one before"
    if kind == "rate":
        rate = rate_without_repeats(capture.fps, flags)
        message += f", evenly: the video was converted from a lower frame rate, about {rate:.4g} per second"
    elif kind == "frozen":
        stills = [f"{capture.frames[first]}–{capture.frames[last]}" for first, last in frozen_runs(flags)]
        message += f": the picture is frozen in frames {', '.join(stills[:6])}{', …' if len(stills) > 6 else ''}"
    else:
        message += " here and there: the recording doubled frames, or nothing moved"
    return Finding("frozen" if kind == "frozen" else "repeated", "warning", message, "--resume --drop-repeated")


def _bars(capture: Capture, measures: dict[str, Any]) -> list[Finding]:
    bars = black_bars(capture)
    measures["black_bars"] = list(bars)
    seen = [f"{thickness} px {side}" for side, thickness in zip(bars._fields, bars, strict=True) if thickness]
    if not seen:
        return []
    message = f"the masks count black bars around the video as person ({', '.join(seen)}); crop them"
    return [Finding("bars", "warning", message, crop_flags(capture, bars))]


def _coverage(capture: Capture, measures: dict[str, Any]) -> list[Finding]:
    measures["coverage"] = quality.coverage(capture.tracking)
    findings = []
    if len(capture.frames) < 200:
        message = (
            f"only {len(capture.frames)} frames; a good avatar needs several hundred, better 2000, so record longer"
        )
        findings.append(Finding("short", "warning", message))
    if measures["coverage"]["yaw_range"] < 8:
        message = (
            f"the head turns by only {measures['coverage']['yaw_range']:.0f}°; the avatar will look wrong from the side"
        )
        findings.append(Finding("yaw", "note", message))
    if measures["coverage"]["moving_expressions"] < 3:
        findings.append(
            Finding("expression", "warning", "the expression hardly changes; the avatar cannot learn facial motion")
        )
    return findings


def _landmarks(error: float, capture: Capture) -> list[Finding]:
    limit = 3 * max(capture.width, capture.height) / 512
    if error <= limit:
        return []
    message = (
        f"the mesh's landmarks are {error:.1f} px from those detected in the images (at most {limit:.1f} px expected)"
    )
    return [Finding("landmarks", "fault", message)]


def write_report(capture: Capture, diagnosis: Diagnosis) -> None:
    """Write doctor.json into the capture."""
    text = readable_json(plain_values(diagnosis.json()), indent=1)
    write_text(capture.folder / REPORT, text)


def plain_values(value: Any) -> Any:
    """The value with numpy numbers as Python numbers, and NaN and infinities as None."""
    if isinstance(value, Mapping):
        return {str(key): plain_values(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain_values(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return int(value) if isinstance(value, np.integer) else value
