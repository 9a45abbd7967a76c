"""A page for each command, made of what it prints for `--help`."""

from __future__ import annotations

import html
import re

from website.command_help import HelpPage, entry_points, printed_help, read_help

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
    pages = {name: read_help(printed_help(name)) for name in entry_points()}
    rows = "".join(f"| [`{name}`]({name}.md) | {escaped(summary(page))} |\n" for name, page in pages.items())
    return {"commands/index.md": INTRODUCTION + rows} | {
        f"commands/{name}.md": markdown(name, page) for name, page in pages.items()
    }


def summary(page: HelpPage) -> str:
    """The first sentence of a command's description."""
    return re.split(r"(?<=\.)\s|\n\n", page.text, maxsplit=1)[0].replace("\n", " ")


def markdown(name: str, page: HelpPage) -> str:
    """The page of a command: what it does, its usage, then every section."""
    parts = [f"# {name}", escaped(page.text), f"```text\n{page.usage}\n```"]
    for section in page.sections:
        parts.append(f"## {section.title[:1].upper()}{section.title[1:]}")
        if not section.options:
            parts.append("```text\n{}\n```".format("\n".join(section.lines)))
        parts += [f"`{option.flags}`\n:   {escaped(option.meaning) or '–'}" for option in section.options]
    return "\n\n".join(parts) + "\n"


def escaped(text: str) -> str:
    """Plain text as Markdown that shows it as it is."""
    return MARKUP.sub(r"\\\1", html.escape(text, quote=False))
