"""ggavatar-models: list, fetch and verify the files of pretrained models that the project does not ship."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from ggavatar.cli.page import CommandPage, parse
from ggavatar.cli.run import run_command
from ggavatar.errors import InputError
from ggavatar.pretrained.catalogue import MODELS, Model
from ggavatar.pretrained.resolve import ModelFinder, ModelUnavailable, files_of, model_named
from ggavatar.text.terminal import write_err, write_out


@dataclass(frozen=True)
class Arguments:
    """List the files of pretrained models; fetch the missing ones, or verify those that are here."""

    fetch: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME…")] = ()
    """Fetch these models, if they are not here."""
    all: bool = False
    """Fetch all models."""
    verify: bool = False
    """Check the SHA-256 of every file that is here."""
    models: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder searched first, before $GGAVATAR_MODELS and the user's cache."""
    offline: bool = False
    """Never use the network, as $GGAVATAR_OFFLINE=1."""


PAGE = CommandPage(
    program="ggavatar-models",
    options=Arguments,
    summary="List the files of pretrained models; fetch the missing ones, or verify those that are here.",
    examples=(
        ("ggavatar-models", "which models there are, which are here, and what they are for"),
        ("ggavatar-models --fetch vgg16 lpips_alex", "fetch two of them"),
        ("ggavatar-models --all --models models", "fetch all into a folder, for a computer without network"),
    ),
    groups={"what is done": ("fetch", "all", "verify"), "where the files are": ("models", "offline")},
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of ggavatar-models; returns the exit code (0 success, 1 failure, 2 missing or damaged file)."""
    return run_command(lambda: _models(parse(PAGE, arguments)), Arguments)


def _models(arguments: Arguments) -> int:
    finder = ModelFinder(arguments.models, arguments.offline)
    names = list(MODELS) if arguments.all else list(arguments.fetch)
    models = [model_named(name) for name in names]
    problems = [problem for name, _ in zip(names, models, strict=True) if (problem := _fetch(finder, name))]
    if arguments.verify:
        problems += [problem for name in MODELS if (problem := _verify(finder, name))]
    if not names and not arguments.verify:
        write_out(*(line for name, model in MODELS.items() for line in _entry(finder, name, model)))
    sys.stdout.flush()
    write_err(*(f"error: {problem}" for problem in problems[:-1]))
    if problems:
        raise InputError(problems[-1])
    return 0


def _entry(finder: ModelFinder, name: str, model: Model) -> tuple[str, str]:
    """Two lines on a model: where it is or how to get it, and what it is for."""
    here = files_of(model, finder.folders)
    size = here[0].stat().st_size if here else model.versions[0].size
    where = str(here[0]) if here else f"missing; ggavatar-models --fetch {name}"
    return f"{name:<20}{size / 1e6:7.1f} MB  {model.license:<28}{where}", f"{'':<32}{model.purpose}"


def _fetch(finder: ModelFinder, name: str) -> str | None:
    """Find or fetch a model and print its path; returns what is wrong."""
    try:
        write_out(f"{name}: {finder.find(name)}")
    except InputError as error:
        return str(error)
    return None


def _verify(finder: ModelFinder, name: str) -> str | None:
    """Verify the file of a model that the search finds and print the result; returns what is wrong."""
    if not files_of(MODELS[name], finder.folders):
        write_out(f"{name}: missing")
        return None
    try:
        write_out(f"{name}: verified, {finder.find(name)}")
    except ModelUnavailable:
        raise
    except InputError as error:
        write_out(f"{name}: damaged")
        return str(error)
    return None


if __name__ == "__main__":
    sys.exit(main())
