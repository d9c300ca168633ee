"""What a configuration tells of the training data, without any scene on the disk."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf

from omniocc.camera import Rig
from omniocc.config import build, compose_plain
from omniocc.errors import UserError
from omniocc.predict import TrainingData
from omniocc.predict.input.sequence import with_road

CONF = Path(__file__).parents[2] / "conf"


def trained_with(*overrides):
    cfg = OmegaConf.create(compose_plain(CONF, "train", ["preset=smoke", *overrides]))
    return TrainingData.of(build(cfg.data), cfg)


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
    assert drawn.road_z_m is None
    width, height = drawn.image_size
    assert width * height == pytest.approx(64 * 36, rel=0.15)
    assert drawn.compare(Rig.load("surround_view")) == "the weights are for any rig"
    assert own.compare(Rig.load("fisheye6")) == "as in training"


def test_the_road_is_where_the_rig_of_the_training_had_it():
    assert trained_with("data.source.rig=surround_view").road_z_m == Rig.load("surround_view").road_z_m
    assert trained_with().road_z_m == -2.2
    assert trained_with("data.source.rig=random").road_z_m is None


def test_the_origin_is_put_as_high_above_the_road_as_in_training():
    own, low = trained_with(), Rig.load("surround_view")
    raised, height_m, line = own.place(low)
    assert height_m == pytest.approx(-0.916 + 2.2)
    assert raised.road_z_m == pytest.approx(-2.2)
    assert torch.allclose(raised.ego_from_camera[:, 2, 3], low.ego_from_camera[:, 2, 3] - height_m)
    assert "0.916 m below the origin of the rig (its road_z_m), 2.2 m in the training: the grid lies 1.28 m hi" in line
    assert own.place(with_road(low, -2.2))[1:] == (0.0, "")
    assert "lies 0.8 m lower" in own.place(with_road(low, -3.0))[2]
    kept, height_m, line = trained_with("data.source.rig=random").place(low)
    assert (kept, height_m) == (low, 0.0)
    assert "stays around the origin of the rig" in line
    unknown = replace(low, road_z_m=None)
    line = trained_with("data.source.rig=random").place(unknown)[2]
    assert line.startswith("its height is not known: write road_z_m into the rig file")
    kept, height_m, line = own.place(unknown)
    assert (kept, height_m) == (unknown, 0.0)
    assert all(word in line for word in ("road_z_m", "-2.2 m", "rig file"))
    assert own.place(own.rig)[2] == ""
    with pytest.raises(UserError, match="road_z_m"):
        with_road(low, 0.3)


def test_the_cameras_of_the_training_are_known_also_where_only_one_rig_states_the_road():
    own = trained_with()
    assert own.rig.road_z_m is None
    assert own.compare(replace(Rig.load("fisheye6"), road_z_m=-2.2)) == "as in training"
    assert own.compare(Rig.load("surround_view")) == "not those of the training (fisheye6): expect worse results"
    for name in ("random", "any"):
        assert replace(own, rig_name=name).compare(Rig.load("surround_view")) == "the weights are for any rig"
