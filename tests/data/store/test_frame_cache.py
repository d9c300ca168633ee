"""Per-frame results of stages: exact bits, exact lengths, damage found."""

import pytest
import torch

from omniocc.data import CandidateCache, DataError, RangeCache


class Scene:
    """Two frames of a street."""

    name = "street"

    def __len__(self) -> int:
        return 2


STREET = Scene()


@pytest.fixture
def candidates(tmp_path):
    return CandidateCache(tmp_path / "candidates", (3, 5, 7))  # 105 cells: the last byte is not full


def test_candidates_come_back_bit_by_bit(candidates):
    torch.manual_seed(0)
    frames = [torch.rand(3, 5, 7) < share for share in (0.0, 0.3, 1.1)]
    candidates.write(STREET, frames)
    for number, frame in enumerate(frames):
        assert torch.equal(candidates.read(STREET, number), frame)
    assert candidates.path(STREET).stat().st_size == 3 * (14 + 4)


def test_ranges_keep_a_256th_of_a_metre_and_nan(tmp_path):
    cache = RangeCache(tmp_path, (2, 3))
    range_m = torch.tensor([[1.0, 25.6, float("inf")], [float("nan"), 3.14159, 200.0]])
    cache.write(STREET, [range_m])
    torch.testing.assert_close(cache.read(STREET, 0), range_m, atol=1 / 512, rtol=0, equal_nan=True)


def test_one_flipped_bit_is_found_and_the_frame_named(candidates):
    candidates.write(STREET, [torch.ones(3, 5, 7, dtype=torch.bool)] * 2)
    blob = bytearray(candidates.path(STREET).read_bytes())
    blob[20] ^= 4
    candidates.path(STREET).write_bytes(blob)
    assert candidates.read(STREET, 0).all()
    with pytest.raises(DataError, match=r"street\.frames.*frame 1.*damaged"):
        candidates.read(STREET, 1)


def test_a_missing_file_and_a_frame_beyond_the_end_are_errors(candidates):
    with pytest.raises(DataError, match="cannot be read"):
        candidates.read(STREET, 0)
    candidates.write(STREET, [torch.ones(3, 5, 7, dtype=torch.bool)])
    with pytest.raises(DataError, match=r"frame 1.*damaged"):
        candidates.read(STREET, 1)


def test_a_scene_with_fewer_frames_than_recorded_is_missing(candidates):
    scene = STREET
    assert candidates.missing([scene]) == [scene]
    candidates.write(STREET, [torch.ones(3, 5, 7, dtype=torch.bool)])
    assert candidates.missing([scene]) == [scene]
    candidates.write(STREET, [torch.ones(3, 5, 7, dtype=torch.bool)] * 2)
    assert candidates.missing([scene]) == []


def test_a_folder_for_scenes_of_any_data_tells_them_apart_by_what_they_hold(tmp_path):
    def cache(data):
        return CandidateCache(tmp_path, (3, 5, 7), data)

    frames, other, same = [torch.ones(3, 5, 7, dtype=torch.bool)] * 2, Scene(), Scene()
    first, other.fingerprint, same.fingerprint = Scene(), "2" * 64, "1" * 64
    first.fingerprint = "1" * 64
    cache("all").write(first, frames)
    assert cache("more").missing([first, other, same]) == [other], "another data set, and one more scene"
    cache("all").write(STREET, frames)
    assert cache("all").missing([STREET]) == []
    assert cache("more").missing([STREET]) == [STREET], "a scene without fingerprint is of its data set alone"
