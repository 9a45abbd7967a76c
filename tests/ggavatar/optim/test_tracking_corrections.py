"""Corrections of tracked parameters: which frames have them, what they add, and at which rate they learn."""

from __future__ import annotations

import dataclasses

import pytest
import torch

from ggavatar.core import Drive
from ggavatar.head.model import HeadModel
from ggavatar.optim.tracking_corrections import CorrectionRates, DriveCorrections


@pytest.fixture
def drives(toy_head: HeadModel) -> list[Drive]:
    """Three training frames that look alike."""
    return [dataclasses.replace(toy_head.neutral_drive(), frame=number) for number in (4, 7, 9)]


def test_corrections_start_as_nothing(drives: list[Drive]) -> None:
    corrected = DriveCorrections(drives, CorrectionRates())(drives[1])
    for field in dataclasses.fields(Drive):
        ours, theirs = getattr(corrected, field.name), getattr(drives[1], field.name)
        assert torch.equal(ours, theirs) if isinstance(ours, torch.Tensor) else ours == theirs


def test_only_training_frames_are_corrected(drives: list[Drive]) -> None:
    corrections = DriveCorrections(drives, CorrectionRates())
    with torch.no_grad():
        for parameter in corrections.parameters():
            parameter.fill_(0.5)
    for number in (None, 5):
        other = dataclasses.replace(drives[0], frame=number)
        assert corrections(other) is other and not corrections.corrects(other)
    assert corrections.corrects(drives[0])


def test_each_frame_has_its_own(drives: list[Drive]) -> None:
    corrections = DriveCorrections(drives, CorrectionRates())
    with torch.no_grad():
        corrections.expression[1] = torch.tensor([0.1, 0.2, 0.3])
        corrections.joint_rotations[1, 2, 0] = 0.4
        corrections.translation[1, 1] = 0.01
    corrected, untouched = corrections(drives[1]), corrections(drives[0])
    assert torch.allclose(corrected.expression, torch.tensor([0.1, 0.2, 0.3]))
    assert corrected.joint_rotations[2, 0] == 0.4 and corrected.joint_rotations.count_nonzero() == 1
    assert torch.allclose(corrected.translation, torch.tensor([0.0, 0.01, 0.0]))
    assert not untouched.expression.any() and not untouched.joint_rotations.any()


def test_rates_are_those_of_gaussian_avatars_and_adam_steps_by_them(drives: list[Drive]) -> None:
    """Adam's first step is the rate itself, whatever the gradient."""
    corrections = DriveCorrections(drives, CorrectionRates())
    drive = corrections(drives[2])
    (3 * drive.expression.sum() - 7 * drive.joint_rotations.sum() + 0.2 * drive.translation.sum()).backward()
    corrections.optimizer.step()
    assert torch.allclose(corrections.expression[2], torch.full((3,), -1e-3))
    assert torch.allclose(corrections.joint_rotations[2], torch.full((5, 3), 1e-5))
    assert torch.allclose(corrections.translation[2], torch.full((3,), -1e-6))
    assert not corrections.expression[:2].any() and not corrections.joint_rotations[:2].any()


def test_drives_without_numbers_are_refused(toy_head: HeadModel) -> None:
    with pytest.raises(ValueError, match="frame numbers"):
        DriveCorrections([toy_head.neutral_drive()], CorrectionRates())


def test_tiny_gradients_move_corrections_as_far_as_large_ones(drives: list[Drive]) -> None:
    """GaussianAvatars' ε of 1e-15: a gradient of 1e-10 is no noise to it; at torch's 1e-8 it would move a hundredth."""
    corrections = DriveCorrections(drives, CorrectionRates())
    (1e-10 * corrections(drives[0]).expression.sum()).backward()
    corrections.optimizer.step()
    assert torch.allclose(corrections.expression[0], torch.full((3,), -1e-3), rtol=1e-3)
