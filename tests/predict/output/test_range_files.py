import math

import cv2
import numpy as np
import pytest
import torch

from omniocc.camera import Equidistant, Equirectangular, Rig
from omniocc.model.depth import DepthMap
from omniocc.predict import point_cloud, write_ply
from omniocc.predict.output.range_files import PointCloud, point_colors, write_depth

# two cameras at the origin, one faces ahead, the other left; each sees 100 degrees to every side of its axis
AHEAD = torch.tensor([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]], dtype=torch.float64)
LEFT = torch.tensor([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]], dtype=torch.float64)
CAMERA = Equidistant(101, 101, 25.0, (50.0, 50.0), 100.0)
RIG = Rig((CAMERA, CAMERA), torch.stack([AHEAD, LEFT]), ("ahead", "left"))
RED, BLUE = (200, 10, 10), (10, 10, 200)
IMAGES = [np.full((101, 101, 3), rgb, np.uint8) for rgb in (RED, BLUE)]


def at(azimuth_deg, range_m=5.0):
    azimuth = math.radians(azimuth_deg)
    return [range_m * math.cos(azimuth), range_m * math.sin(azimuth), 0.0]


def test_the_camera_that_faces_the_point_gives_the_colour():
    points = torch.tensor([at(0), at(40), at(50), at(90), at(-60), at(-120)], dtype=torch.float64)
    colors, seen = point_colors(points, IMAGES, RIG)
    assert seen.tolist() == [True] * 5 + [False]
    assert colors[:5].tolist() == [list(rgb) for rgb in (RED, RED, BLUE, BLUE, RED)]


def test_a_black_image_gives_no_colour():
    colors, seen = point_colors(torch.tensor([at(40), at(-60)], dtype=torch.float64), [0 * IMAGES[0], IMAGES[1]], RIG)
    assert seen.tolist() == [True, False]
    assert tuple(colors[0].tolist()) == BLUE


def test_the_colour_is_that_of_the_pixel_also_in_a_larger_image():
    image = np.zeros((202, 202, 3), np.uint8)
    azimuth = 31.0
    column = 50 - 25 * math.radians(azimuth)  # of the calibrated image
    image[:, round((column + 0.5) * 2 - 0.5)] = 255
    shades = [
        int(point_colors(torch.tensor([at(azimuth + turn)], dtype=torch.float64), [image, 0 * image], RIG)[0][0, 0])
        for turn in (-3.0, 0.0, 3.0)
    ]
    assert shades[1] > 100
    assert shades[0] == shades[2] == 0


def test_points_lie_in_the_direction_of_their_pixel():
    panorama = Equirectangular(8, 2, 10.0, -10.0)
    ranges = torch.full((2, 8), torch.nan)
    ranges[0, 2] = 4.0  # azimuth 67.5 degrees, elevation 5
    cloud = point_cloud(ranges, panorama, IMAGES, RIG)
    flat = 4 * math.cos(math.radians(5))
    expected = [flat * math.cos(math.radians(67.5)), flat * math.sin(math.radians(67.5)), 4 * math.sin(math.radians(5))]
    assert torch.allclose(cloud.points_m[0, 2], torch.tensor(expected).double(), atol=1e-5)
    assert tuple(cloud.colors[0, 2].tolist()) == BLUE
    assert int(cloud.points_m.isfinite().all(-1).sum()) == 1


def read_ply(path):
    header, _, body = path.read_bytes().partition(b"end_header\n")
    lines = header.decode().splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    (count,) = (int(line.split()[2]) for line in lines if line.startswith("element vertex"))
    kinds = {"float": "<f4", "uchar": "u1"}
    fields = [line.split()[1:] for line in lines if line.startswith("property")]
    rows = np.frombuffer(body, [(name, kinds[kind]) for kind, name in fields])
    assert len(rows) == count
    return rows


def test_a_ply_file_read_back(tmp_path):
    points = torch.tensor([[[1.5, -2.0, 0.25], [torch.nan] * 3], [[-7.0, 8.0, 9.0], [1.0, torch.inf, 0.0]]]).double()
    colors = torch.arange(12, dtype=torch.uint8).view(2, 2, 3) + 240
    assert write_ply(tmp_path / "points.ply", PointCloud(points, colors)) == 2
    rows = read_ply(tmp_path / "points.ply")
    assert [tuple(row) for row in rows] == [(1.5, -2.0, 0.25, 240, 241, 242), (-7.0, 8.0, 9.0, 246, 247, 248)]


RANGE_M = torch.tensor([[1.0, 2.5, 0.001], [300.0, 7.0, 12.34]])
VALID = torch.tensor([[True, True, True], [True, False, True]])


def test_files_read_back(tmp_path):
    depth = DepthMap(RANGE_M[None], RANGE_M[None], VALID[None], torch.full((1, 2, 3), 0.5))
    cloud = PointCloud(torch.full((2, 3, 3), torch.nan).double(), torch.zeros(2, 3, 3, dtype=torch.uint8))
    overview = np.full((4, 5, 3), 7, np.uint8)
    count = write_depth(tmp_path / "a" / "b", depth, Equirectangular(3, 2, 40.0, -50.0), cloud, overview)
    assert count == 0
    code = cv2.imread(str(tmp_path / "a/b/range.png"), cv2.IMREAD_UNCHANGED)
    known = VALID.numpy() & (RANGE_M.numpy() < 255)
    assert (np.abs(code / 256 - RANGE_M.numpy())[known] <= 1 / 256).all()
    assert code.dtype == np.uint16
    assert code.tolist() == [[256, 640, 1], [65534, 0, 3159]]
    kept = np.load(tmp_path / "a/b/range.npz")
    assert np.array_equal(kept["range_m"], RANGE_M.masked_fill(~VALID, torch.nan).numpy(), equal_nan=True)
    assert kept["range_m"].dtype == kept["confidence"].dtype == np.float32
    assert (float(kept["top_deg"]), float(kept["bottom_deg"])) == (40.0, -50.0)
    assert cv2.imread(str(tmp_path / "a/b/overview.png")).shape == (4, 5, 3)
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OSError, match="file"):
        write_depth(tmp_path / "file", depth, Equirectangular(3, 2, 40.0, -50.0), cloud, overview)
