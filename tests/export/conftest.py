from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from hydra import compose, initialize_config_dir

from omniocc.camera import Rig
from omniocc.config import build
from omniocc.model import OccupancyModel

CONF = Path(__file__).parents[2] / "conf"
WIDTH, HEIGHT = 64, 36


@pytest.fixture(scope="session")
def rig() -> Rig:
    return Rig.load("fisheye6").resized(WIDTH, HEIGHT)


@pytest.fixture(scope="session")
def make_model() -> Callable[..., OccupancyModel]:
    """Builds a smoke model with random weights, evaluation mode."""

    def make(*overrides: str) -> OccupancyModel:
        with initialize_config_dir(str(CONF), version_base="1.3"):
            cfg = compose("train", overrides=["preset=smoke", *overrides])
        torch.manual_seed(0)
        return build(cfg.model).eval()

    return make


@pytest.fixture(scope="session")
def draw_images() -> Callable[..., torch.Tensor]:
    """Noise in large patches, so that frames differ in what is near, with some cameras black."""

    def draw(seed: int, black: tuple[int, ...] = ()) -> torch.Tensor:
        generator = torch.Generator().manual_seed(seed)
        patches = torch.randint(0, 256, (6, 3, HEIGHT // 4, WIDTH // 4), generator=generator).float()
        images = torch.nn.functional.interpolate(patches, scale_factor=4).to(torch.uint8)
        images[list(black)] = 0
        return images

    return draw
