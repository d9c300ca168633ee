import numpy as np
import torch

from omniocc.camera import Equirectangular, Rig
from omniocc.classes import WORLD_CLASSES
from omniocc.draw.bev import MISSED
from omniocc.draw.canvas import INK
from omniocc.geometry import Cuboid
from omniocc.runs.wandb.media import class_cloud, range_media, voxel_media

CAR = WORLD_CLASSES.palette[7]
GRID = Cuboid(shape=(4, 4, 2), x_m=(-4.0, 4.0), y_m=(-4.0, 4.0), height_m=(-2.0, 2.0))


def test_a_cloud_has_the_occupied_cells_in_their_colours():
    labels = torch.zeros(4, 4, 2, dtype=torch.uint8)
    labels[0, 3, 1], labels[2, 0, 0], labels[1, 1, 1] = 7, 1, 255
    assert class_cloud(labels, GRID, WORLD_CLASSES).tolist() == [[-3, 3, 1, 142, 0, 0], [1, -3, -1, 128, 64, 128]]


def test_voxels_are_shown_in_the_cameras_from_above_and_as_points():
    rig = Rig.load("fisheye6").resized(64, 36)
    truth = torch.zeros(4, 4, 2, dtype=torch.uint8)
    truth[:, :, 0] = 1
    images = np.full((6, 36, 64, 3), 128, np.uint8)
    media = voxel_media(images, rig, truth, torch.zeros_like(truth), GRID, WORLD_CLASSES)
    assert [item.caption for item in media["cameras"]] == list(rig.names)
    assert [item.caption for item in media["bev"]] == ["truth", "prediction", "differences"]
    assert media["bev"][0].content[10, 10].tolist() == [128, 64, 128]
    below = [
        (item.content[400:] == rgb).all(2).any() for item, rgb in zip(media["bev"], [CAR, CAR, MISSED], strict=True)
    ]
    assert below == [True] * 3  # legends
    assert len({item.content.shape for item in media["bev"]}) == 1  # W&B warns of others
    assert media["points_truth"][0].content.shape == (16, 6)
    assert media["points_prediction"][0].content.shape == (0, 6)


def test_panoramas_show_truth_prediction_and_difference():
    panorama = Equirectangular(24, 6, 45.0, -45.0)
    true_m = torch.full((6, 24), 4.0)
    shown = [item.content for item in range_media(true_m * 2, true_m, panorama)["erp"]]
    assert len({image.shape for image in shown}) == 1
    assert shown[0].shape[0] > 240  # a bar with metres lies below the panorama
    assert shown[0].shape[1:] == (960, 3)
    assert (shown[0][260:] == INK).all(2).any()
    pixel = [tuple(image[200, 900]) for image in shown]
    assert len(set(pixel)) == 3
