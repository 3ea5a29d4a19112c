"""Rotations in torch equal SciPy's."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from aslip.transforms import rotation

NUM = 50


def _quaternions(seed: int) -> tuple[Tensor, Rotation]:
    """Random unit quaternions wxyz, half of them with w < 0, and the same rotations in SciPy."""
    generator = torch.Generator().manual_seed(seed)
    q = torch.nn.functional.normalize(
        torch.randn(NUM, 4, generator=generator, dtype=torch.float64), dim=-1
    )
    return q, Rotation.from_quat(q.numpy(), scalar_first=True)


def _equal(found: Tensor, expected: np.ndarray | float) -> None:
    np.testing.assert_allclose(found.numpy(), expected, rtol=0, atol=1e-12)


def test_rotate_inverse_equals_scipy() -> None:
    quaternion, expected = _quaternions(0)
    vector = torch.randn(NUM, 3, dtype=torch.float64)
    _equal(rotation.rotate_inverse(quaternion, vector), expected.inv().apply(vector.numpy()))


def test_multiply_and_conjugate_equal_scipy() -> None:
    (a, first), (b, second) = _quaternions(1), _quaternions(2)
    product = rotation.upper_hemisphere(rotation.multiply(rotation.conjugate(a), b))
    expected = (first.inv() * second).as_quat(scalar_first=True, canonical=True)
    _equal(product, expected)


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-3, 1.0, 3.0])
def test_from_vector_equals_scipy(size: float) -> None:
    vector = size * torch.nn.functional.normalize(torch.randn(NUM, 3, dtype=torch.float64), dim=-1)
    expected = Rotation.from_rotvec(vector.numpy()).as_quat(scalar_first=True, canonical=True)
    _equal(rotation.from_vector(vector), expected)


def test_yaw_is_the_heading_of_the_x_axis() -> None:
    quaternion, turned = _quaternions(5)
    ahead = turned.apply([1.0, 0.0, 0.0])
    _equal(rotation.yaw(quaternion)[:, 0], np.arctan2(ahead[:, 1], ahead[:, 0]))


def test_yaw_quaternion_turns_about_z_alone() -> None:
    quaternion, _ = _quaternions(6)
    found = Rotation.from_quat(rotation.yaw_quaternion(quaternion).numpy(), scalar_first=True)
    expected = rotation.yaw(quaternion).numpy() * [0.0, 0.0, 1.0]
    _equal(torch.from_numpy(found.as_rotvec()), expected)
