"""`predict.py` on a bag: its predictions are those of the same images in files."""

import re
import weakref
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("rosbags")
from bag_files import BagWriter, write_bag, write_image, write_info
from log_files import START_NS, rig_of, stamp_ns
from made_scenes import RIG, write_checkpoint, write_scene
from rosbags.rosbag2 import StoragePlugin
from scripts import run_script

from omniocc.camera import Rig
from omniocc.data import SceneReader
from omniocc.errors import DataError, UserError
from omniocc.extras.recorders import bag as bag_module
from omniocc.extras.recorders.bag import Bag
from omniocc.extras.recorders.bag_predictions import BAGS
from omniocc.images import Depth
from omniocc.predict.depth import predict_panoramas
from omniocc.predict.export_scene import export_scene
from omniocc.predict.input.own import BagImages, is_bag
from omniocc.predict.input.sequence import Mount
from omniocc.predict.occupancy import options_of, predict_occupancy

FRAMES = 4
TOPICS = "world_frame: map\nego_from_base: {position_m: [-1.5, 0, -2], quaternion_wxyz: [1, 0, 0, 0]}\n"
QUICK = ("overview=false", "mesh=false")
pytestmark = pytest.mark.filterwarnings("ignore:Sparse CSR")


def mcap(path: Path, ros: int) -> BagWriter:
    return BagWriter(path, ros, storage_plugin=StoragePlugin.MCAP)


@pytest.fixture(scope="module")
def scene(tmp_path_factory, spec) -> SceneReader:
    return SceneReader(write_scene(tmp_path_factory.mktemp("data") / "test-000-nowhere", spec, 0, FRAMES, RIG))


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory, smoke, spec) -> Path:
    return write_checkpoint(tmp_path_factory.mktemp("run") / "best.ckpt", smoke(), spec)


@pytest.fixture(scope="module")
def drive(scene, tmp_path_factory) -> Path:
    """Return a bag of the scene as one mcap file; its rig and a file of topics lie beside it."""
    folder = tmp_path_factory.mktemp("bags")
    rig_of(scene).save(folder / "rig.yaml")
    (folder / "topics.yaml").write_text(TOPICS)
    return write_bag(scene, folder / "drive", 2, mcap) / "drive.mcap"


@pytest.fixture
def predict(composed, checkpoint, tmp_path):
    """Return a function that predicts occupancy in this process."""

    def run(bag: Path, *more: str, rig: Path | None = None, output: str = "out", show=None) -> Path:
        given = [f"checkpoint={checkpoint}", f"images={bag}", f"output={tmp_path / output}", *QUICK, *more]
        given += [] if rig is None else [f"rig={rig}"]
        predict_occupancy(options_of(composed(*given, name="predict_occupancy")), show, BAGS)
        return tmp_path / output

    return run


def labels_in(folder: Path) -> np.ndarray:
    return np.stack([np.load(path)["labels"] for path in sorted(folder.glob("*/voxels.npz"))])


@pytest.mark.parametrize("kind", ["mcap file", "folder", "ros1"])
def test_a_bag_gives_the_predictions_of_its_images(scene, drive, predict, tmp_path, capsys, kind):
    bag = {"mcap file": drive, "folder": drive.parent}.get(kind) or write_bag(scene, tmp_path / "log.bag", 1)
    beside = drive.parent.parent
    assert is_bag(str(bag))
    out = predict(bag, f"topics={beside / 'topics.yaml'}", rig=beside / "rig.yaml")
    told = capsys.readouterr().out
    assert "topics    front: /front/image, front_right: /front_right/image" in told
    assert "poses     tf: base_link in map\n" in told
    assert "history   stream" in told
    assert sorted(path.parent.name for path in out.glob("*/voxels.npz")) == [
        str(stamp_ns(scene, frame)) for frame in range(FRAMES)
    ]
    export_scene(scene.folder, tmp_path / "files")
    files = predict(
        tmp_path / "files", f"poses={tmp_path / 'files/poses.csv'}", rig=tmp_path / "files/rig.yaml", output="of_files"
    )
    assert len(np.unique(labels_in(files))) > 3
    assert (labels_in(out) == labels_in(files)).mean() > 0.999  # poses are rounded on their way through tf


def test_poses_are_those_of_tf_or_odometry_or_none(scene, drive, predict, tmp_path, capsys):
    rig, topics = drive.parent.parent / "rig.yaml", tmp_path / "topics.yaml"
    for poses, words in (("/odometry", "poses     /odometry"), ("null", "poses     none: frames are predicted")):
        topics.write_text(f"{TOPICS}poses: {poses}\n")
        out = predict(drive, f"topics={topics}", rig=rig, output=poses.strip("/"))
        assert words in capsys.readouterr().out
        first = np.load(out / str(stamp_ns(scene, 1)) / "voxels.npz")
        assert ("world_from_ego" in first) == (poses != "null")
        if poses != "null":
            np.testing.assert_allclose(first["world_from_ego"], scene.world_from_ego[1], atol=1e-9)


