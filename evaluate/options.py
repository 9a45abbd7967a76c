"""Command line of ggavatar-eval."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from evaluate.protocols.protocol import PROTOCOLS, Protocol, named
from ggavatar.cli.version import handle_version_flag
from ggavatar.data.splits import split_name
from ggavatar.errors import InputError
from ggavatar.formats.source_options import GaussianFileOptions

Alias = tyro.conf.arg


@dataclass(frozen=True)
class Override:
    """Fields of the protocol to change; each one that differs enters the protocol's id."""

    split: str | None = None
    """Name of the split whose test frames are scored (every-20th, last-350, ratio-0.8, …)."""
    background: str | None = None
    """white, black or R,G,B in 0-255."""
    mask: Literal["as-stored", "binary"] | None = None
    """Use the capture's masks as they are, or thresholded at one half."""
    region: str | None = None
    """Measure inside this region only, such as face; full for the whole picture."""
    resolution: str | None = None
    """WIDTHxHEIGHT in px, or native."""
    metrics: tuple[str, ...] | None = None
    """What to measure, such as psnr ssim lpips_alex."""
    table_metrics: tuple[str, ...] | None = None
    """What the main table shows."""
    regions: tuple[str, ...] | None = None
    """Regions measured in addition, such as face mouth eyes hair boundary foreground."""

    def applied(self, protocol: Protocol) -> Protocol:
        """The protocol with the given fields changed."""
        changes = {name: value for name, value in vars(self).items() if value is not None}
        if self.metrics is not None and self.table_metrics is None:
            kept = tuple(name for name in protocol.table_metrics if name in self.metrics)
            changes["table_metrics"] = kept or self.metrics
        return protocol.override(**changes) if changes else protocol


@dataclass(frozen=True)
class Folders:
    """Score pictures of any origin instead of a run."""

    pred: Path | None = None
    """Folder of renders, named by frame number."""
    gt: Path | None = None
    """Folder of ground truths, named by frame number."""
    masks: Path | None = None
    """Folder of person masks."""
    region_masks: Path | None = None
    """Folder with one folder of masks per region: DIR/face/000123.png."""
    subject: str | None = None
    """Row label; the name of the folder above the ground truth by default."""
    method: str | None = None
    """Column label; the name of the folder of renders by default."""
    seed: int | None = None
    """Seed of the training, if the table shall tell several apart."""


@dataclass(frozen=True)
class Gates:
    """Checks that end the command with exit code 3."""

    fail_below: tuple[str, ...] = ()
    """Floors of means, such as psnr=30 ssim=0.9."""
    fail_above: tuple[str, ...] = ()
    """Ceilings of means, such as lpips=0.1."""
    compare: tuple[Path, ...] = ()
    """Earlier metrics.json files (or their folders) that must not be undercut."""
    tolerance: tuple[str, ...] = ()
    """How far a mean may fall behind --compare, such as psnr=0.1."""
    junit: Path | None = None
    """Write the checks as JUnit XML."""
    github: bool = False
    """Print the checks as annotations for GitHub."""


@dataclass(frozen=True)
class Options:
    """Measure avatars and print tables. Give run folders, result files (metrics.json), or --pred and --gt."""

    runs: tyro.conf.Positional[tuple[Path, ...]] = ()
    """Run folders, evaluation folders, metrics.json files or FILE.ply with --capture; any mixture."""
    labels: tuple[str, ...] = ()
    """Names of the methods in the table, one per run, in order; the runs' own by default."""
    table: bool = False
    """Print the table (its files are always written)."""
    protocol: str = "auto"
    """paper, strict, insta-350, flash-500, imavatar-face256, gaussian-avatars, folders; auto: by the run's split."""
    source: tyro.conf.OmitArgPrefixes[GaussianFileOptions] = field(default_factory=GaussianFileOptions)
    folders: tyro.conf.OmitArgPrefixes[Folders] = Folders()
    override: tyro.conf.OmitArgPrefixes[Override] = Override()
    gates: tyro.conf.OmitArgPrefixes[Gates] = Gates()
    output: Annotated[Path | None, Alias(aliases=["-o", "--output-dir"])] = None
    """Where tables go; beside the metrics of a single run by default."""
    layout: Literal["auto", "subjects", "ablation"] = "auto"
    """Rows are subjects (the paper's Table 1) or methods (its Table 2)."""
    with_paper: bool = False
    """Set the paper's rows below ours (their protocol is not stated); without runs, its Tables 1 and 2 alone."""
    no_report: bool = False
    """Leave out the HTML report, the comparison figure, the side-by-side video and the curves."""
    no_learned: Annotated[bool, Alias(aliases=["--no-lpips"])] = False
    """Leave out learned metrics (LPIPS, faces) even where their weights are at hand."""
    models: Path | None = None
    """Folder with weights of learned metrics; $GGAVATAR_MODELS by default."""
    device: str = "auto"
    """Where runs are rendered: auto, cpu, cuda."""
    again: bool = False
    """Score runs again whose results are up to date."""
    threads: int | None = None
    """Workers for scoring."""
    json: bool = False
    """Print a summary as JSON on the last line of the standard output."""
    quiet: Annotated[bool, Alias(aliases=["-q"])] = False
    """No progress, no list of files."""

    def base_protocol(self, split: str | None = None) -> Protocol:
        """The protocol by name with overrides; `auto` looks for the one whose split is the given one."""
        if self.protocol != "auto":
            return self.override.applied(named(self.protocol))
        if split is None:
            return self.override.applied(named("folders"))
        split = split_name(split)
        fitting = next((p for p in PROTOCOLS.values() if p.split == split and p.split != "file"), None)
        return self.override.applied(fitting or named("paper").override(split=split))


def parse(arguments: list[str] | None) -> Options:
    """Options from the command line; unknown flags end the program with code 2 and the nearest known one.

    Raises:
        InputError: Neither runs nor folders, or both, or half a pair.
    """
    handle_version_flag("ggavatar-eval", arguments)
    options = tyro.cli(Options, prog="ggavatar-eval", args=arguments, config=(tyro.conf.FlagCreatePairsOff,))
    given = (options.folders.pred is not None, options.folders.gt is not None)
    if any(given) and not all(given):
        lacking = "--gt" if given[0] else "--pred"
        raise InputError(f"expected both --pred and --gt, found no {lacking}; name the folder of the other pictures")
    if any(given) and options.runs:
        raise InputError("expected either run folders or --pred and --gt, found both; call the command twice")
    only_the_paper = options.with_paper and options.gates == Gates()
    if not any(given) and not options.runs and not only_the_paper:
        raise InputError("expected a run folder, a metrics.json, or --pred DIR --gt DIR; see ggavatar-eval --help")
    if options.labels and len(options.labels) != len(options.runs):
        found = f"{len(options.labels)} for {len(options.runs)} runs"
        raise InputError(f"expected one of --labels per run, found {found}; name them in the order of the runs")
    return options
