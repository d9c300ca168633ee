"""The bag of predictions, read back by the libraries of Foxglove, which share nothing with rosbags."""

from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

pytest.importorskip("rosbags")
pytest.importorskip("mcap_ros2")
from made_scenes import RIG, write_checkpoint, write_scene
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from omniocc.classes import FREE, UNKNOWN
from omniocc.data import SceneReader
from omniocc.errors import DataError, UserError
from omniocc.extras.recorders import bag_writer
from omniocc.extras.recorders.bag_predictions import BAGS
from omniocc.extras.recorders.messages import cloud_of
from omniocc.predict.depth import predict_panoramas
from omniocc.predict.export_scene import export_scene
from omniocc.predict.input.sequence import ALONE, Mount
from omniocc.predict.occupancy import options_of, predict_occupancy
from omniocc.predict.output.bag import BagContent, BagFrame
from omniocc.predict.output.voxel_files import read_voxels

FRAMES = ("000000", "000001", "000002")
QUICK = ("overview=false", "mesh=false")
pytestmark = pytest.mark.filterwarnings("ignore:Sparse CSR")


@pytest.fixture(scope="module")
def images(tmp_path_factory, spec) -> Path:
    folder = tmp_path_factory.mktemp("images")
    export_scene(write_scene(folder / "test-000-nowhere", spec, 0, len(FRAMES), RIG), folder / "files")
    return folder / "files"


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory, smoke, spec) -> Path:
    return write_checkpoint(tmp_path_factory.mktemp("run") / "best.ckpt", smoke(), spec)


@pytest.fixture
def predict(composed, checkpoint, images, tmp_path):
    def run(*more: str, show=None) -> Path:
        given = (
            f"checkpoint={checkpoint}",
            f"images={images}",
            f"rig={images / 'rig.yaml'}",
            f"output={tmp_path / 'out'}",
        )
        options = options_of(
            composed(*given, *QUICK, f"write_bag={tmp_path / 'out.mcap'}", *more, name="predict_occupancy")
        )
        predict_occupancy(options, show, BAGS)
        return tmp_path / "out.mcap"

    return run


def messages_of(path: Path) -> dict[str, list]:
    """Return the log time, ns, and the decoded message of each topic, by Foxglove's reader."""
    found: dict[str, list] = {}
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        (stated,) = reader.iter_metadata()
        assert yaml.safe_load(stated.metadata["serialized_metadata"])["relative_file_paths"] == [path.name]
        for _, channel, message, decoded in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append((message.log_time, decoded))
    return found


def points_of(message) -> np.ndarray:
    assert [(field.name, field.offset, field.datatype) for field in message.fields] == [
        ("x", 0, 7),
        ("y", 4, 7),
        ("z", 8, 7),
        ("rgb", 12, 7),
        ("label", 16, 6),
    ]
    assert (message.height, message.point_step, message.row_step) == (1, 20, 20 * message.width)
    kinds = [("xyz", "<f4", 3), ("bgr", "u1", 3), ("none", "u1"), ("label", "<u4")]
    return np.frombuffer(bytes(message.data), kinds)


def stamp_ns(message) -> int:
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def test_voxels_and_ranges_come_back(predict, tmp_path, capsys):
    path = predict("road_z_m=-0.9")
    assert "3 frames; topics /tf_static, /omniocc/voxels, /omniocc/range; frame ego" in capsys.readouterr().out
    found = messages_of(path)
    assert {topic: len(rows) for topic, rows in found.items()} == {
        "/tf_static": 1,
        "/omniocc/voxels": 3,
        "/omniocc/range": 3,
    }
    for number, frame in enumerate(FRAMES):
        file = tmp_path / "out" / frame / "voxels.npz"
        voxels = read_voxels(file)
        (time_ns, cloud), (_, panorama) = (found[topic][number] for topic in ("/omniocc/voxels", "/omniocc/range"))
        assert time_ns == stamp_ns(cloud) == stamp_ns(panorama) == number * 10**9
        assert (cloud.header.frame_id, panorama.header.frame_id) == ("ego", "omniocc_panorama")
        points = points_of(cloud)
        occupied = ((voxels.labels != FREE) & (voxels.labels != UNKNOWN)).numpy()
        assert occupied.any()
        np.testing.assert_array_equal(points["label"], voxels.labels.numpy()[occupied])
        centers = voxels.geometry.centers(torch.float64).numpy()[occupied]
        np.testing.assert_allclose(points["xyz"], centers, atol=1e-5)
        np.testing.assert_array_equal(points["bgr"][:, ::-1], voxels.classes.palette[points["label"]])
        assert (panorama.encoding, panorama.step, panorama.is_bigendian) == ("32FC1", 4 * panorama.width, 0)
        range_m = np.frombuffer(bytes(panorama.data), "<f4").reshape(panorama.height, panorama.width)
        np.testing.assert_array_equal(range_m, np.load(file)["range_m"])
        assert cloud_of(cloud, None, "here").labels.tolist() == points["label"].tolist()  # by the recorder of bags
    (transform,) = found["/tf_static"][0][1].transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("ego", "omniocc_panorama")
    raised_m = float(np.load(tmp_path / "out" / FRAMES[0] / "voxels.npz")["range_origin_z_m"])
    assert transform.transform.translation.z == raised_m == pytest.approx(1.3)


