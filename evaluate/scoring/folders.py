"""Scores of a folder of images against a folder of ground truth."""

from __future__ import annotations

from collections.abc import Callable

from evaluate.options import Options
from evaluate.protocols.protocol import Protocol
from evaluate.protocols.results import Evaluation
from evaluate.protocols.setup import Setup
from evaluate.scoring.accumulator import Labels
from evaluate.scoring.frame_pairs import pair_folders, region_names
from evaluate.scoring.score import face_metrics, learned_metrics, score
from ggavatar.errors import InputError
from ggavatar.pretrained.resolve import ModelFinder
from ggavatar.text.names import clean_name


def score_folders(options: Options, progress: Callable[[int, int], None] | None = None) -> Evaluation:
    """Score the folders of --pred and --gt; `InputError` on any mismatch."""
    folders = options.folders
    if folders.pred is None or folders.gt is None:
        raise InputError("expected --pred and --gt")
    protocol = folder_protocol(options)
    pairs = pair_folders(folders.pred, folders.gt, folders.masks, folders.region_masks)
    names = (
        folders.subject or clean_name(folders.gt.resolve().parent.name),
        folders.method or clean_name(folders.pred.resolve().name),
    )
    provenance = {"predictions": str(folders.pred), "ground_truth": str(folders.gt)}
    labels = Labels(*names, seed=folders.seed, provenance=provenance, setup=Setup("elsewhere"))
    models = ModelFinder(options.models, options.offline)
    learned = None if options.no_learned else learned_metrics(protocol, models)
    faces = None if options.no_learned else face_metrics(protocol, models)
    return score(pairs, protocol, labels, learned, faces, options.threads, progress)


def folder_protocol(options: Options) -> Protocol:
    """The protocol for two folders: fields that they cannot prove are `given`, regions are those with masks."""
    protocol = options.base_protocol()
    if protocol.name != "folders":
        protocol = protocol.override(split="given", resolution="given", mask="given")
    folders = options.folders
    if options.override.regions is not None:
        return protocol
    known: tuple[str, ...] = ("foreground", "boundary") if folders.masks else ()
    if folders.region_masks:
        known += tuple(region_names(folders.region_masks))
    return protocol.override(regions=known)
