"""GNM's npz and ICT-FaceKit's folder as head models, on files of the same layout that are made here.

No file of either model is at hand: the layouts are those of their repositories (google/GNM gnm_common.py,
gnm_data_loader.py; ICT-VGL/ICT-FaceKit README). Reference: GNM's forward function, written out in float64. Also covers
`ggavatar/head/gnm.py`, `ggavatar/head/ict.py`, `ggavatar/head/any_head.py`, `ggavatar/head/still_joints.py`.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from ggavatar.core import Drive
from ggavatar.errors import InputError
from ggavatar.head.any_head import is_head_file, open_head
from ggavatar.head.files import load_head, save_head
from ggavatar.head.flame import flame_version
from ggavatar.head.gnm import is_gnm, load_gnm
from ggavatar.head.ict import EXPRESSIONS, IDENTITIES, KEPT_VERTICES, NEUTRAL, VERTICES, load_ict
from ggavatar.io.npz import write_npz
from ggavatar.landmarks.blendshapes import NAMES
from tests.support.damaged_files import refused_mutants
from tests.support.synthetic_clip import ball_head


def gnm_arrays(vertices=200, identities=6, expressions=8):
    """A ball of a head with GNM's keys: four joints, and a back of the head that no expression moves."""
    generator = np.random.default_rng(0)
    template = generator.normal(0, 1, (vertices, 3))
    template = template / np.linalg.norm(template, axis=1, keepdims=True) * [0.08, 0.12, 0.1]
    basis = generator.normal(0, 0.002, (expressions, vertices, 3))
    basis[:, template[:, 2] < 0] = 0
    weights = generator.uniform(0, 1, (4, vertices))
    return {
        "version": np.array("3.0"),
        "variant": np.array("head"),
        "template_vertex_positions": template.astype(np.float32),
        "template_joint_positions": np.array([[0, -0.1, 0], [0, -0.05, 0], [0.03, 0.03, 0.07], [-0.03, 0.03, 0.07]]),
        "vertex_identity_basis": generator.normal(0, 0.003, (identities, vertices, 3)).astype(np.float32),
        "joint_identity_basis": generator.normal(0, 0.001, (identities, 4, 3)).astype(np.float32),
        "expression_basis": basis.astype(np.float32),
        "joint_names": np.array(["neck", "head", "left_eye", "right_eye"]),
        "joint_parent_indices": np.array([0, 0, 1, 1]),
        "skinning_weights": (weights / weights.sum(axis=0)).astype(np.float32),
        "triangles": generator.integers(0, vertices, (50, 3)),
        "triangle_uvs": generator.uniform(0, 1, (50, 3, 2)),
        "pose_correctives_regressor": np.zeros((36, 3 * vertices), np.float32),
        "vertex_groups": (generator.uniform(0, 1, (2, vertices)) > 0.5).astype(np.float32),
        "vertex_group_names": np.array(["lips", "tongue"]),
    }


def gnm_vertices(arrays, identity, expression, rotations, translation):
    """GNM's forward function: bind pose, forward kinematics from the joints' bind positions, skinning."""
    wide = {name: value.astype(np.float64) for name, value in arrays.items() if value.dtype.kind == "f"}
    points = wide["template_vertex_positions"] + np.tensordot(identity, wide["vertex_identity_basis"], 1)
    points = points + np.tensordot(expression, wide["expression_basis"], 1)
    joints = wide["template_joint_positions"] + np.tensordot(identity, wide["joint_identity_basis"], 1)
    turns, places = [], []
    for joint, parent in enumerate(arrays["joint_parent_indices"]):
        turn = Rotation.from_rotvec(rotations[joint]).as_matrix()
        if joint == 0:
            turns, places = [turn], [joints[0] + translation]
        else:
            turns.append(turns[parent] @ turn)
            places.append(places[parent] + turns[parent] @ (joints[joint] - joints[parent]))
    moved = [points @ turn.T + place - turn @ rest for turn, place, rest in zip(turns, places, joints, strict=True)]
    return np.einsum("jv,jvc->vc", wide["skinning_weights"], np.stack(moved))


