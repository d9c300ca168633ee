"""Scenes whose checksums are right and whose content is not: one line that names file, scene, frame and member."""

import json
import sys

import cv2
import numpy as np
import pytest
import zstandard
from sealed_scenes import RIG, changed_file, changed_meta, scene_of

from omniocc.camera import Equirectangular
from omniocc.camera.protocol import finite
from omniocc.classes import WORLD_CLASSES
from omniocc.data import SceneReader
from omniocc.data.source.recorded import spec_of
from omniocc.data.store.codec import FACTS, LIDAR, encode_lidar, encode_range, pack
from omniocc.data.store.shard import INDEX
from omniocc.errors import DataError

BOX = {"id": 1, "label": 7, "center_m": [4, 0.5, 0], "size_m": [4, 2, 1.5], "yaw_rad": 0, "velocity_mps": [9, 0]}
NAN = float("nan")
CAMERAS = range(len(RIG.cameras))


def of_cameras(pattern: str, blob: bytes) -> dict[str, bytes]:
    """Return a member of every camera; that of the third is other than the rest."""
    return {pattern.format(k): blob for k in CAMERAS}


def jpeg(width: int, height: int) -> bytes:
    return cv2.imencode(".jpg", np.zeros((height, width, 3), np.uint8))[1].tobytes()


OF_CAMERAS = {
    "rgb{}.jpg": (SceneReader.images, jpeg(64, 36), jpeg(32, 18)),
    "semantic{}.zst": (SceneReader.pixel_labels, *(pack(np.ones(px, np.uint8)) for px in ((36, 64), (18, 32)))),
    "range{}.zst": (SceneReader.camera_range_m, *(pack(np.ones(px, np.uint16)) for px in ((36, 64), (18, 32)))),
}


@pytest.mark.parametrize("pattern", OF_CAMERAS)
def test_members_of_cameras_have_the_size_of_the_image(pattern, tmp_path):
    read, right, wrong = OF_CAMERAS[pattern]
    members = of_cameras(pattern, right)
    scene = scene_of(tmp_path / "scene", members, members | {pattern.format(2): wrong})
    assert [part.shape[:2] for part in read(scene, 0)] == [(36, 64)] * len(CAMERAS)
    said = rf"frames-000\.tar: scene 'scene', frame 1, member '{pattern.format(2)}': it has 32 x 18 px, but its camera "
    with pytest.raises(DataError, match=said + "has 64 x 36 px"):
        read(scene, 1)


@pytest.mark.parametrize(
    ("pattern", "dtype", "said"),
    [("semantic{}.zst", np.uint16, "16 bits instead of 8"), ("range{}.zst", np.uint8, "8 b")],
)
def test_pixels_have_the_bits_of_their_kind(pattern, dtype, said, tmp_path):
    scene = scene_of(tmp_path / "scene", of_cameras(pattern, pack(np.ones((36, 64), dtype))))
    with pytest.raises(DataError, match=rf"frame 0, member '{pattern.format(0)}': .*its pixels have {said}"):
        OF_CAMERAS[pattern][0](scene, 0)


@pytest.mark.parametrize("panorama", [None, Equirectangular(24, 6, 45.0, -45.0)])
def test_panoramas_of_a_scene_have_one_size(panorama, tmp_path):
    usual, small = (encode_range(np.ones(px, np.float32)) for px in ((12, 48), (1, 1)))
    folder = scene_of(tmp_path / "scene", *({"erp_range.zst": blob} for blob in (usual, usual, small))).folder
    scene = SceneReader(folder, panorama=panorama)
    for frame in (1, 0):
        np.testing.assert_array_equal(scene.erp_range_m(frame), np.ones((12, 48) if panorama is None else (6, 24)))
    said = r"frame 2, member 'erp_range\.zst': it has 1 x 1 px, that of frame 1 has 48 x 12 px; all of a scene must be"
    with pytest.raises(DataError, match=said):
        scene.erp_range_m(2)


def test_a_panorama_without_pixels(tmp_path):
    empty = zstandard.ZstdCompressor().compress(bytes(4))
    with pytest.raises(DataError, match=r"frame 0, member 'erp_range\.zst': .*(width is 0|16)"):
        scene_of(tmp_path / "scene", {"erp_range.zst": empty}).erp_range_m(0)


