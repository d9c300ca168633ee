"""Logs of the virtual world, as folders and as bags, give back what the LiDAR and the cameras of the scene saw."""

import shlex

import numpy as np
import pytest

pytest.importorskip("rosbags")
from log_files import built
from world_log import START_NS, record_command, write_bag, write_folder

from omniocc.data import SceneReader
from omniocc.errors import UserError

POSE = "ego_from_lidar: {position_m: [0, 0, 0], quaternion_wxyz: [1, 0, 0, 0]}"


@pytest.mark.parametrize("kind", ["files", "bag"])
def test_a_scene_comes_back_from_its_log(original, tmp_path, kind):
    log = tmp_path / "logs" / original.name
    (write_bag if kind == "bag" else write_folder)(original, log)
    given = [f"log={log}", "name=train-000-own", f"lidar={{folder: lidar, {POSE}}}"]
    if kind == "bag":
        words = shlex.split(record_command(original, log, tmp_path / "recorded"))
        assert words[:4] == ["python", "src/record.py", f"output={tmp_path / 'recorded'}", "recorder=bag"]
        given = [word.removeprefix("recorder.") for word in words[4:]]
    scene = SceneReader(built(kind, *given).record(tmp_path / "recorded")[0])
    assert (scene.rig.names, scene.rig.cameras) == (original.rig.names, original.rig.cameras)
    np.testing.assert_allclose(scene.rig.ego_from_camera, original.rig.ego_from_camera, atol=1e-6)
    assert scene.meta["facts"]["start_s"] == START_NS / 1e9
    np.testing.assert_allclose(scene.world_from_ego, original.world_from_ego, atol=1e-9)
    np.testing.assert_allclose(scene.time_s, original.time_s, atol=1e-6)
    for frame in range(len(original)):
        for image, seen in zip(scene.images(frame), original.images(frame), strict=True):
            assert np.abs(image.astype(int) - seen).mean() < 4  # both are stored as JPEG
        scan = original.lidar(frame)
        hit = np.isfinite(scan.range_m)
        points_m = np.sort(np.linalg.norm(scene.points(frame).points_m, axis=1))
        np.testing.assert_allclose(points_m, np.sort(scan.range_m[hit]), atol=0.02)
        assert set(scene.points(frame).labels.tolist()) == {1}


def test_a_scene_without_a_lidar_makes_no_log(original, tmp_path, monkeypatch):
    monkeypatch.setattr(SceneReader, "lidar", lambda self, frame: None)
    with pytest.raises(UserError, match="the scene has no LiDAR"):
        write_folder(original, tmp_path / "log")
