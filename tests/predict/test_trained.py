"""What a configuration tells of the training data, without any scene on the disk."""

from dataclasses import replace
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from omniocc.camera import Rig
from omniocc.config import compose_plain
from omniocc.predict.occupancy import compare_rig
from omniocc.predict.trained import training_data

CONF = Path(__file__).parents[2] / "conf"


def trained_with(*overrides):
    return training_data(Path("x.ckpt"), OmegaConf.create(compose_plain(CONF, "train", ["preset=smoke", *overrides])))


def test_images_get_as_many_pixels_as_those_of_the_training():
    own, drawn = trained_with(), trained_with("data.source.rig=random")
    assert own.image_size == (64, 36)
    assert own.width_for(Rig.load("fisheye6")) == 64
    other = Rig.load("surround_view").cameras[0]
    assert (other.width, other.height) == (960, 640)
    assert own.width_for(Rig.load("surround_view")) == 59  # 58.8 x 39.2 = 64 x 36 px
    assert drawn.width_for(Rig.load("surround_view")) == pytest.approx(59, abs=3)


def test_a_model_of_random_rigs_says_so():
    drawn, own = trained_with("data.source.rig=random"), trained_with()
    assert drawn.any_rig
    width, height = drawn.image_size
    assert width * height == pytest.approx(64 * 36, rel=0.15)
    assert compare_rig(Rig.load("surround_view"), drawn) == "trained with rigs drawn at random"
    assert compare_rig(Rig.load("fisheye6"), own) == "as in training"


def test_the_road_is_where_the_rig_of_the_training_had_it():
    assert trained_with("data.source.rig=surround_view").road_z_m == Rig.load("surround_view").road_z_m
    assert trained_with().road_z_m == -2.2
    assert trained_with("data.source.rig=random").road_z_m is None


def test_the_cameras_of_the_training_are_known_also_where_only_one_rig_states_the_road():
    own = trained_with()
    assert own.rig.road_z_m is None
    assert compare_rig(replace(Rig.load("fisheye6"), road_z_m=-2.2), own) == "as in training"
    assert compare_rig(Rig.load("surround_view"), own) == "not those of the training (fisheye6): expect worse results"
