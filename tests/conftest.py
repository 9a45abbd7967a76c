"""Fixtures shared by all tests: where model files and real data are, and one thread for repeatable speed."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

# Parallel workers share the cores; idle OpenMP threads must not spin on them. Both are read when torch is imported.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("OMP_NUM_THREADS", "1")

import torch

# Without a GPU, Triton's kernels are interpreted on CPU tensors. Read when triton is imported.
if not torch.cuda.is_available():
    os.environ.setdefault("TRITON_INTERPRET", "1")

# Tests use the model files that are here; those of downloading have a package index of their own.
os.environ["GGAVATAR_OFFLINE"] = "1"


def _folder(variable: str, what: str) -> Path:
    value = os.environ.get(variable)
    if not value or not Path(value).is_dir():
        pytest.skip(f"needs {what}: set ${variable} to their folder")
    return Path(value)


@pytest.fixture(scope="session")
def models_folder() -> Path:
    """Model files that the project does not ship."""
    return _folder("GGAVATAR_MODELS", "model files")


@pytest.fixture(scope="session")
def pretrained() -> Callable[[str], Path]:
    """The file of a model of the catalogue, verified; `ggavatar-models --fetch NAME` puts it where it is found."""
    from ggavatar.pretrained.resolve import ModelFinder, ModelUnavailable

    def find(name: str) -> Path:
        try:
            return ModelFinder().find(name)
        except ModelUnavailable:
            pytest.skip(f"needs the weights of {name}: run ggavatar-models --fetch {name}")

    return find


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Real clips and tracking files that the project does not ship."""
    return _folder("GGAVATAR_TEST_DATA", "real clips and tracking files")
