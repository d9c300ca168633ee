import os
import subprocess
import sys
from pathlib import Path

import numpy as np

import omniocc
from omniocc.camera import Rig
from omniocc.data.store import codec
from omniocc.data.store.check import check_scene
from omniworld import Scene, VirtualWorld


def test_recorded_frames_equal_those_of_the_world(tmp_path):
    world = VirtualWorld(
        root=str(tmp_path),
        rig="fisheye6",
        image_size=(48, 27),
        themes=["suburb"],
        train_scenes=0,
        val_scenes=1,
        test_scenes=0,
        frames_per_scene=2,
        frame_interval_s=0.5,
        supersample=2,
        erp_size=(32, 8),
        erp_top_deg=45.0,
        erp_bottom_deg=-45.0,
        workers=0,
    )
    world.prepare()
    (reader,) = world.scenes("val")
    assert check_scene(reader, 2, 0.5) == []
    rig = Rig.load("fisheye6").resized(48, 27)
    frame = Scene("suburb", 1_000_000, rig, 0.5, 2, (32, 8), 45.0, -45.0).frame(1)
    back = codec.decode_frame(reader.read(1, reader.index.members))
    assert reader.rig == rig
    np.testing.assert_array_equal(back.semantics, frame.semantics)
    np.testing.assert_array_equal(back.lidar_labels, frame.lidar_labels)
    np.testing.assert_array_equal(reader.world_from_ego[1], frame.world_from_ego)
    assert back.boxes == frame.boxes
    for name in ("range_m", "erp_range_m", "lidar_range_m"):
        expected = np.minimum(
            getattr(frame, name), 65534 / 256, where=np.isfinite(getattr(frame, name)), out=getattr(frame, name)
        )
        np.testing.assert_allclose(getattr(back, name), expected, rtol=0, atol=1 / 512 + 1e-5, err_msg=name)
    assert len(back.points_m) == len(frame.points_m)
    assert np.bincount(back.point_labels).tolist() == np.bincount(frame.point_labels).tolist()


def test_render_processes_import_neither_lightning_nor_torchmetrics():
    # both take longer to import than everything else together
    code = "import omniworld.source, sys; print(sorted({'lightning', 'torchmetrics'} & set(sys.modules)))"
    environment = {**os.environ, "PYTHONPATH": str(Path(omniocc.__file__).parents[1])}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
