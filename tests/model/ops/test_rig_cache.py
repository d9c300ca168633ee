from dataclasses import replace

import pytest
import torch

from omniocc.model.ops.rig_cache import OVERHEAD_BYTES, RIG_CACHE, RigCache, once_per_rig, tensor_bytes

RIG_BYTES = OVERHEAD_BYTES + 6 * 16 * 8
RESULT_BYTES = 4 * 10_000


@pytest.fixture
def fisheye(fisheye):
    """Return the rig without the masks of its own car, whose memory would count."""
    return replace(fisheye, masks=None)


@pytest.fixture
def rigs(fisheye):
    """Eight rigs that differ."""
    poses = [fisheye.ego_from_camera.clone() for _ in range(8)]
    for k, pose in enumerate(poses):
        pose[:, 2, 3] += 0.01 * k
    return [replace(fisheye, ego_from_camera=pose) for pose in poses]


def visit(cache, rig, key="result"):
    """Get a result; return whether it had to be computed."""
    computed = []
    cache.get(rig, key, lambda: computed.append(True) or torch.zeros(10_000))
    return bool(computed)


def test_least_recently_used_rigs_are_dropped_at_the_limit(rigs):
    cache = RigCache(limit_bytes=3 * (RIG_BYTES + RESULT_BYTES))
    assert all(visit(cache, rig) for rig in rigs[:3])
    assert not visit(cache, rigs[0])
    assert visit(cache, rigs[3])
    assert len(cache) == 3
    assert cache.size_bytes() == 3 * (RIG_BYTES + RESULT_BYTES)
    assert [visit(cache, rigs[k]) for k in (0, 2, 3)] == [False, False, False]
    assert visit(cache, rigs[1])


def test_small_results_of_hundreds_of_rigs_fit(fisheye):
    cache = RigCache(limit_bytes=100 * RIG_BYTES)
    for _ in range(2):
        for k in range(50):
            pose = fisheye.ego_from_camera.clone()
            pose[0, 2, 3] += 0.001 * k
            cache.get(replace(fisheye, ego_from_camera=pose), "number", lambda: 1.0)
    assert len(cache) == 50


def test_results_of_the_newest_rig_stay_at_any_size(rigs):
    cache = RigCache(limit_bytes=1)
    assert visit(cache, rigs[0], "one")
    assert visit(cache, rigs[0], "two")
    assert not visit(cache, rigs[0], "one")
    assert visit(cache, rigs[1])
    assert visit(cache, rigs[0], "one")


def test_results_that_grow_afterwards_count(rigs):
    cache, limit = RigCache(limit_bytes=3 * (RIG_BYTES + RESULT_BYTES)), []
    cache.get(rigs[0], "grows", lambda: limit)
    limit.append(torch.zeros(3 * 10_000))
    visit(cache, rigs[1])
    assert len(cache) == 1


def test_a_function_is_called_once_for_a_rig_and_arguments(rigs):
    calls = []

    @once_per_rig
    def result(rig, factor, offset=0):
        calls.append((rig, factor, offset))
        return factor + offset

    assert [result(rigs[0], 2), result(rigs[0], 2), result(rigs[0], 3), result(rigs[1], 2)] == [2, 2, 3, 2]
    assert result(rigs[0], 2, offset=1) == 3
    assert len(calls) == 4
    RIG_CACHE.clear()
    result(rigs[0], 2)
    assert len(calls) == 5


def test_shared_and_sparse_memory_counts_once():
    tensor = torch.zeros(100)
    assert tensor_bytes({"all": tensor, "part": [tensor[:10]]}) == 400
    places = torch.arange(5), torch.arange(4)
    assert tensor_bytes(torch.sparse_csr_tensor(*places, torch.ones(4), check_invariants=True)) == 8 * 5 + 8 * 4 + 4 * 4
