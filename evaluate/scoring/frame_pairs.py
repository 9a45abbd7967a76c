"""Pairs predictions with ground truth strictly by frame number."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from evaluate.scoring.frame_files import frame_files
from ggavatar.errors import InputError
from ggavatar.io.images import image_header
from ggavatar.text.names import clean_name


@dataclass(frozen=True)
class FramePair:
    """The files of one frame.

    Attributes:
        frame: Source frame number.
        prediction: Predicted image.
        truth: Ground-truth image.
        masks: Grayscale masks by region name; the person's mask is `foreground`.
    """

    frame: int
    prediction: Path
    truth: Path
    masks: Mapping[str, Path] = field(default_factory=dict)


def pair_folders(
    predictions: Path, truth: Path, masks: Path | None = None, regions: Path | None = None, frames: Sequence[int] = ()
) -> list[FramePair]:
    """Match the images of folders by the frame number in their names.

    Args:
        predictions: Folder of predictions.
        truth: Folder of ground-truth images.
        masks: Folder of person masks, or None.
        regions: Folder with one subfolder of masks per region, or None.
        frames: If given, exactly these frames are paired, and the folders may contain more.

    Returns:
        Pairs in ascending order of frame number.

    Raises:
        InputError: A frame is missing on one side, or the sizes of a pair differ.
    """
    rendered, truths = frame_files(predictions), frame_files(truth)
    wanted = sorted(set(frames)) or sorted(truths)
    if not frames:
        _require(set(rendered) - set(truths), rendered, truth, "no ground truth", "delete the surplus predictions")
    _require(set(wanted) - set(rendered), truths, predictions, "no prediction", "render the missing frames")
    _require(set(wanted) - set(truths), rendered, truth, "no ground truth", "choose frames that exist")
    folders = _mask_folders(masks, regions)
    found = {name: _masks_of(folder, wanted) for name, folder in folders.items()}
    pairs = [
        FramePair(n, rendered[n], truths[n], {name: files[n] for name, files in found.items() if n in files})
        for n in wanted
    ]
    for pair in pairs:
        require_equal_sizes(pair)
    return pairs


def require_equal_sizes(pair: FramePair) -> None:
    """Compare the image sizes in the headers of a pair's files; `InputError` if they differ."""
    size = image_header(pair.prediction)[:2]
    for path in (pair.truth, *pair.masks.values()):
        other = image_header(path)[:2]
        if other != size:
            raise InputError(
                f"frame {pair.frame}: {pair.prediction} is {size[0]}x{size[1]} px and {path} is {other[0]}x{other[1]} "
                "px; render at the size of the ground truth (nothing is resized silently)"
            )


def _require(unmatched: set[int], known: Mapping[int, Path], folder: Path, what: str, advice: str) -> None:
    if unmatched:
        listed = ", ".join(map(str, sorted(unmatched)[:8])) + (", …" if len(unmatched) > 8 else "")
        example = f" (for example {known[min(unmatched)].name})" if min(unmatched) in known else ""
        raise InputError(f"{folder}: {what} for {len(unmatched)} frames: {listed}{example}; {advice}")


def _mask_folders(masks: Path | None, regions: Path | None) -> dict[str, Path]:
    """Folders of masks by region name."""
    folders = {"foreground": masks} if masks else {}
    if regions is None:
        return folders
    names = region_names(regions)
    if not names:
        raise InputError(f"{regions}: expected one folder of masks per region, such as face/000123.png, found none")
    return folders | {name: regions / name for name in names}


def region_names(folder: Path) -> list[str]:
    """Names of the regions that a folder has masks of, one subfolder each, sorted; none if there is no such folder.

    Raises:
        InputError: A subfolder's name cannot be shown in a table.
    """
    names = sorted(path.name for path in folder.iterdir() if path.is_dir()) if folder.is_dir() else []
    for name in names:
        if clean_name(name) != name:
            raise InputError(f"{folder}: expected the name of a region, such as face, found {name!r:.80}; rename it")
    return names


def _masks_of(folder: Path, wanted: Sequence[int]) -> dict[int, Path]:
    files = frame_files(folder)
    _require(set(wanted) - set(files), {}, folder, "no mask", "add the missing masks (they may be empty)")
    return files
