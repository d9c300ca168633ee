import math

import pytest
import torch

from omniocc.camera import Equidistant, Rig
from omniocc.camera.pose import pose_from_angles
from omniocc.geometry import Cuboid, Cylinder
from omniocc.model import OccupancyModel
from omniocc.model.backbone import ResNet
from omniocc.model.hints import SketchAndPixels
from omniocc.model.lifter import Coloring
from omniocc.model.refiner import UNet
from omniocc.model.semantic_head import FCN
from omniocc.model.sketch import Dense
from omniocc.model.temporal import NoTemporal

WIDTH, HEIGHT = 64, 36


@pytest.fixture(autouse=True)
def _seed():
    torch.manual_seed(0)


@pytest.fixture(params=["cylinder", "cuboid"])
def geometry(request):
    return Cylinder((8, 12, 4)) if request.param == "cylinder" else Cuboid((8, 8, 4))


@pytest.fixture(scope="session")
def fisheye():
    return Rig.load("fisheye6").resized(WIDTH, HEIGHT)


@pytest.fixture(scope="session")
def pinhole():
    return Rig.load("pinhole6").resized(WIDTH, HEIGHT)


@pytest.fixture
def images():
    return torch.randint(0, 256, (2, 1, 6, 3, HEIGHT, WIDTH), dtype=torch.uint8)


@pytest.fixture
def poses():
    return torch.eye(4, dtype=torch.float64).expand(2, 1, 4, 4)


@pytest.fixture
def make_backbone():
    return lambda levels=(4,): ResNet("basic", 8, [8, 8, 16, 16], [1, 1, 1, 1], None, 8, list(levels))


@pytest.fixture
def make_model(make_backbone, as_trained):
    def make(geometry, sketch=None):
        model = OccupancyModel(
            make_backbone([4, 8]),
            geometry,
            sketch or Dense(geometry),
            Coloring(geometry, 8, [4, 8], layers=2, heads=2, points=2, feedforward_channels=16),
            NoTemporal(),
            UNet(geometry, 8, [8, 8, 16]),
            FCN(8, 8, 12),
            SketchAndPixels(geometry, 4, 8, 12),
            num_classes=12,
        )
        return as_trained(model)

    return make


def ring(count: int, width: int = 64, height: int = 36, radius_m: float = 0.9, masks=None) -> Rig:
    """Fisheyes of 190 degrees on a circle, looking outwards."""
    focal_px = width / 2 / math.radians(95)
    camera = Equidistant(width, height, focal_px, ((width - 1) / 2, (height - 1) / 2), 95.0)
    yaws = [-360 / count * k for k in range(count)]
    poses = [
        pose_from_angles(
            (radius_m * math.cos(math.radians(yaw)), radius_m * math.sin(math.radians(yaw)), 0.0), yaw, -10.0, 0.0
        )
        for yaw in yaws
    ]
    return Rig((camera,) * count, torch.stack(poses), tuple(f"camera{k}" for k in range(count)), masks)


@pytest.fixture(scope="session")
def rig() -> Rig:
    return ring(6)


@pytest.fixture(scope="session")
def make_ring():
    return ring


def compare(result, expected, tensors):
    """Compare two results, and their gradients in `tensors` for random weights of the results."""
    torch.testing.assert_close(result, expected)
    weights = torch.randn_like(result)
    gradients = torch.autograd.grad((result * weights).sum(), tensors)
    references = torch.autograd.grad((expected * weights).sum(), tensors)
    for gradient, reference in zip(gradients, references, strict=True):
        torch.testing.assert_close(gradient, reference)


@pytest.fixture
def assert_same_gradients():
    return compare
