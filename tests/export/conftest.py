from collections.abc import Callable

import pytest
import torch

from omniocc.camera import Rig
from omniocc.config import build
from omniocc.model import OccupancyModel

WIDTH, HEIGHT = 64, 36


@pytest.fixture(scope="session")
def rig() -> Rig:
    return Rig.load("fisheye6").resized(WIDTH, HEIGHT)


@pytest.fixture(scope="session")
def make_model(smoke, as_trained) -> Callable[..., OccupancyModel]:
    """Return a function that builds a smoke model with random weights, in evaluation mode."""

    def make(*overrides: str) -> OccupancyModel:
        torch.manual_seed(0)
        return as_trained(build(smoke(*overrides).model)).eval()

    return make


@pytest.fixture(scope="session")
def draw_images() -> Callable[..., torch.Tensor]:
    """Return a function that draws noise in large patches, so that predicted ranges differ, with some cameras black."""

    def draw(seed: int, black: tuple[int, ...] = ()) -> torch.Tensor:
        generator = torch.Generator().manual_seed(seed)
        patches = torch.randint(0, 256, (6, 3, HEIGHT // 4, WIDTH // 4), generator=generator).float()
        images = torch.nn.functional.interpolate(patches, scale_factor=4).to(torch.uint8)
        images[list(black)] = 0
        return images

    return draw
