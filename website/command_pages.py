"""A page for each command, made of the same `CommandPage` as its `--help`."""

from __future__ import annotations

import html
import re
from collections.abc import Sequence

from evaluate import options as evaluation
from evaluate.rendering import options as rendering
from evaluate.viewer import options as viewer
from ggavatar.cli import export, models, sweep, train
from ggavatar.cli.page import CommandPage, explained
from preprocess.cli import demo, doctor, prep

PAGES: dict[str, CommandPage] = {
    module.PAGE.program: module.PAGE
    for module in (demo, prep, doctor, train, sweep, rendering, evaluation, export, viewer, models)
}
"""What every command says about itself, by its name."""
INTRODUCTION = """# Commands

Made from the parsers themselves when this site is built. Every command has `--help`, which says the same on the machine
at hand, and `--version`. Exit codes: 0 success · 1 runtime failure · 2 usage error or bad input · 3 a gate failed ·
130 / 143 interrupted, after saving.

| command | |
|---|---|
"""
MARKUP = re.compile(r"([\\`*_{}\[\]#|])")


def command_pages() -> dict[str, str]:
    """Markdown of all pages by path: an index, and a page for each command."""
    rows = "".join(f"| [`{name}`]({name}.md) | {escaped(page.summary)} |\n" for name, page in PAGES.items())
    return {"commands/index.md": INTRODUCTION + rows} | {
        f"commands/{name}.md": markdown(page) for name, page in PAGES.items()
    }


def markdown(page: CommandPage) -> str:
    """The page of a command: what it does, its usage, examples, then every flag with its default."""
    defaults = page.defaults()
    parts = [f"# {page.program}", escaped(page.summary), _code([page.usage])]
    if listing := page.listing():
        parts.append(_code(listing))
    parts += ["## Examples", _code([text for line, purpose in page.examples for text in (f"# {purpose}", line)])]
    for title, flags in page.grouped().items():
        parts.append(f"## {title[:1].upper()}{title[1:]}")
        parts += [f"`{flag.shown}`\n:   {escaped(explained(flag, defaults))}" for flag in flags]
    return "\n\n".join(parts) + "\n"


def escaped(text: str) -> str:
    """Plain text as Markdown that shows it as it is."""
    return MARKUP.sub(r"\\\1", html.escape(text, quote=False))


def _code(lines: Sequence[str]) -> str:
    return "```text\n{}\n```".format("\n".join(lines))
