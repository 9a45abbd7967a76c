"""The joint step against dense linear algebra, and what its smoothness does to motions of known frequency."""

from __future__ import annotations

import numpy as np
import pytest

from preprocess.refinement.solve import regularity, smooth_step

FRAMES, NUMBERS, FPS = 40, 3, 25.0


def problem():
    generator = np.random.default_rng(0)
    factors = generator.normal(size=(FRAMES, NUMBERS, 5))
    information = factors @ factors.transpose(0, 2, 1)
    known = regularity(information.mean(axis=0), np.array([1.0, 2.0, 0.5]), np.array([4.0, 6.0, 2.0]), FPS)
    return information, generator.normal(size=(FRAMES, NUMBERS)), generator.normal(size=(FRAMES, NUMBERS)), known


def test_step_is_the_dense_solution():
    """Hessian and gradient of the quadratic written as full matrices over all frames."""
    information, gradient, values, known = problem()
    second = np.diff(np.eye(FRAMES), n=2, axis=0)
    rough = np.kron(second.T @ second, known.metric)
    hessian = rough + np.kron(np.eye(FRAMES), np.diag(known.prior))
    for frame in range(FRAMES):
        place = slice(frame * NUMBERS, (frame + 1) * NUMBERS)
        hessian[place, place] += information[frame]
    downhill = -gradient.ravel() - np.tile(known.prior, FRAMES) * values.ravel() - rough @ values.ravel()
    expected = np.linalg.solve(hessian, downhill).reshape(FRAMES, NUMBERS)
    np.testing.assert_allclose(smooth_step(values, information, gradient, known), expected, rtol=1e-6, atol=1e-9)


def test_a_correction_at_the_cutoff_is_halved_and_a_slow_one_kept():
    time = np.arange(400) / FPS
    known = regularity(np.eye(1), np.array([1e6]), np.array([4.0]), FPS)
    for frequency, share in ((4.0, 0.5), (0.5, 1.0)):
        wanted = np.sin(2 * np.pi * frequency * time)[:, None]
        step = smooth_step(np.zeros_like(wanted), np.ones((400, 1, 1)), -wanted, known)[50:-50]
        assert np.abs(step).max() == pytest.approx(share, abs=0.02)


def test_frames_without_a_picture_follow_their_neighbors():
    information, wanted = np.zeros((31, 1, 1)), np.zeros((31, 1))
    information[::3] = 1e4
    wanted[::3] = np.linspace(0, 1, 31)[::3, None]
    known = regularity(np.eye(1), np.array([1e3]), np.array([8.0]), FPS)
    step = smooth_step(np.zeros((31, 1)), information, -1e4 * wanted, known)
    np.testing.assert_allclose(step[:, 0], np.linspace(0, 1, 31), atol=2e-3)


def test_two_frames_have_no_roughness():
    known = regularity(np.eye(1), np.array([1.0]), np.array([4.0]), FPS)
    step = smooth_step(np.zeros((2, 1)), np.ones((2, 1, 1)), -np.ones((2, 1)), known)
    np.testing.assert_allclose(step, 0.5, atol=1e-6)
