"""Command-line options of ggavatar-eval."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro

from evaluate.metrics.catalogue import METRICS
from evaluate.protocols.protocol import PROTOCOLS, Protocol, protocol_by_name
from ggavatar.cli.likely_device import device_default
from ggavatar.cli.page import CommandPage
from ggavatar.cli.page import parse as parse_page
from ggavatar.cli.typed import one_of
from ggavatar.data.splits import split_name
from ggavatar.errors import InputError
from ggavatar.formats.source_options import GaussianFileOptions
from ggavatar.text.names import clean_name


@dataclass(frozen=True)
class Override:
    """Protocol fields to change; each field that differs becomes part of the protocol's id."""

    split: str | None = None
    """Name of the split whose test frames are scored (every-20th, last-350, ratio-0.8, …), or file:PATH."""
    background: str | None = None
    """Color behind the person: white, black, or R,G,B from 0 to 1."""
    mask: Literal["as-stored", "binary"] | None = None
    """Use the capture's masks as they are, or thresholded at 0.5."""
    region: str | None = None
    """Measure only inside this region, such as face; full for the whole image."""
    resolution: str | None = None
    """WIDTHxHEIGHT in px, or native."""
    metrics: tuple[str, ...] | None = None
    """Metrics to measure, such as psnr ssim lpips_alex; those of other packages are columns of the main table."""
    table_metrics: tuple[str, ...] | None = None
    """Metrics shown in the main table."""
    regions: tuple[str, ...] | None = None
    """Regions measured in addition, such as face mouth eyes hair boundary foreground."""

    def apply_to(self, protocol: Protocol) -> Protocol:
        """The protocol with these fields changed."""
        changes = {name: value for name, value in vars(self).items() if value is not None}
        if self.split is not None:
            changes["split"] = split_name(self.split)  # where the list lies is no property of a protocol
        if self.metrics is not None and self.table_metrics is None:
            shown = (*protocol.table_metrics, *(name for name in self.metrics if name not in METRICS))
            kept = tuple(name for name in shown if name in self.metrics)
            changes["table_metrics"] = kept or self.metrics
        return protocol.override(**changes) if changes else protocol


@dataclass(frozen=True)
class Folders:
    """Score pictures of any origin: with --capture as a run of that capture is scored, or against a folder (--gt)."""

    pred: Path | None = None
    """Folder of pictures, named by source frame number; with --capture DIR or --gt DIR."""
    pred_as: tuple[str, ...] = ()
    """Folders of pictures to score beside the runs, as NAME=DIR; NAME@SUBJECT=DIR if the runs show several subjects."""
    gt: Path | None = None
    """Folder of ground-truth images, named by frame number."""
    masks: Path | None = None
    """With --gt: folder of person masks."""
    region_masks: Path | None = None
    """With --gt: folder with one folder of masks per region: DIR/face/000123.png."""
    subject: str | None = None
    """Row label; by default the capture's subject, or the name of the folder above the ground truth."""
    method: Annotated[str | None, tyro.conf.arg(aliases=["--label"])] = None
    """Column label; by default the name of the folder of pictures."""
    seed: int | None = None
    """Seed of the training, to tell several runs apart in the table."""


Difference = Literal["ground-truth", "protocol", "method", "preset", "length", "features", "settings", "tracking"]
"""What can make an earlier result incomparable."""


