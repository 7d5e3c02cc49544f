"""Rotation vectors and their derivatives against SciPy, from no rotation to half a turn and beyond."""

from typing import Any

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from multirod.models import rotation_kernels as kernels

ANGLES = [0.0, 1e-12, 1e-7, 9e-5, 1.1e-4, 9e-3, 0.011, 0.1, 1.0, 2.0, 2.5, 3.0, np.pi - 1e-3, np.pi - 1e-9]


@wp.kernel(module="unique", enable_backward=False)
def evaluate(
    vectors: wp.array[wp.vec3d],
    cosines: wp.array[wp.float64],
    rotations: wp.array[wp.mat33d],
    logs: wp.array[wp.vec3d],
    left: wp.array[wp.mat33d],
    right: wp.array[wp.mat33d],
    swings: wp.array[wp.vec2d],
):
    t = wp.tid()
    rotations[t] = kernels.rotation_from_vector(vectors[t])
    logs[t] = kernels.rotation_vector(rotations[t])
    left[t] = kernels.left_jacobian(vectors[t])
    right[t] = kernels.inverse_right_jacobian(vectors[t])
    swings[t] = kernels.swing(cosines[t])


def run(vectors: np.ndarray, cosines: np.ndarray) -> list[np.ndarray]:
    count = len(vectors)
    given: list[Any] = [wp.array(vectors, dtype=wp.vec3d, device="cpu"), wp.array(cosines, dtype=wp.float64, device="cpu")]
    kinds = [wp.mat33d, wp.vec3d, wp.mat33d, wp.mat33d, wp.vec2d]
    results: list[Any] = [wp.zeros(count, dtype=kind, device="cpu") for kind in kinds]
    wp.launch(evaluate, dim=count, inputs=[*given, *results], device="cpu")
    return [result.numpy() for result in results]


@pytest.fixture(scope="module")
def directions() -> np.ndarray:
    axes = np.concatenate([np.eye(3), -np.eye(3), np.random.default_rng(0).standard_normal((6, 3))])
    return axes / np.linalg.norm(axes, axis=1, keepdims=True)


@pytest.mark.parametrize("angle", ANGLES)
def test_rotations_and_their_logarithms(angle, directions):
    vectors = angle * directions
    rotations, logs, *_ = run(vectors, np.ones(len(vectors)))
    np.testing.assert_allclose(rotations, Rotation.from_rotvec(vectors).as_matrix(), rtol=0, atol=1e-15)
    # the vector of a rotation whose entries are rounded; near half a turn the axis is as good as anywhere
    np.testing.assert_allclose(logs, vectors, rtol=0, atol=4e-15)


@pytest.mark.parametrize("angle", [*ANGLES, 4.0, 6.0])
def test_jacobians(angle, directions):
    """The derivatives solve dExp(a) = [J(a) da]x Exp(a), and that of the logarithm is the inverse of J(-a)."""
    vectors = angle * directions
    _, _, left, right, _ = run(vectors, np.ones(len(vectors)))
    negative = run(-vectors, np.ones(len(vectors)))[2]
    products = right @ negative
    # near a whole turn J is nearly singular
    np.testing.assert_allclose(
        products, np.broadcast_to(np.eye(3), products.shape), rtol=0, atol=1e-13 / min(1, abs(6.3 - angle))
    )
    h = 1e-4
    for j in range(3):
        step = h * np.eye(3)[j]
        a, b = (Rotation.from_rotvec(vectors + s * step) for s in (1, -1))
        c, d = (Rotation.from_rotvec(vectors + s * step / 2) for s in (1, -1))
        coarse, fine = (a * b.inv()).as_rotvec() / (2 * h), (c * d.inv()).as_rotvec() / h
        # differences extrapolated to fourth order: h^4, and rounding over h
        np.testing.assert_allclose(left[:, :, j], (4 * fine - coarse) / 3, rtol=0, atol=2e-11)


def test_swing():
    """f = angle / sin(angle) and df/d(cosine), also where both are series."""
    angles = np.concatenate([[0.0], np.logspace(-9, np.log10(3.1), 200)])
    found = run(np.zeros((len(angles), 3)), np.cos(angles))[4]
    x = 1 - np.cos(angles)  # as the kernel sees it
    exact = np.arccos(np.clip(1 - x, -1, 1))
    with np.errstate(invalid="ignore", divide="ignore"):
        f = np.where(x > 1e-3, exact / np.sin(exact), 1 + x / 3 + 2 * x**2 / 15 + 2 * x**3 / 35 + 8 * x**4 / 315 + 8 * x**5 / 693)
    np.testing.assert_allclose(found[:, 0], f, rtol=1e-12)
    h = 1e-5
    inner = np.cos(angles[angles > 0.05])
    inner = inner[inner - h > -1]
    shifted = [run(np.zeros((len(inner), 3)), inner + s)[4][:, 0] for s in (h, -h, h / 2, -h / 2)]
    slope = (4 * (shifted[2] - shifted[3]) / h - (shifted[0] - shifted[1]) / (2 * h)) / 3
    np.testing.assert_allclose(run(np.zeros((len(inner), 3)), inner)[4][:, 1], slope, rtol=1e-6)
    # the series and the closed form meet
    near = run(np.zeros((2, 3)), 1 - np.array([0.9999e-3, 1.0001e-3]))[4]
    np.testing.assert_allclose(near[0], near[1], rtol=1e-6)
