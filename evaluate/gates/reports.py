"""Reports of checks for continuous integration: JUnit XML, GitHub annotations and GitHub's job summary."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

from evaluate.escaping.github import github_message, github_property
from evaluate.escaping.markdown import markdown_text
from evaluate.escaping.xml_text import xml_text
from evaluate.gates.checks import Check
from ggavatar.io.atomic import write_text

SUMMARY_VARIABLE = "GITHUB_STEP_SUMMARY"
"""Names the file to which a step of a GitHub workflow appends its summary."""


def to_junit(checks: Sequence[Check]) -> str:
    """Checks as JUnit XML, one test case per check; no two share class and name, since CI servers merge those."""
    failures = sum(not check.passed for check in checks)
    root = ElementTree.Element("testsuites")
    suite = ElementTree.SubElement(
        root, "testsuite", name="ggavatar-eval", tests=str(len(checks)), failures=str(failures)
    )
    checks = [replace(c, case=xml_text(c.case), message=xml_text(c.message), rule=xml_text(c.rule)) for c in checks]
    seen: Counter[tuple[str, str]] = Counter()
    for check in checks:
        group, _, metric = check.case.rpartition("/")
        name = f"{metric} {check.rule}".rstrip()
        seen[group, name] += 1
        name += f" ({seen[group, name]})" if seen[group, name] > 1 else ""
        case = ElementTree.SubElement(suite, "testcase", classname=group or "ggavatar-eval", name=name)
        if check.passed:
            ElementTree.SubElement(case, "system-out").text = check.message
        else:
            ElementTree.SubElement(case, "failure", message=check.message).text = f"{check.case}: {check.message}"
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def write_junit(path: Path, checks: Sequence[Check]) -> None:
    """Write the JUnit file."""
    write_text(path, to_junit(checks))


def to_github(checks: Sequence[Check]) -> str:
    """GitHub workflow commands: an error for every failed check, and one notice that sums up all."""
    errors = [f"::error title={github_property(c.case)}::{github_message(c.message)}\n" for c in checks if not c.passed]
    return "".join([*errors, f"::notice title=ggavatar-eval::{summary_line(checks)}\n"])


def summary_line(checks: Sequence[Check]) -> str:
    """How many checks passed."""
    passed = sum(check.passed for check in checks)
    failed = len(checks) - passed
    return f"{passed} of {len(checks)} checks passed" + (f", {failed} failed" if failed else "")


def append_step_summary(checks: Sequence[Check]) -> Path | None:
    """Append a Markdown table of all checks to the file that GitHub names, failures first; None without such a file."""
    name = os.environ.get(SUMMARY_VARIABLE)
    if not name:
        return None
    ordered = sorted(checks, key=lambda check: check.passed)
    rows = [
        f"| {'pass' if c.passed else '**FAIL**'} | {markdown_text(c.case)} | {markdown_text(c.message)} |"
        for c in ordered
    ]
    lines = [f"### ggavatar-eval: {summary_line(checks)}", "", "| | check | |", "|---|---|---|", *rows, "", ""]
    with Path(name).open("a", encoding="utf-8") as stream:
        stream.write("\n".join(lines))
    return Path(name)