@dataclass(frozen=True)
class Gates:
    """Checks that make the command exit with code 3."""

    fail_below: tuple[str, ...] = ()
    """Smallest allowed means, such as psnr=30 ssim=0.9."""
    fail_above: tuple[str, ...] = ()
    """Largest allowed means, such as lpips=0.1."""
    compare: tuple[Path, ...] = ()
    """Earlier results that the new ones must not be worse than: runs, evaluation folders, metrics.json files, or files
    of --write-baseline."""
    tolerance: tuple[str, ...] = ()
    """How much worse than --compare a mean may be, such as psnr=0.1 l1=2% psnr@mouth=0.5; for regions twice as much,
    unless they are named."""
    allow_other: tuple[Difference, ...] = ()
    """What may differ from --compare (exit code 2 otherwise): ground-truth protocol method preset length features
    settings tracking."""
    write_baseline: Path | None = None
    """Write the means to this file, for --compare in later calls, if no check has failed."""
    junit: Path | None = None
    """Write the checks as JUnit XML to this file."""
    github: bool = False
    """Print failed checks as GitHub annotations with one summary, and append a table to $GITHUB_STEP_SUMMARY."""


@dataclass(frozen=True)
class Options:
    """Measure avatars and write tables. Give run folders, result files (metrics.json), or --pred with --capture."""

    runs: tyro.conf.Positional[tuple[Path, ...]] = ()
    """Run folders, evaluation folders, metrics.json files, or FILE of Gaussians with --capture, in any combination."""
    labels: tuple[str, ...] = ()
    """Names of the methods in the table, one per run, in order; by default the runs' own."""
    table: bool = False
    """Print the tables (their files are always written)."""
    protocol: str = "auto"
    """paper, strict, insta-350, flash-500, imavatar-face256, gaussian-avatars or folders; auto: by the run's split."""
    source: tyro.conf.OmitArgPrefixes[GaussianFileOptions] = field(default_factory=GaussianFileOptions)
    folders: tyro.conf.OmitArgPrefixes[Folders] = Folders()
    override: tyro.conf.OmitArgPrefixes[Override] = Override()
    gates: tyro.conf.OmitArgPrefixes[Gates] = Gates()
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o", "--output-dir"])] = None
    """Output folder of the tables; by default the run's folder, evaluation/ for several runs, PRED-evaluation/ for
    --pred with --gt, PRED-evaluation/eval/PROTOCOL-ID/ for --pred with --capture. The scores of pictures are
    written below it too; without it, beside the pictures in PRED-evaluation/eval/."""
    reenact: tuple[Path, ...] = ()
    """Captures whose performances drive the avatars of the runs: how much of each face's expression arrives; measured
    on the avatars' own test frames too."""
    layout: Literal["auto", "subjects", "ablation"] = "auto"
    """One row per subject (the paper's Table 1) or per method (its Table 2)."""
    with_paper: bool = False
    """Add the paper's rows below ours (their protocol is not stated); without runs, write its Tables 1 and 2 alone."""
    paper_subjects: tuple[str, ...] = ()
    """The paper's subject for each of ours, as NAME=ID1,NAME=ID2: its numbers stand in the same lines, marked, and are
    not ranked with ours."""
    no_report: bool = False
    """Skip the HTML report, the comparison figure, the side-by-side video and the curves."""
    no_learned: Annotated[bool, tyro.conf.arg(aliases=["--no-lpips"])] = False
    """Skip learned metrics (LPIPS, faces) even if their weights are available."""
    models: Path | None = None
    """Folder searched first for the weights of learned metrics, before $GGAVATAR_MODELS and the user's cache."""
    offline: bool = False
    """Never download weights, as $GGAVATAR_OFFLINE=1."""
    device: str = "auto"
    """Device on which runs are rendered: auto, cpu, cuda, cuda:N or mps."""
    again: bool = False
    """Render and score again even if the results are up to date."""
    threads: int | None = None
    """Threads for scoring."""
    json: bool = False
    """Print a JSON summary as the last line of standard output."""
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False
    """Print neither progress nor the list of files."""

    @property
    def split_rule(self) -> str | None:
        """The list of frames in a file that --split names, as file:PATH; None for other splits."""
        split = self.override.split
        return split if split is not None and split.startswith("file:") else None

    def base_protocol(self, split: str | None = None) -> Protocol:
        """The chosen protocol with overrides; `auto` takes the one whose split equals `split`."""
        if self.protocol != "auto":
            return self.override.apply_to(protocol_by_name(self.protocol))
        if split is None:
            return self.override.apply_to(protocol_by_name("folders"))
        split = split_name(split)
        fitting = next((p for p in PROTOCOLS.values() if p.split == split and p.split != "file"), None)
        return self.override.apply_to(fitting or protocol_by_name("paper").override(split=split))


