"""One person or another. References: rigid motions of one face, and the real clips.

Also covers `preprocess/evidence/clip_faces.py`, `preprocess/evidence/parts.py`.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ggavatar.errors import InputError
from ggavatar.landmarks.average_face import average_face
from ggavatar.landmarks.tracker import Landmarks
from preprocess.evidence.clip_faces import ClipFaces, stack_faces
from preprocess.evidence.identity import face_shape, is_same_person, shape_distance
from preprocess.evidence.parts import choose_part, find_parts, parse_cut


def person(seed, strength=0.003):
    """The average face with a nose, brows and eyes of their own: smooth random offsets of some millimeters."""
    vertices = average_face().vertices.astype(np.float64)
    generator = np.random.default_rng(seed)
    waves = [np.sin(vertices @ generator.normal(0, 60, 3) + generator.uniform(0, 6)) for _ in range(3)]
    return vertices + strength * np.stack(waves, axis=1)


def seen(vertices, count, seed=0):
    """Landmarks of a face that turns, moves and comes nearer, as the network gives them: x right, y down, z away."""
    generator = np.random.default_rng(seed)
    points, depth = np.full((count, 478, 2), 0.0), np.zeros((count, 478))
    for row in range(count):
        turned = Rotation.from_rotvec(generator.normal(0, 0.2, 3)).apply(vertices) * generator.uniform(1500, 2500)
        points[row, :468] = turned[:, :2] * [1, -1] + generator.uniform(200, 300, 2)
        depth[row, :468] = -turned[:, 2]
    return points, depth


def test_pose_and_size_do_not_matter():
    first, second = (face_shape(*seen(person(1), 20, seed)) for seed in (3, 4))
    assert first is not None and second is not None and shape_distance(first, second) < 1e-9
    assert is_same_person(first, second, same_scene=False)
    assert face_shape(*seen(person(1), 4)) is None


def test_other_faces_are_other_persons():
    first, second = (face_shape(*seen(person(number), 20)) for number in (1, 2))
    assert first is not None and second is not None and not is_same_person(first, second, same_scene=True)


def clip_of(*stretches):
    """A clip of persons (None: nobody) for so many frames each, in scenes of their own color; its cuts."""
    points, depth, thumbnails = [], [], []
    for place, (who, count) in enumerate(stretches):
        found = seen(person(who or 0), count, seed=place)
        points.append(found[0] if who is not None else np.full((count, 478, 2), np.nan))
        depth.append(found[1] if who is not None else np.full((count, 478), np.nan))
        thumbnails.append(np.full((count, 32, 32, 3), 40 * (who or 0), np.uint8))
    faces = ClipFaces(np.concatenate(points), np.concatenate(depth), np.zeros((sum(c for _, c in stretches), 52)))
    return np.concatenate(thumbnails), faces, ~faces.found


def test_parts_of_several_persons():
    parts = find_parts(*clip_of((1, 20), (2, 30), (1, 10)), cuts=[20, 50])
    assert [(part.first, part.last, part.faces, part.person) for part in parts] == [
        (0, 19, 20, 0), (20, 49, 30, 1), (50, 59, 10, 0),
    ]  # fmt: skip


def test_one_person_before_and_after_cuts_and_gaps_is_one_part():
    parts = find_parts(*clip_of((1, 20), (None, 12), (1, 20), (None, 2), (1, 10)), cuts=[10])
    assert [(part.first, part.last, part.faces) for part in parts] == [(0, 63, 50)]
    assert find_parts(*clip_of((None, 12)), cuts=[]) == []


def test_another_person_after_a_gap():
    parts = find_parts(*clip_of((1, 20), (None, 12), (2, 20)), cuts=[])
    assert [(part.first, part.last, part.person) for part in parts] == [(0, 19, 0), (32, 51, 1)]


def test_the_part_that_is_kept():
    parts, numbers = find_parts(*clip_of((1, 20), (2, 30)), cuts=[20]), list(range(100, 150))
    with pytest.raises(InputError, match=r"v\.mp4: another person from frame 120 on; .*--resume --cut auto .*120:150"):
        choose_part(parts, "refuse", numbers, "v.mp4")
    assert choose_part(parts, "auto", numbers, "v.mp4") == parts[1] == choose_part(parts, "2", numbers, "v.mp4")
    assert choose_part(parts, "1", numbers, "v.mp4") == parts[0] and choose_part(parts, "all", numbers, "v") is None
    assert choose_part(parts[:1], "refuse", numbers, "v") is None is choose_part([], "auto", numbers, "v")
    with pytest.raises(InputError, match="--cut 3: expected one of the parts 1: frames 100–119; 2: frames 120–149"):
        choose_part(parts, "3", numbers, "v.mp4")
    for text in ("0", "-1", "first", ""):
        with pytest.raises(InputError, match="--cut"):
            parse_cut(text)


def test_landmarks_as_arrays():
    face = Landmarks(np.ones((478, 2)), np.ones(478), np.ones(52), 1.0)
    faces = stack_faces([face, None, face])
    assert faces.found.tolist() == [True, False, True] and faces.at(1) is None and not faces.blendshapes[1].any()
    back = faces.rows([2]).at(0)
    assert back is not None and np.array_equal(back.points, face.points)
