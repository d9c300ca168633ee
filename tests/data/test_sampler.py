import itertools

import pytest
import torch

from omniocc.data.sampler import EpochSampler, RankSampler, shuffled


def epoch(sampler, number):
    sampler.set_epoch(number)
    return list(sampler)


def test_the_order_depends_on_seed_and_epoch_only():
    first = EpochSampler(20, seed=3)
    assert epoch(first, 1) == epoch(EpochSampler(20, seed=3), 1)
    assert sorted(epoch(first, 1)) == list(range(20))
    orders = [epoch(first, 0), epoch(first, 1), epoch(EpochSampler(20, seed=4), 0), epoch(EpochSampler(20, seed=2), 1)]
    assert len({tuple(order) for order in orders}) == 4


@pytest.mark.parametrize("world_size", [2, 3])
def test_ranks_share_an_epoch_without_overlap(world_size):
    whole = epoch(EpochSampler(20, seed=0), 5)
    parts = [epoch(EpochSampler(20, 0, rank, world_size), 5) for rank in range(world_size)]
    assert {len(part) for part in parts} == {20 // world_size}
    together = [sample for part in parts for sample in part]
    assert len(set(together)) == len(together) == 20 // world_size * world_size
    # together the ranks walk through the very order of one process
    assert [sample for samples in zip(*parts, strict=True) for sample in samples] == whole[: len(together)]


def test_only_the_interrupted_epoch_is_shortened():
    whole = EpochSampler(20, seed=0)
    resumed = EpochSampler(20, seed=0, resume_epoch=2, resume_samples=6)
    assert list(resumed) == epoch(whole, 2)[6:]  # also before anybody calls set_epoch
    assert epoch(resumed, 2) == epoch(whole, 2)[6:]
    assert epoch(resumed, 3) == epoch(whole, 3)
    assert len(resumed) == 20


def test_testing_scores_every_sample_exactly_once():
    parts = [RankSampler(7, rank, 3) for rank in range(3)]
    assert [list(part) for part in parts] == [[0, 1], [2, 3], [4, 5, 6]]  # the past of a frame is on the same device
    assert [len(part) for part in parts] == [2, 2, 3]


def test_frames_of_a_scene_follow_one_another():
    scenes = [6, 5, 1, 6]
    order = shuffled(scenes, 2, torch.Generator().manual_seed(0))
    assert sorted(order) == list(range(18))
    scene_of = [k for k, size in enumerate(scenes) for _ in range(size)]
    visited = [scene_of[sample] for sample in order]
    runs = [1 for one, other in itertools.pairwise(visited) if one == other]
    assert len(runs) >= 3 + 2 + 3  # pairs of whole groups
    assert visited != sorted(visited)
    assert order != shuffled(scenes, 2, torch.Generator().manual_seed(1))
    assert epoch(EpochSampler(18, 0, scenes=scenes, together=2), 3) != epoch(EpochSampler(18, 0), 3)


def test_one_at_a_time_scenes_do_not_matter():
    assert epoch(EpochSampler(18, 0, scenes=[9, 9]), 3) == epoch(EpochSampler(18, 0), 3)