PAGE = CommandPage(
    program="ggavatar-eval",
    options=Options,
    summary="Measure avatars and write tables, figures and a report; check them against limits or earlier results.",
    examples=(
        ("ggavatar-eval runs/alice --table", "score a run on its test frames and print the table"),
        (
            "ggavatar-eval --pred renders --capture captures/alice --label mine --table --with-paper",
            "pictures of your own beside the paper's rows",
        ),
        ("ggavatar-eval runs/alice --compare baseline.json --tolerance psnr=0.1", "fail a build that got worse"),
    ),
    groups={
        "output": ("table", "output", "layout", "labels", "no_report", "json", "quiet"),
        "what is measured": ("protocol", *(field.name for field in fields(Override)), "no_learned", "reenact"),
        "the paper's numbers": ("with_paper", "paper_subjects"),
        "pictures of any origin": tuple(field.name for field in fields(Folders)),
        "gates (exit code 3)": tuple(field.name for field in fields(Gates)),
        "how it is computed": ("capture", "device", "threads", "again", "models", "offline"),
        "a file of Gaussians in place of a run": ("axes", "scales", "opacities", "head_model", "flame_params"),
    },
    defaults=device_default,
    checks={"protocol": one_of("--protocol", ("auto", *PROTOCOLS))},
)


def parse(arguments: list[str] | None) -> Options:
    """Parse the command line; an unknown flag exits with code 2 and suggests the nearest known one.

    Raises:
        InputError: Neither runs nor folders, or flags that contradict one another.
    """
    options = _with_clean_names(parse_page(PAGE, arguments))
    _check_sources(options)
    if options.labels and len(options.labels) != len(options.runs):
        found = f"{len(options.labels)} for {len(options.runs)} runs"
        raise InputError(f"expected one label per run in --labels, found {found}; list them in the order of the runs")
    return options


def _with_clean_names(options: Options) -> Options:
    """The options with clean names; those within --pred-as and --paper-subjects are cleaned where these are read."""
    folders = options.folders
    subject, method = (name if name is None else clean_name(name) for name in (folders.subject, folders.method))
    labels = tuple(map(clean_name, options.labels))
    return replace(options, labels=labels, folders=replace(folders, subject=subject, method=method))


def _check_sources(options: Options) -> None:
    """Check that runs, pictures, capture and ground truth fit together."""
    folders, capture = options.folders, options.source.capture
    if folders.pred is not None and folders.gt is None and capture is None:
        raise InputError(
            "expected --capture DIR (scored as a run of that capture) or --gt DIR beside --pred, found no --gt; pass "
            "one of them"
        )
    if folders.gt is not None and folders.pred is None:
        raise InputError("expected both --pred and --gt, found no --pred; pass the folder of the other images")
    if folders.gt is not None and capture is not None:
        raise InputError("expected --capture or --gt, found both; the capture has its own ground truth: leave --gt out")
    if capture is not None and (folders.masks or folders.region_masks):
        raise InputError(
            "expected --masks and --region-masks with --gt only, found --capture; its masks are used, leave them out"
        )
    if folders.pred is not None and (options.runs or folders.pred_as):
        raise InputError(
            "expected either runs or --pred, found both; to score pictures beside runs, pass --pred-as NAME=DIR"
        )
    only_paper = options.with_paper and options.gates == Gates()
    if folders.pred is None and not folders.pred_as and not options.runs and not only_paper:
        raise InputError(
            "expected a run folder, a metrics.json, or --pred DIR with --capture DIR or --gt DIR; see "
            "ggavatar-eval --help"
        )