def test_a_stopped_run_goes_on_without_predicting_twice(drive, predict):
    rig, seen = drive.parent.parent / "rig.yaml", []

    def stop(job, sequence, frame, *_) -> None:
        seen.append(frame)
        if len(seen) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        predict(drive, rig=rig, show=stop)
    predict(drive, rig=rig, show=stop)
    assert seen == [0, 1, 2, 3]


def test_images_of_two_frames_at_most_are_alive(scene, predict, tmp_path, monkeypatch):
    """However long the bag is; a third frame that is read before the first is gone fails."""
    with BagWriter(tmp_path / "long", 2) as bag:
        for frame in range(12):
            for name in RIG.names:
                write_image(bag, name, START_NS + frame * 10**8, scene.images(frame % FRAMES)[0])
    rig_of(scene).save(tmp_path / "rig.yaml")
    alive, most, read = set(), [0], bag_module.image_of

    def counted(*given):
        image = read(*given)
        weakref.finalize(image, alive.discard, token := object())
        alive.add(token)
        most[0] = max(most[0], len(alive))
        return image

    monkeypatch.setattr(bag_module, "image_of", counted)
    out = predict(tmp_path / "long", "history=none", rig=tmp_path / "rig.yaml")
    assert len(labels_in(out)) == 12
    assert len(RIG.names) <= most[0] <= 2 * len(RIG.names)
    assert not alive


def test_ranges_of_a_bag_whose_cameras_are_in_it(scene, tmp_path, composed, capsys):
    poses = scene.rig.ego_from_camera.numpy()
    with mcap(tmp_path / "log", 2) as bag:
        bag.transforms(
            "/tf_static", START_NS, [("base_link", name, poses[k]) for k, name in enumerate(("front", "rear"))]
        )
        for name in ("front", "rear"):
            write_image(bag, name, START_NS, scene.images(0)[0])
            write_info(bag, name, START_NS, "equidistant", (64, 36), [40.0, 0, 31.5, 0, 41, 17.5, 0, 0, 1], [0.0] * 4)
    given = (f"images={tmp_path / 'log'}", f"output={tmp_path / 'out'}", "road_z_m=-2.2")
    predict_panoramas(composed(*given, name="predict_depth"), list(given), bags=BAGS)
    told = capsys.readouterr()
    assert "topics    front: /front/image, rear: /rear/image (guessed" in told.out
    assert "poses     none" in told.out
    assert "1/1 frames" in told.err
    assert np.isfinite(np.load(tmp_path / "out" / str(START_NS) / "range.npz")["range_m"]).any()


def bag_of(path: Path, scene: SceneReader, change) -> Path:
    """Write a bag of images alone; `change(frame, camera, stamp)` returns another time, or None to leave it out."""
    with BagWriter(path, 2) as bag:
        for frame in range(FRAMES):
            for k, name in enumerate(RIG.names):
                if (now := change(frame, name, START_NS + frame * 10**8)) is not None:
                    kept, bag.header = bag.header, lambda _, frame_id, now=now, make=bag.header: make(now, frame_id)
                    write_image(bag, name, START_NS + frame * 10**8 + k, scene.images(frame)[k])
                    bag.header = kept
    return path


def test_frames_with_fewer_cameras_are_left_out_and_told(scene, drive, predict, tmp_path, capsys):
    bag = bag_of(tmp_path / "log", scene, lambda frame, name, now: None if (frame, name) == (1, "rear") else now)
    out = predict(bag, rig=drive.parent.parent / "rig.yaml")
    assert len(labels_in(out)) == 3
    line = (
        r"frames    1 of 4 are left out, without a sample within 0.05 s \(rear in 1\); the first is at \d+\.\d{6} s\n"
    )
    assert re.search(line, capsys.readouterr().out)
    assert not (out / str(START_NS + 10**8)).exists()


def test_times_that_run_backwards_are_told_but_not_messages_that_overtake_each_other(scene, drive, predict, tmp_path):
    rig = drive.parent.parent / "rig.yaml"
    back = bag_of(tmp_path / "back", scene, lambda frame, _, now: now if frame < 2 else now - 10 * 10**9)
    out = predict(drive, rig=rig)
    made = {path: path.read_bytes() for path in out.glob("*/voxels.npz")}
    with pytest.raises(
        UserError, match=r"/front/image: times run backwards: .* comes after .* s; was the clock"
    ) as caught:
        predict(back, rig=rig)
    assert "\n" not in str(caught.value)
    assert {path: path.read_bytes() for path in out.glob("*/voxels.npz")} == made
    swap = {1: 20_000_000, 2: -20_000_000}  # frames 0, 1, 2, 3 at 0, 120, 80 ... ms: 2 overtakes 1 by 40 ms
    overtaken = bag_of(
        tmp_path / "swap",
        scene,
        lambda frame, _, now: START_NS + frame // 3 * 10**9 + 10**8 * (frame > 0) + swap.get(frame, 0),
    )
    assert len(labels_in(predict(overtaken, rig=rig, output="swapped"))) == FRAMES