def test_a_lidar_has_as_many_hits_as_rays(tmp_path):
    right, few = (encode_lidar(np.ones(n, np.float32), np.ones(n, np.uint8)) for n in (14040, 14039))
    scene = scene_of(tmp_path / "scene", {"lidar.zst": right}, {"lidar.zst": few})
    found = scene.lidar(0)
    assert found is not None
    assert found.range_m.tolist() == [1.0] * 14040
    with pytest.raises(DataError, match=r"frame 1, member 'lidar\.zst': it has 14,039 hits, its rays are 14,040"):
        scene.lidar(1)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"center_m": [NAN, 0, 0]}, "the center_m of a box is nan; it must be a finite number"),
        ({"velocity_mps": [0, 0, 0]}, r"the velocity_mps of a box is \[0, 0, 0\]; it must be 2 numbers"),
        ({"size_m": "abc"}, "the size_m of a box is 'abc'; it must be 3 numbers"),
        ({"yaw_rad": 10**400}, "the yaw_rad of a box is 10{39} ... 0{40}; it must be a finite number"),
        ({"label": "Road"}, "the label of a box is 'Road'; it must be a whole number"),
        ({"id": True}, "the id of a box is True; it must be a whole number"),
    ],
)
def test_boxes_are_finite_numbers(change, said, tmp_path):
    lidar = encode_lidar(np.full(14040, 4.0, np.float32), np.full(14040, 7, np.uint8))
    frames = ({"lidar.zst": lidar, "frame.json": json.dumps({"boxes": [box]}).encode()} for box in (BOX, BOX | change))
    scene = scene_of(tmp_path / "scene", *frames)
    found = scene.lidar(0)
    assert found is not None
    assert found.moving is not None
    assert found.moving.any()
    with pytest.raises(DataError, match=rf"frame 1, member 'frame\.json': .*{said}"):
        scene.lidar(1)


def test_numbers_that_no_float_holds_are_not_finite():
    assert finite("a", 7) == 7.0
    assert finite("a", sys.float_info.max) == sys.float_info.max
    for value in (10**400, -(10**400), float("inf"), NAN, True, "1"):
        with pytest.raises(ValueError, match=r"a is .*; it must be a finite number"):
            finite("a", value)


@pytest.mark.parametrize(
    ("edges", "said"),
    [
        (["a", "b"], "'panorama_edges_deg' is 'a'; it must be a finite number"),
        ([45.0], r"'panorama_edges_deg' is \[45.0\]; it must be two numbers"),
        ([-45.0, 45.0], "top_deg -45.0 and bottom_deg 45.0: need"),
        ([450.0, -45.0], "top_deg 450.0 and bottom_deg -45.0: need"),
    ],
)
def test_edges_of_panoramas_are_elevations(edges, said, tmp_path):
    folder = scene_of(tmp_path / "scene", {}).folder
    changed_meta(tmp_path / "scene", facts={"panorama_edges_deg": edges})
    with pytest.raises(DataError, match=rf"meta\.json: scene 'scene': .*{said}"):
        len(SceneReader(folder))


SPEC = {
    "classes": WORLD_CLASSES.to_dict(),
    "range_edges_m": [0.0, 8.5, 25.6],
    "frame_interval_s": 0.5,
    "road_z_m": -2.0,
}


def _classes(key: str, **row: object) -> dict[str, object]:
    classes = WORLD_CLASSES.to_dict()
    return {"classes": classes | {key: classes.get(key, {}) | row}}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("virtual", "'spec' holds no table of classes: 'virtual'"),
        ({"classes": [1, 2]}, "'spec' holds no table of classes: "),
        ({"classes": {"0": 1}}, "a class table must map ids to name and rgb, got {'0': 1}"),
        (_classes("1", name=7), "class 1 has the name 7; names must be printable text"),
        (_classes("1", name="a\ud800"), r"class 1 has the name '.*ud800'; names must be printable text"),
        (_classes("1", name="Wall"), "class 1 has the name 'Wall'; names must be unique"),
        (_classes("1", rgb=["a", "b", "c"]), "it must be three whole numbers"),
        ({"range_edges_m": [0.0, NAN, 25.6]}, "range_edges_m is nan; it must be a finite number"),
        ({"range_edges_m": "near"}, "range_edges_m is 'near'; it must be 2 to 100 numbers"),
        ({"frame_interval_s": 0}, "frame_interval_s is 0; it must be above 0"),
        ({"frame_interval_s": "0.5"}, "frame_interval_s is '0.5'; it must be a finite number"),
        ({"road_z_m": NAN}, "road_z_m is nan; it must be a finite number"),
    ],
)
def test_facts_of_the_source_have_the_right_types(change, said, tmp_path):
    folder = scene_of(tmp_path / "scene", {}).folder
    changed_meta(tmp_path / "scene", facts={"spec": SPEC, "recipe": {"rig": 7}})
    assert spec_of(SceneReader(folder)).range_edges_m == (0.0, 8.5, 25.6)
    changed_meta(tmp_path / "scene", facts={"spec": SPEC | change if isinstance(change, dict) else change})
    with pytest.raises(DataError) as error:
        spec_of(SceneReader(folder))
    assert f"{folder}/meta.json: scene 'scene': " in str(error.value)
    error.match(said.replace("(", r"\("))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda index: index["members"].__setitem__(0, 7), "the name of a member is 7"),
        (lambda index: index["members"].__setitem__(0, "../x"), "the name of a member is .*'../x"),
        (lambda index: index["members"].__setitem__(0, "a.bin"), "the member 'a.bin' stands twice in it"),
        (lambda index: index["frames"][1].update(entry={}), r"2 frames, but times of the shape \(1,\)"),
        (lambda index: index["frames"][1]["entry"].update(time_s=NAN), "time or pose of frame 1 holds a value that"),
        (
            lambda index: index["frames"][1]["entry"].update(world_from_ego=[[NAN] * 4] * 4),
            "time or pose of frame 1 holds a value that is not finite",
        ),
        (
            lambda index: [frame["entry"].update(world_from_ego=np.eye(4)[:3].tolist()) for frame in index["frames"]],
            r"poses of the shape \(2, 3, 4\)",
        ),
    ],
)
def test_an_index_of_other_types(change, said, tmp_path):
    scene = scene_of(tmp_path / "scene", {"a.bin": b"1"}, {"a.bin": b"2"})
    assert scene.world_from_ego.shape == (2, 4, 4)
    index = json.loads((tmp_path / "scene" / INDEX).read_text())
    change(index)
    changed_file(tmp_path / "scene", INDEX, json.dumps(index).encode())
    with pytest.raises(DataError, match=rf"index\.json: scene 'scene': it is no index of this scene \(.*{said}"):
        SceneReader(scene.folder).read(0, ["a.bin"])


