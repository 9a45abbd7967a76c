"""A reporter that shows nothing and keeps the warnings."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class SilentReporter:
    """Shows no progress; warnings are kept."""

    warnings: list[str] = field(default_factory=list)

    def progress(self, title: str) -> None:
        """Nothing."""

    def warn(self, text: str) -> None:
        """Keep the line."""
        self.warnings.append(text)
