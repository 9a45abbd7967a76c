"""Masks of face, mouth, eyes and hair for the test frames of a run, from its tracked head mesh."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import UInt8

from evaluate.metrics.regions import MESH_REGIONS, hair_region, mesh_regions
from evaluate.scoring.frame_files import frame_file
from ggavatar.core import Camera, Drive
from ggavatar.data.capture import Capture
from ggavatar.geometry.transforms import project
from ggavatar.head.files import load_head
from ggavatar.head.model import HeadModel
from ggavatar.io.images import read_gray, write_png


@runtime_checkable
class FrameReader(Protocol):
    """Drives and cameras by source frame number, as in `ggavatar.data.frames.Frames`."""

    def drive(self, number: int) -> Drive:
        """Drive of a frame."""
        ...

    def camera(self, number: int) -> Camera:
        """Camera of a frame, at the capture's size."""
        ...


def write_region_masks(
    capture: Capture, reader: FrameReader, folder: Path, frames: Sequence[int], wanted: Sequence[str]
) -> list[str]:
    """Write `regions/NAME/000123.png` beside the predictions and return the names of the regions.

    Args:
        capture: The capture, whose head is used.
        reader: Its drives and cameras.
        folder: Folder with the person's `masks/`.
        frames: Source frame numbers.
        wanted: Regions of the protocol; those not derived from the mesh (foreground, boundary) are skipped.

    Returns:
        Regions for which the head model has vertex sets; others cannot be measured.
    """
    names = [name for name in wanted if name in (*MESH_REGIONS, "hair")]
    if not names:
        return []
    head = load_head(capture.head_path)
    written: set[str] = set()
    for number in frames:
        person = read_gray(frame_file(folder / "masks", number))
        masks = frame_regions(head, reader.drive(number), reader.camera(number), person)
        for name in names:
            if name in masks:
                write_png(frame_file(folder / "regions" / name, number), masks[name])
                written.add(name)
    return sorted(written)


@torch.inference_mode()
def frame_regions(
    head: HeadModel, drive: Drive, camera: Camera, person: UInt8[np.ndarray, "H W"]
) -> Mapping[str, UInt8[np.ndarray, "H W"]]:
    """Masks by region of one frame, 255 inside, at the size of the person's mask.

    Args:
        head: Head model of the capture.
        drive: Drive of the frame.
        camera: Camera of the frame, at the capture's size.
        person: Person mask; hair is its part above and beside the face.
    """
    height, width = person.shape
    seen = camera.resized(width, height)
    cpu = [value.detach().cpu() for value in (seen.intrinsics, seen.world_to_camera)]
    vertices = head.vertices(_on_cpu(drive))
    depth = (vertices @ cpu[1][:3, :3].T + cpu[1][:3, 3])[:, 2]
    sets = {name: rows.numpy() for name, rows in head.regions.items()}
    masks = mesh_regions(project(vertices, *cpu).numpy(), depth.numpy(), head.faces.numpy(), sets, (width, height))
    found = {name: mask for name, mask in masks.items() if name in MESH_REGIONS}
    if "scalp" in masks and "face" in masks:
        found["hair"] = hair_region(
            person, masks["scalp"], np.maximum(masks["face"], masks.get("below", masks["face"]))
        )
    return found


def _on_cpu(drive: Drive) -> Drive:
    """The drive on the CPU, like the head model."""
    names = ("expression", "joint_rotations", "eyelids", "translation", "head_to_camera")
    return dataclasses.replace(drive, **{name: getattr(drive, name).detach().cpu() for name in names})