def test_gnm_is_posed_as_by_its_own_function(tmp_path):
    arrays, generator = gnm_arrays(), np.random.default_rng(3)
    write_npz(tmp_path / "anything.npz", arrays)
    identity, expression = generator.normal(0, 1, 6), generator.normal(0, 1, 8)
    rotations, translation = generator.normal(0, 0.3, (4, 3)), np.array([0.01, 0.02, -0.03])
    head = open_head(tmp_path / "anything.npz", identity)
    assert head.joint_names == ("root", "neck", "left_eye", "right_eye") and head.parents == (-1, 0, 1, 1)
    assert head.version == "gnm-head-3.0" and set(head.regions) == {"lips", "tongue"} and head.uv is not None
    drive = Drive(
        expression=torch.from_numpy(expression),
        joint_rotations=torch.from_numpy(rotations),
        eyelids=torch.zeros(2, dtype=torch.float64),
        translation=torch.from_numpy(translation),
        head_to_camera=torch.eye(4, dtype=torch.float64),
    )
    expected = gnm_vertices(arrays, identity, expression, rotations, translation)
    np.testing.assert_allclose(head.to("cpu", torch.float64).vertices(drive), expected, atol=2e-6)


def test_gnm_survives_saving(tmp_path):
    write_npz(tmp_path / "gnm_head.npz", gnm_arrays())
    head = load_gnm(tmp_path / "gnm_head.npz", expressions=5)
    save_head(head, tmp_path / "head.npz")
    again = load_head(tmp_path / "head.npz")
    assert again.expression_basis.shape[2] == 5
    torch.testing.assert_close(again.joint_regressor, head.joint_regressor)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"expression_basis": None}, "expression_basis"),
        ({"skinning_weights": np.ones((4, 200), np.float32)}, "sum to 1"),
        ({"template_vertex_positions": np.full((200, 3), np.nan, np.float32)}, "finite numbers"),
        ({"triangles": np.full((5, 3), 200)}, "below 200"),
        ({"joint_parent_indices": np.array([0, 2, 1, 1])}, "a parent before every joint"),
        ({"joint_names": np.array(["neck", "neck", "a", "b"])}, "joint names"),
        ({"pose_correctives_regressor": np.ones((36, 600), np.float32)}, "all joints but the root"),
        ({"expression_basis": np.ones((8, 100, 3), np.float32)}, r"\[any, 200, 3\]"),
    ],
)
def test_gnm_faults(tmp_path, change, said):
    arrays = gnm_arrays() | change
    path = tmp_path / "gnm.npz"
    write_npz(path, {name: value for name, value in arrays.items() if value is not None})
    with pytest.raises(InputError, match=said):
        load_gnm(path)


def test_gnm_refuses_the_identity_of_another_model(tmp_path):
    write_npz(tmp_path / "gnm.npz", gnm_arrays())
    with pytest.raises(InputError, match="at most 6 identity coefficients"):
        load_gnm(tmp_path / "gnm.npz", np.ones(300))


def test_gnm_mutations(tmp_path):
    path = tmp_path / "gnm.npz"
    write_npz(path, gnm_arrays(40, 2, 3))
    assert is_gnm(path)
    assert refused_mutants(path, path.read_bytes(), lambda: load_gnm(path), 1) > 0


def obj(points, faces):
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in points]
    lines += ["f " + " ".join(f"{corner + 1}/{corner + 1}" for corner in face) for face in faces]
    return "mtllib x.mtl\n" + "\n".join(lines) + "\n"


@pytest.fixture(scope="module")
def ict(tmp_path_factory):
    """The folder with ICT-FaceKit's topology numbers and random geometry; three files of identities."""
    folder = tmp_path_factory.mktemp("ict") / "FaceXModel"
    folder.mkdir()
    generator = np.random.default_rng(0)
    neutral = np.round(generator.uniform(-12, 12, (VERTICES, 3)), 6)
    faces = [(0, 1, 2, 3), (4, 5, 6), (KEPT_VERTICES, 1, 2, 3)]
    (folder / NEUTRAL).write_text(obj(neutral, faces))
    moved = {}
    names = [*EXPRESSIONS, "identity000", "identity007"]
    for index, name in enumerate(names):
        moved[name] = neutral.copy()
        rows = slice(100 * index, 100 * index + 100)
        moved[name][rows] += 0.5
        (folder / f"{name}.obj").write_text(obj(moved[name], faces) if index in (0, 53, 54) else edit(neutral, rows))
    return folder, neutral


