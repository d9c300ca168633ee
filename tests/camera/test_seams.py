"""Orders of images that fit together: those of cameras in a textured room, of which every point is known."""

from dataclasses import replace
from itertools import combinations

import cv2
import numpy as np
import pytest
import torch

from omniocc.camera import Equidistant, Rig
from omniocc.camera.pose import pose_from_angles
from omniocc.camera.seams import better_order, measure_seams

WALL_M = 6.0


def ring(count: int, width: int = 96, yaws: tuple[float, ...] = ()) -> Rig:
    """Return a ring of fisheyes of 180 degrees, 1 m around the origin."""
    yaws = yaws or tuple(360 / count * k for k in range(count))
    poses = [
        pose_from_angles((np.cos(np.radians(yaw)), np.sin(np.radians(yaw)), 0.0), float(yaw), -10.0, 0.0)
        for yaw in yaws
    ]
    camera = Equidistant(width, width * 3 // 4, width / np.pi, (width / 2 - 0.5, width * 3 / 8 - 0.5), 90.0)
    return Rig((camera,) * len(yaws), torch.stack(poses), tuple(f"c{k}" for k in range(len(yaws))))


def images_of(rig: Rig, seed: int = 0) -> list[np.ndarray]:
    """Return what the cameras see of a sphere of noise around the origin."""
    noise = np.random.default_rng(seed).integers(0, 255, (20, 40, 3), dtype=np.uint8)
    wall = cv2.resize(noise, (720, 360), interpolation=cv2.INTER_CUBIC)
    images = []
    for k in range(len(rig.cameras)):
        rays, center = rig.rays(k)[0].double(), rig.ego_from_camera[k, :3, 3]
        along = (rays * center).sum(-1)
        reach = -along + (along.square() - center.square().sum() + WALL_M**2).sqrt()
        x, y, z = ((center + reach[..., None] * rays) / WALL_M).unbind(-1)
        column = ((np.pi - torch.atan2(y, x)) / (2 * np.pi) * 720).long() % 720
        images.append(wall[((1 - z) / 2 * 360).long().clamp(0, 359).numpy(), column.numpy()])
    return images


def swapped(images: list, one: int, other: int) -> list:
    order = list(range(len(images)))
    order[one], order[other] = other, one
    return [images[k] for k in order]


@pytest.mark.parametrize("rig", [ring(4), ring(3, yaws=(0, 70, 160)), ring(2, yaws=(0, 80))])
def test_swapped_images_are_found_and_correct_ones_are_not(rig):
    images = images_of(rig)
    assert better_order(images, rig) is None
    for one, other in combinations(range(len(images)), 2):
        found = better_order(swapped(images, one, other), rig)
        assert found is not None
        mended = [swapped(images, one, other)[k] for k in found]
        assert better_order(mended, rig) is None


def test_gains_of_the_cameras_do_not_matter():
    rig = ring(4)
    images = [(image * gain).astype(np.uint8) for image, gain in zip(images_of(rig), (0.4, 1, 0.7, 0.9), strict=True)]
    assert better_order(images, rig) is None
    assert better_order(swapped(images, 0, 1), rig) == (1, 0, 2, 3)


def test_nothing_is_said_where_nothing_is_seen_twice_or_has_texture():
    rig = ring(2)
    assert measure_seams(images_of(rig), rig) == {}
    assert better_order(images_of(rig)[::-1], rig) is None
    grey = [np.full_like(image, 90) for image in images_of(ring(4))]
    assert better_order(grey, ring(4)) is None


def test_images_of_another_size_stay_where_they_are():
    rig = ring(4)
    images = swapped(images_of(rig), 0, 1)
    images[0] = cv2.resize(images[0], (64, 48))
    found = better_order(images, rig)
    assert found is None or found[0] == 0


def test_a_masked_overlap_is_not_compared():
    rig = ring(4)
    blind = torch.zeros(72, 96, dtype=torch.bool)
    masked = replace(rig, masks=(blind, None, blind, None))
    assert measure_seams(images_of(rig), masked) == {}


def test_more_cameras_than_their_orders_can_be_compared_are_not_judged():
    rig = ring(9, width=32)
    assert better_order(swapped(images_of(rig), 0, 4), rig) is None
