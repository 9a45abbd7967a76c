"""Fixtures of the preprocessing tests."""

from __future__ import annotations

import pytest

from tests.support.synthetic_clip import Clip, make_clip


@pytest.fixture(scope="session")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Clip:
    """The synthetic subject's data; read only."""
    return make_clip(tmp_path_factory.mktemp("clip"))
