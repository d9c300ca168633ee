import dataclasses
import math

import numpy as np
import pytest
import torch

from omniocc.camera import OCam


@pytest.fixture
def sunny(known, build_camera):
    return build_camera(known["cameras"]["omnimvs_sunny_single_cam1"])


def test_ray_is_the_polynomials_with_the_row_axis_first(sunny):
    skewed = dataclasses.replace(sunny, affine=(1.01, 0.02, -0.03))
    row, column = 300.0, 500.0
    x, y = np.linalg.solve([[1.01, 0.02], [-0.03, 1]], [row - 383, column - 399])
    rho = math.hypot(x, y)
    expected = np.array([y, x, -sum(a * rho**i for i, a in enumerate(sunny.polynomial))])
    ray, valid = skewed.unproject(torch.tensor([column, row], dtype=torch.float64))
    np.testing.assert_allclose(ray.numpy(), expected / np.linalg.norm(expected), atol=1e-12)
    assert valid
    back, _ = dataclasses.replace(skewed, inverse_polynomial=()).project(4 * ray)
    np.testing.assert_allclose(back.numpy(), [column, row], atol=1e-8)


def test_a_polynomial_that_turns_ends_the_model():
    # theta(rho) of f = -100 - 0.01 rho^2 + ... rises no more where rho f' = f
    camera = OCam(900, 900, (449.5, 449.5), (-100.0, 0.0, -0.01), (), (1.0, 0.0, 0.0), 180.0)
    assert camera.limit_rad == pytest.approx(math.atan2(100, 200))
    assert camera.unproject(torch.tensor([449.5 + 99.9, 449.5]))[1]
    assert not camera.unproject(torch.tensor([449.5 + 100.1, 449.5]))[1]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"polynomial": (196.0, 0.0)}, r"polynomial\[0\] is 196.0.*negative"),
        ({"polynomial": ()}, "polynomial is .*1 to 40"),
        ({"affine": (0.0, 1.0, 1.0)}, "affine is"),
        ({"max_angle_deg": 220.0}, "max_angle_deg is 220"),
    ],
)
def test_wrong_parameters_are_named(change, message, sunny):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(sunny, **change)