def test_a_killed_run_writes_the_bag_by_the_same_command_and_predicts_nothing_twice(predict, tmp_path):
    seen = []

    def stop(job, sequence, frame, *_) -> None:
        seen.append(frame)
        if len(seen) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        predict(show=stop)
    assert not (tmp_path / "out.mcap").exists()
    half = tmp_path / ".out.mcap.partial"  # of a process that was killed while it wrote
    half.mkdir()
    (half / "out.mcap").write_bytes(b"\x89MCAP0\r\n")
    whole = predict(show=stop).read_bytes()
    assert seen == [0, 1, 2]
    assert predict(show=stop).read_bytes() == whole  # and again
    assert seen == [0, 1, 2]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "out.mcap"]


def test_ranges_come_back(images, composed, tmp_path):
    given = f"images={images}", f"rig={images / 'rig.yaml'}", f"output={tmp_path / 'out'}"
    given += "checkpoint=sweep", "preset=smoke", "image_width=64", f"write_bag={tmp_path / 'ranges.mcap'}"
    predict_panoramas(composed(*given, name="predict_depth"), list(given), bags=BAGS)
    found = messages_of(tmp_path / "ranges.mcap")
    assert {topic: len(rows) for topic, rows in found.items()} == {
        "/tf_static": 1,
        "/omniocc/points": 3,
        "/omniocc/range": 3,
    }
    cloud, panorama = (found[topic][1][1] for topic in ("/omniocc/points", "/omniocc/range"))
    range_m = np.frombuffer(bytes(panorama.data), "<f4").reshape(panorama.height, panorama.width)
    np.testing.assert_array_equal(range_m, np.load(tmp_path / "out" / FRAMES[1] / "range.npz")["range_m"])
    assert cloud.width == np.isfinite(range_m).sum() > 0
    xyz = np.frombuffer(bytes(cloud.data), [("xyz", "<f4", 3), ("rgb", "<u4")])["xyz"]
    np.testing.assert_allclose(np.linalg.norm(xyz, axis=1), range_m[np.isfinite(range_m)], rtol=1e-5)


def frames_of(count: int):
    for number in range(count):
        points = np.full((2, 3), number, np.float32)
        yield BagFrame(number * 10**9 + 7, points, np.zeros((2, 3), np.uint8), np.array([1, 2], np.uint8), None)


def test_an_ego_frame_beside_that_of_the_vehicle_is_told(tmp_path):
    base_from_ego = np.array([[0.0, -1, 0, 1.5], [1, 0, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]])
    content = BagContent(Mount("ego", "base_link", base_from_ego), 0.0, frames_of(1), 1)
    bag_writer.write_bag(tmp_path / "a.mcap", content)
    found = messages_of(tmp_path / "a.mcap")
    assert "/omniocc/range" not in found
    _, ego = found["/tf_static"][0][1].transforms
    assert (ego.header.frame_id, ego.child_frame_id) == ("base_link", "ego")
    moved, turn = ego.transform.translation, ego.transform.rotation
    assert (moved.x, moved.y, moved.z) == (1.5, 0, 2)
    np.testing.assert_allclose([turn.x, turn.y, turn.z, turn.w], [0, 0, np.sqrt(0.5), np.sqrt(0.5)], atol=1e-12)
    assert stamp_ns(found["/omniocc/voxels"][0][1]) == 7


def test_a_bag_that_cannot_be_finished_leaves_the_one_before(tmp_path):
    path = tmp_path / "a.mcap"
    bag_writer.write_bag(path, BagContent(ALONE, 0.0, frames_of(2), 2))
    before = path.read_bytes()

    def broken():
        yield from frames_of(1)
        raise DataError("voxels.npz is damaged")

    with pytest.raises(DataError, match=r"^voxels\.npz is damaged$"):
        bag_writer.write_bag(path, BagContent(ALONE, 0.0, broken(), 2))
    assert path.read_bytes() == before
    assert [one.name for one in tmp_path.iterdir()] == ["a.mcap"]
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(DataError, match=r"cannot write .*b\.mcap"):
        bag_writer.write_bag(tmp_path / "file" / "b.mcap", BagContent(ALONE, 0.0, frames_of(1), 1))


def test_a_bag_takes_one_recorded_scene_with_its_times(tmp_path, spec, checkpoint, composed):
    for name in ("test-000-here", "test-001-there"):
        write_scene(tmp_path / "data" / name, spec, 0, 1 + 1, RIG)
    given = f"checkpoint={checkpoint}", f"recorded={tmp_path / 'data'}", f"output={tmp_path / 'out'}", *QUICK
    given += (f"write_bag={tmp_path / 'out.mcap'}",)
    with pytest.raises(UserError, match=r"takes one sequence of 2; choose one: scene="):
        predict_occupancy(options_of(composed(*given, name="predict_occupancy")), None, BAGS)
    chosen = composed(*given, "scene=test-001-there", "force=true", name="predict_occupancy")
    predict_occupancy(options_of(chosen), None, BAGS)
    scene = SceneReader(tmp_path / "data" / "test-001-there")
    times_ns = [time_ns for time_ns, _ in messages_of(tmp_path / "out.mcap")["/omniocc/voxels"]]
    assert times_ns == [round(time_s * 1e9) for time_s in scene.time_s]
