"""FLAME files, on a synthetic model of FLAME's layout and classes. Reference.

The published formula, written out with numpy in float64.
"""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
import torch

from ggavatar.core import Drive
from ggavatar.errors import InputError
from ggavatar.head.flame import flame_version, is_flame, load_flame
from tests.support.flame_files import FACES, VERTICES, flame_values, write_model


def rodrigues(vector):
    angle = np.linalg.norm(vector)
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def reference(values, shape, expression, pose, translation):
    """Li et al. 2017: shape, joints, pose correctives, forward kinematics, skinning."""
    shaped = values["v_template"] + values["shapedirs"] @ np.concatenate((shape, expression))
    joints = values["J_regressor"] @ shaped
    rotations = [rodrigues(vector) for vector in pose]
    feature = np.concatenate([(rotation - np.eye(3)).ravel() for rotation in rotations[1:]])
    posed = shaped + values["posedirs"] @ feature
    parents, world = [-1, 0, 1, 1, 1], []
    for index, parent in enumerate(parents):
        local = np.eye(4)
        local[:3, :3], local[:3, 3] = rotations[index], joints[index] - (joints[parent] if parent >= 0 else 0)
        world.append(local if parent < 0 else world[parent] @ local)
    for index in range(5):
        world[index][:3, 3] -= world[index][:3, :3] @ joints[index]
    blended = np.einsum("vj,jab->vab", values["weights"], np.stack(world))
    return np.einsum("vab,vb->va", blended, np.column_stack((posed, np.ones(VERTICES))))[:, :3] + translation


@pytest.mark.parametrize("kind", ["pkl", "npz"])
def test_equals_the_formula(tmp_path, kind):
    values, generator = flame_values(), np.random.default_rng(3)
    path = tmp_path / f"generic_model.{kind}"
    if kind == "pkl":
        write_model(path, values)
    else:
        np.savez(path, **values)
    shape, expression = generator.normal(0, 1, 300), generator.normal(0, 1, 100)
    pose, translation = generator.normal(0, 0.3, (5, 3)), generator.normal(0, 0.1, 3)
    head = load_flame(path, shape)
    assert head.version == "flame2020" and head.parents == (-1, 0, 1, 1, 1) and head.expression_basis.shape[2] == 100

    def tensor(array):
        return torch.from_numpy(array.astype(np.float32))

    drive = Drive(tensor(expression), tensor(pose), torch.zeros(2), tensor(translation), torch.eye(4))
    expected = reference(values, shape, expression, pose, translation)
    np.testing.assert_allclose(head.vertices(drive).numpy(), expected, atol=2e-6)


def test_fewer_expressions_and_short_shapes(tmp_path):
    values = flame_values()
    path = tmp_path / "flame2023.pkl"
    write_model(path, values)
    head = load_flame(path, np.array([1.0, -1.0]), expressions=50)
    assert head.version == "flame2023" and head.expression_basis.shape[2] == 50
    np.testing.assert_allclose(head.expression_basis[:, :, 0], values["shapedirs"][:, :, 300], atol=1e-6)
    np.testing.assert_allclose(head.template, values["v_template"] + values["shapedirs"][:, :, :2] @ [1, -1], atol=1e-6)


def test_lids_and_regions_beside_the_model(tmp_path):
    write_model(tmp_path / "generic_model.pkl", flame_values())
    lid = np.random.default_rng(0).normal(0, 0.001, (VERTICES, 3))
    np.save(tmp_path / "l_eyelid.npy", lid)
    (tmp_path / "FLAME_masks.pkl").write_bytes(pickle.dumps({"face": np.arange(7), "scalp": np.array([9, 8])}, 2))
    head = load_flame(tmp_path / "generic_model.pkl")
    np.testing.assert_allclose(head.eyelid_basis[:, :, 0], lid, atol=1e-7)
    assert not head.eyelid_basis[:, :, 1].any() and head.regions["scalp"].tolist() == [9, 8]


def test_kinds_are_told_apart(tmp_path):
    values = flame_values()
    np.savez(tmp_path / "flame.npz", **values)
    np.savez(tmp_path / "head.npz", template=values["v_template"])
    assert is_flame(tmp_path / "flame.npz") and not is_flame(tmp_path / "head.npz") and is_flame(Path("any.pkl"))
    assert flame_version(Path("x/flame2023.pkl")) == "flame2023"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"v_template": np.zeros((VERTICES, 2))}, "v_template"),
        ({"weights": np.zeros((VERTICES, 4))}, "weights"),
        ({"posedirs": np.full((VERTICES, 3, 36), np.nan)}, "posedirs"),
        ({"f": np.full((FACES, 3), VERTICES)}, "expected vertex indices"),
        ({"f": np.zeros((0, 3), int)}, "expected vertex indices"),
        ({"kintree_table": np.array([[0, 0, 1, 1, 1], [0, 1, 2, 3, 4]])}, "parents"),
        ({"kintree_table": np.array([[-1, 0, 3, 1, 1], [0, 1, 2, 3, 4]])}, "parents"),
        ({"shapedirs": np.array("text")}, "shapedirs"),
        ({"J_regressor": ...}, "has no J_regressor"),
    ],
)
def test_wrong_models(tmp_path, changes, message):
    values = {key: value for key, value in {**flame_values(), **changes}.items() if value is not ...}
    path = tmp_path / "generic_model.npz"
    np.savez(path, **values)
    with pytest.raises(InputError, match=message) as caught:
        load_flame(path)
    assert "generic_model.npz" in str(caught.value)


def test_not_a_model(tmp_path):
    path = tmp_path / "generic_model.pkl"
    path.write_bytes(pickle.dumps([1, 2], 2))
    with pytest.raises(InputError, match="expected a FLAME model"):
        load_flame(path)
    np.save(tmp_path / "l_eyelid.npy", np.zeros((3, 3)))
    write_model(path, flame_values())
    with pytest.raises(InputError, match=r"l_eyelid\.npy"):
        load_flame(path)