def edit(neutral, rows):
    points = neutral.copy()
    points[rows] += 0.5
    return obj(points, [])


def test_ict_expressions_are_arkits():
    """Its README: ARKit's names with _L and _R, browInnerUp and cheekPuff split, no tongueOut."""
    sides = {"L": "Left", "R": "Right"}
    names = {f"{name[:-2]}{sides[name[-1]]}" if name[-2] == "_" else name for name in EXPRESSIONS}
    for split in ("browInnerUp", "cheekPuff"):
        names = names - {f"{split}Left", f"{split}Right"} | {split}
    assert len(EXPRESSIONS) == 53 and names == set(NAMES) - {"neutral"}


def test_ict_folder(ict, tmp_path):
    folder, neutral = ict
    identity = np.zeros(IDENTITIES)
    identity[7] = 2.0
    head = open_head(folder.parent, identity)
    assert head.template.shape == (KEPT_VERTICES, 3) and head.faces.tolist() == [[0, 1, 2], [0, 2, 3], [4, 5, 6]]
    expected = neutral[:KEPT_VERTICES].copy()
    expected[5400:5500] += 2 * 0.5  # identity007 is the 55th file
    np.testing.assert_allclose(head.template, expected * 0.01, atol=1e-6)
    np.testing.assert_allclose(head.expression_basis[300:400, :, 3], 0.005, atol=1e-6)
    assert not head.expression_basis[:300, :, 3].any() and head.expression_basis.shape[2] == 53
    joints = head.joint_regressor @ head.template
    np.testing.assert_allclose(joints[2], head.template[21451:23021].mean(dim=0), atol=1e-5)
    drive = dataclasses.replace(head.neutral_drive(), expression=torch.ones(53))
    turned = dataclasses.replace(drive, joint_rotations=torch.zeros(4, 3).index_fill(0, torch.tensor([2]), 0.2))
    still, moved = head.vertices(drive), head.vertices(turned)
    assert (still - moved)[21451:23021].abs().max() > 1e-3 and not (still - moved)[23021:].any()
    save_head(head, tmp_path / "head.npz")
    assert load_head(tmp_path / "head.npz").version == "ict-facekit-1"


def test_ict_faults(ict, tmp_path):
    folder, _ = ict
    with pytest.raises(InputError, match=r"without ICT-FaceKit's files"):
        open_head(tmp_path)
    for name, text, said in (
        (NEUTRAL, "v 1 2 3\nf 1 1 1\n", "expected 26719 vertices"),
        (NEUTRAL, "v 1 2 x\n" * VERTICES, "three numbers"),
        (NEUTRAL, "v 1 2 300\n" * VERTICES, "centimeters"),
        (NEUTRAL, "v 1 2 3\n" * VERTICES, "expected polygons"),
        (NEUTRAL, "v 1 2 3\n" * VERTICES + "f 1 2 99999\n", "from 1 to 26719"),
        (NEUTRAL, "v 1 2 3\n" * VERTICES + "f 1 2 3\n", "browDown_L.obj: no such file"),
    ):
        (tmp_path / name).write_text(text)
        with pytest.raises(InputError, match=said):
            load_ict(tmp_path)
    with pytest.raises(InputError, match="at most 100"):
        load_ict(folder, np.ones(300))


def test_the_content_decides(tmp_path):
    save_head(ball_head(), tmp_path / "gnm_head.npz")
    assert open_head(tmp_path / "gnm_head.npz").version == "ball-1" and is_head_file(tmp_path / "gnm_head.npz")
    write_npz(tmp_path / "head.npz", gnm_arrays())
    assert open_head(tmp_path / "head.npz").version == "gnm-head-3.0" and not is_head_file(tmp_path / "head.npz")
    with pytest.raises(InputError, match=r"flame2023_Open\.pkl"):
        open_head(tmp_path / "absent.pkl")


@pytest.mark.parametrize(
    ("name", "version"),
    [("generic_model.pkl", "flame2020"), ("flame2023.pkl", "flame2023"), ("flame2023_Open.pkl", "flame2023-open")],
)
def test_versions_of_flame(tmp_path, name, version):
    assert flame_version(tmp_path / name) == version
