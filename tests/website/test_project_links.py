"""Links between docs/ and the rest of the repository, as they are on the site. Reference: cases worked out by hand."""

from __future__ import annotations

import pytest

from website.project_links import linked_files, site_path, with_site_links


@pytest.mark.parametrize(
    ("origin", "link", "expected"),
    [
        ("README.md", "docs/paper.md", "paper.md"),
        ("README.md", "docs/evaluation.md#names", "evaluation.md#names"),
        ("README.md", "CONTRIBUTING.md", "contributing.md"),
        ("README.md", "CITATION.cff", "CITATION.cff"),
        ("docs/results.md", "experiments/README.md", "experiments/README.md"),
        ("docs/results.md", "../CONTRIBUTING.md", "contributing.md"),
        ("docs/experiments/README.md", "../results.md", "../results.md"),
        (
            "docs/cuda.md",
            "../benchmarks/results/2026-12-01-launches.json",
            "benchmarks/results/2026-12-01-launches.json",
        ),
        ("docs/experiments/README.md", "../../README.md", "../index.md"),
        ("docs/paper.md", "https://arxiv.org/abs/2405.11993", "https://arxiv.org/abs/2405.11993"),
        ("docs/paper.md", "no-such-page.md", "no-such-page.md"),
        ("docs/paper.md", "../../outside.md", "../../outside.md"),
    ],
)
def test_links_on_the_site(origin: str, link: str, expected: str) -> None:
    assert with_site_links(f"see [it]({link}) and `x`", origin) == f"see [it]({expected}) and `x`"


def test_code_is_left_alone() -> None:
    text = "[a](docs/paper.md)\n\n```\n[a](docs/paper.md)\n```\n"
    assert with_site_links(text, "README.md") == "[a](paper.md)\n\n```\n[a](docs/paper.md)\n```\n"


def test_files_outside_the_pages_are_found() -> None:
    text = "[a](../CITATION.cff) [b](../README.md) [c](paper.md) [d](https://example.org) [e](../absent.txt)"
    assert list(linked_files(text, "docs/x.md")) == ["CITATION.cff"]
    assert (site_path("CHANGELOG.md"), site_path("docs/methods/ggavatar.md")) == ("changelog.md", "methods/ggavatar.md")
