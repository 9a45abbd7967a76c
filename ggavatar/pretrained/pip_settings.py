"""Which package index pip is configured for, so that model files come from the same one."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from dataclasses import dataclass

SECTIONS = ("global", "download", ":env:")
"""Sections of pip's configuration that apply to a download; later ones win."""


@dataclass(frozen=True)
class IndexSettings:
    """The part of pip's configuration that says where archives come from.

    Attributes:
        index: Address of the main index; None for the default, the public Python package index.
        extra_indexes: Addresses of further ones.
        find_links: Folders and pages with links to archives.
        no_index: Use `find_links` only.
        trusted_hosts: Hosts whose certificates are not checked.
        certificate: File of accepted certificate authorities; None for the system's.
        proxy: Address of a proxy; None for the one in the environment.
        timeout: How long a server may stay silent, s.
    """

    index: str | None = None
    extra_indexes: tuple[str, ...] = ()
    find_links: tuple[str, ...] = ()
    no_index: bool = False
    trusted_hosts: tuple[str, ...] = ()
    certificate: str | None = None
    proxy: str | None = None
    timeout: float = 30.0


def read_pip_settings() -> IndexSettings:
    """The settings that `pip download` would use: those of pip's files and of its environment variables."""
    values = _values(_config_list())

    def words(name: str) -> tuple[str, ...]:
        return tuple(values.get(name, "").split())

    timeout = values.get("timeout", values.get("default-timeout", ""))
    return IndexSettings(
        index=values.get("index-url") or None,
        extra_indexes=words("extra-index-url"),
        find_links=words("find-links"),
        no_index=values.get("no-index", "").lower() in ("1", "true", "yes", "on"),
        trusted_hosts=words("trusted-host"),
        certificate=values.get("cert") or None,
        proxy=values.get("proxy") or None,
        timeout=float(timeout) if timeout.replace(".", "", 1).isdigit() else IndexSettings.timeout,
    )


def _config_list() -> list[str]:
    """The lines `section.name='value'` of `pip config list`; those of the environment where pip is not installed."""
    command = [sys.executable, "-m", "pip", "config", "list"]
    try:
        ran = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    except (OSError, subprocess.SubprocessError):
        ran = None
    if ran is not None and ran.returncode == 0:
        return ran.stdout.splitlines()
    given = {name: value for name, value in os.environ.items() if name.startswith("PIP_")}
    return [f":env:.{name[4:].lower().replace('_', '-')}={value!r}" for name, value in given.items()]


def _values(lines: list[str]) -> dict[str, str]:
    """Values by option, of the sections that apply."""
    found: dict[str, dict[str, str]] = {section: {} for section in SECTIONS}
    for line in lines:
        key, _, text = line.partition("=")
        section, _, name = key.rpartition(".")
        if section in found:
            try:
                found[section][name] = str(ast.literal_eval(text))
            except (ValueError, SyntaxError):
                continue  # not a line of that form, such as a warning
    return {name: value for section in SECTIONS for name, value in found[section].items()}
