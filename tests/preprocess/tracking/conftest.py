"""The canonical face where it is available, and a substitute that needs no model file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ggavatar.head.procedural.model import procedural_head
from ggavatar.landmarks.bundle import CanonicalFace, canonical_face
from preprocess.tracking.geometry.landmark_embedding import LandmarkEmbedding


@pytest.fixture(scope="session")
def bundle(models_folder: Path) -> Path:
    """The face landmarker bundle."""
    path = models_folder / "face_landmarker.task"
    if not path.is_file():
        pytest.skip("face_landmarker.task not found in $GGAVATAR_MODELS")
    return path


@pytest.fixture(scope="session")
def canonical(bundle: Path) -> CanonicalFace:
    """The canonical face of the bundle."""
    return canonical_face(bundle)


@pytest.fixture(scope="session")
def stand_in() -> tuple[CanonicalFace, LandmarkEmbedding]:
    """468 vertices of the procedural head's face as a canonical face, and their embedding."""
    head = procedural_head()
    points = head.template.numpy().astype(np.float64)
    rows = head.regions["face"].numpy()
    rows = rows[np.argsort(points[rows, 1])][:: len(rows) // 468][:468]
    # Landmark numbers have meanings (lips, lids, …) that these points lack; what is trusted goes by height only.
    face = CanonicalFace(points[rows])
    corners = np.repeat(rows[:, None], 3, axis=1)
    return face, LandmarkEmbedding(np.arange(468), corners, np.tile([1.0, 0.0, 0.0], (468, 1)))
