"""Topics are guessed by the names of topics and cameras; what is open is told, not guessed."""

import re

import pytest

from omniocc.errors import UserError
from omniocc.extras.recorders.bag_topics import (
    Topics,
    fits,
    guess_cameras,
    guess_names,
    stated_topics,
)


@pytest.mark.parametrize(
    ("camera", "topic", "whether"),
    [
        ("front", "/front/image_raw", True),
        ("front", "/sensing/camera/front/image_raw/compressed", True),
        ("front", "/front_left/image_raw", False),
        ("front_left", "/front_left/image_raw", True),
        ("front_left", "/front/left/image_raw", True),
        ("front_left", "/cam_front_left", True),
        ("cam0", "/camera0/image_raw", True),
        ("cam1", "/camera0/image_raw", False),
        ("CAM_FRONT", "/cam_front/image_rect", True),
        ("camera", "/camera/image_raw", True),
    ],
)
def test_a_topic_fits_a_camera_by_its_words(camera, topic, whether):
    assert fits(camera, topic) is whether


def test_of_several_topics_the_raw_one_is_taken():
    topics = ["/front/image_raw", "/front/image_raw/compressed", "/front/image_rect", "/rear/image_raw/compressed"]
    assert guess_cameras(["rear", "front"], topics, "log") == {
        "rear": "/rear/image_raw/compressed",
        "front": "/front/image_raw",
    }
    assert guess_cameras(["any"], ["/video"], "log") == {"any": "/video"}  # one camera, one topic


@pytest.mark.parametrize(
    ("topics", "words"),
    [
        (["/front/image", "/left/image"], "log: no topic of images fits camera 'rear'; topics of images: /front/image"),
        (["/front/image", "/rear/a", "/rear/b"], "log: several topics fit camera 'rear': /rear/a, /rear/b; name it in"),
        ([], "no topic of images fits camera 'front'; topics of images: none"),
    ],
)
def test_topics_that_do_not_match_are_told(topics, words):
    with pytest.raises(UserError, match=re.escape(words)):
        guess_cameras(["front", "rear"], topics, "log")


def test_cameras_without_a_rig_are_named_by_their_namespaces():
    topics = ["/car/front/image_raw", "/car/front/image_rect", "/car/rear/image_raw/compressed", "/aside/image_raw"]
    infos = ["/car/front/camera_info", "/car/rear/camera_info"]
    assert guess_names(topics, infos) == {"front": "/car/front/image_raw", "rear": "/car/rear/image_raw/compressed"}
    same = ["/left/front/image_raw", "/right/front/image_raw"]
    beside = ["/left/front/camera_info", "/right/front/camera_info"]
    assert guess_names(same, beside) == {"left_front": same[0], "right_front": same[1]}


def test_a_file_names_cameras_alone_or_more(tmp_path):
    path = tmp_path / "topics.yaml"
    assert stated_topics(None) == Topics()
    path.write_text("front: /a\nrear: /b\n")
    assert stated_topics(path) == Topics(cameras={"front": "/a", "rear": "/b"})
    path.write_text("poses: null\nlimit_s: 0.1\n")
    assert stated_topics(path) == Topics(poses=None, limit_s=0.1)
    for text, words in (
        ("- front", "holds no mapping"),
        ("limit: 1\nposes: tf\n", "there is no key 'limit' (is it 'limit_s'?)"),
        ("front: 3\n", "cameras is {'front': 3}; it must be a mapping"),
        ("limit_s: 0\n", "limit_s is 0; it must be a time in s"),
        ("limit_s:\n", "limit_s is None; it must be a time in s"),
        ("pose_gap_s: true\n", "pose_gap_s is True; it must be a time in s"),
        ("poses: [1]\n", "poses is [1]; it must be a name"),
    ):
        path.write_text(text)
        with pytest.raises(UserError) as caught:
            stated_topics(path)
        assert words in str(caught.value)
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)