def test_a_rig_that_is_wrong_is_named_in_its_scene(tmp_path):
    scene = scene_of(tmp_path / "scene", of_cameras("rgb{}.jpg", jpeg(64, 36)))
    text = (scene.folder / "rig.yaml").read_text()
    changed_file(scene.folder, "rig.yaml", text.replace("front:", "../front:", 1).encode())
    with pytest.raises(DataError, match=rf"^{scene.folder}/rig\.yaml: the name of a camera is '\.\./front'"):
        _ = SceneReader(scene.folder).rig


def changed_index(folder, change):
    """Change the index of a scene, with the checksums that fit."""
    index = json.loads((folder / INDEX).read_text())
    change(index["frames"])
    changed_file(folder, INDEX, json.dumps(index).encode())
    return SceneReader(folder)


@pytest.mark.parametrize(
    ("entries", "said"),
    [
        ([{"time_s": 1.0}, {"time_s": 0.5}], "the time runs backwards from frame 0 to 1"),
        (
            [{"world_from_ego": np.diag([1e300, 1, 1, 1])[:, [1, 2, 3, 0]].tolist()}, {}],
            "its position is 1e.300 m away",
        ),
    ],
)
def test_times_and_poses_that_cannot_be_are_named(entries, said, tmp_path):
    scene_of(tmp_path / "scene", {}, {})
    scene = changed_index(
        tmp_path / "scene",
        lambda frames: [row["entry"].update(entry) for row, entry in zip(frames, entries, strict=True)],
    )
    with pytest.raises(DataError, match=rf"scene/index\.json: scene 'scene': .*{said}"):
        _ = scene.time_s


def test_a_scene_without_times_is_named(tmp_path):
    scene_of(tmp_path / "scene", {})
    scene = changed_index(tmp_path / "scene", lambda frames: frames[0].update(entry={}))
    with pytest.raises(DataError, match=r"scene/index\.json: .*it has no times and poses"):
        _ = scene.world_from_ego


def test_a_scene_without_frames_is_named(tmp_path):
    scene_of(tmp_path / "scene", {})
    changed_meta(tmp_path / "scene", frames=0)
    with pytest.raises(DataError, match=r"scene/meta\.json: .*'frames' is 0; a scene has at least one"):
        len(SceneReader(tmp_path / "scene"))


def test_images_of_other_cameras_than_those_of_the_rig_are_named(tmp_path):
    scene = scene_of(tmp_path / "scene", {"rgb0.jpg": b"", "rgb7.jpg": b""})
    with pytest.raises(DataError, match=r"scene/rig\.yaml: .*it has 4 cameras, the frames have rgb0\.jpg, rgb7\.jpg"):
        _ = scene.rig


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"label": 10**400}, r"the label of a box is 1000.*must be 0 to 255"),
        ({"size_m": [4.0, -2.0, 1.5]}, r"the size_m of a box is \(4\.0, -2\.0, 1\.5\); no length is below 0"),
    ],
)
def test_boxes_that_cannot_be_are_named(change, said, tmp_path):

    rays = len(SceneReader.lidar.__globals__["_lidar_directions"]())
    lidar = encode_lidar(np.ones(rays, np.float32), np.ones(rays, np.uint8))
    facts = json.dumps({"boxes": [BOX | change]}).encode()
    scene = scene_of(tmp_path / "scene", {FACTS: facts, LIDAR: lidar})
    with pytest.raises(DataError, match=rf"frame 0, member 'frame\.json': it cannot be decoded .*{said}"):
        scene.lidar(0)
