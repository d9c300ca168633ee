import cv2
import numpy as np
import pytest
import torch

from omniocc.camera import Equirectangular
from omniocc.model.depth import DepthMap
from omniocc.predict.output.panorama_files import write_depth
from omniocc.predict.output.point_cloud import PointCloud

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