def test_mistakes_get_one_line(scene, drive, predict, tmp_path):
    rig, topics = drive.parent.parent / "rig.yaml", tmp_path / "topics.yaml"
    topics.write_text("front: /front/image\nmiddle: /front/image\n")
    few = tmp_path / "few.yaml"
    few.write_text("front: /front/image\n")
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text("front: /points\n" + "".join(f"{name}: /{name}/image\n" for name in RIG.names[1:]))
    other = tmp_path / "other.yaml"
    Rig(RIG.cameras[:1], RIG.ego_from_camera[:1], ("nose",)).save(other)
    two = tmp_path / "two.yaml"
    Rig(RIG.cameras[:2], RIG.ego_from_camera[:2], ("nose", "tail")).save(two)
    cases = (
        ([], None, f"rig=... is needed: {drive} has no CameraInfo; topics of CameraInfo: none"),
        ([], two, "no topic of images fits camera 'nose'; topics of images: /front/image, /front_left/image"),
        ([f"topics={topics}"], rig, "the rig has no camera 'middle'; it has front, front_right"),
        ([f"topics={few}"], rig, "camera 'front_right' has no topic; add a line 'front_right: /topic'"),
        ([f"topics={wrong}"], rig, "cameras.front=/points: the topic is of type sensor_msgs/msg/PointCloud2"),
        (["exclude_cameras=[nose]"], rig, "exclude_cameras=nose: no such camera"),
        (["history=stream", f"topics={wrong}"], rig, "cameras.front=/points"),
        (["write_bag=out.bag"], rig, "write_bag=out.bag: the name of the bag ends with .mcap"),
        ([f"write_bag={drive}"], rig, "this file holds something other than predictions"),
    )
    for more, calibration, words in cases:
        with pytest.raises((UserError, DataError)) as caught:
            predict(drive, *more, rig=calibration)
        assert words in str(caught.value)
        assert "\n" not in str(caught.value)
    with pytest.raises(UserError, match=r"images=.*gone\.mcap: there is no such file"):
        predict(tmp_path / "gone.mcap", rig=rig)
    with pytest.raises(UserError, match=r"topics=.* belongs to images=<bag>"):
        predict(tmp_path, f"topics={topics}", rig=rig)
    assert not (tmp_path / "out").exists()


def test_the_ego_frame_is_that_of_the_vehicle_unless_stated(drive):
    rig, asked = Rig.load(str(drive.parent.parent / "rig.yaml")), BagImages(drive, None, None, (), Depth())
    with BAGS.read(asked._replace(rig=rig)) as sequence:
        assert sequence.mount == Mount("base_link")
    with BAGS.read(asked._replace(rig=rig, topics=drive.parent.parent / "topics.yaml")) as sequence:
        assert (sequence.mount.frame, sequence.mount.base) == ("ego", "base_link")
        np.testing.assert_array_equal(sequence.mount.base_from_ego[:3, 3], [1.5, 0, 2])


@pytest.mark.whole_runs
@pytest.mark.slow
def test_the_command_writes_a_bag_with_the_times_and_frame_of_the_bag(scene, drive, checkpoint, tmp_path):
    given = f"checkpoint={checkpoint}", f"images={drive}", f"rig={drive.parent.parent / 'rig.yaml'}", *QUICK
    result = run_script("predict.py", "occupancy", *given, "write_bag=out.mcap", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert re.search(r"4/4 frames, \d+\.\d frames/s", result.stderr)
    with Bag(tmp_path / "out.mcap") as bag:
        topic = bag.topic("voxels", "/omniocc/voxels", ["sensor_msgs/msg/PointCloud2"])
        assert topic.frame == "base_link"
        assert [address.stamp_ns for address in topic.addresses] == [stamp_ns(scene, frame) for frame in range(FRAMES)]
        assert [address.received_ns for address in topic.addresses] == [one.stamp_ns for one in topic.addresses]


def test_a_damaged_image_keeps_what_was_made(scene, drive, predict, tmp_path):
    rig, bag = drive.parent.parent / "rig.yaml", tmp_path / "log"
    with BagWriter(bag, 2) as writer:
        for frame in range(FRAMES):
            now = START_NS + frame * 10**8
            for name in RIG.names[1:]:
                write_image(writer, name, now, scene.images(frame)[1])
            content = np.zeros(20, np.uint8) if frame == 2 else np.frombuffer(png_of(scene.images(frame)[0]), np.uint8)
            fields = {"header": writer.header(now, "front"), "format": "png", "data": content}
            writer.write("/front/image", "sensor_msgs/msg/CompressedImage", now, **fields)
    with pytest.raises(DataError, match=r"/front/image at \d+ ns \(png\)") as caught:
        predict(bag, f"write_bag={tmp_path / 'out.mcap'}", rig=rig)
    assert "\n" not in str(caught.value)
    assert len(labels_in(tmp_path / "out")) == 2
    assert BAGS.replaceable(tmp_path / "out.mcap")


def png_of(image: np.ndarray) -> bytes:
    return cv2.imencode(".png", image[..., ::-1])[1].tobytes()
