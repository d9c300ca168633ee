"""Counts of rays by scene, and the file in which they are kept."""

import dataclasses
from types import SimpleNamespace

import pytest
import torch
from batches import make_batch

from omniocc.camera import Rig
from omniocc.classes import UNKNOWN
from omniocc.data.store.reader import SceneReader
from omniocc.geometry import Cuboid
from omniocc.predict.rig_file import write_rig_file
from omniocc.runs.scenes import LIDAR, MOVING, RAYS, save_scenes, scene_figures
from omniocc.scores import Scores
from omniocc.train.scene_counts import SceneCounts, save_by_scene

COARSE = slice(2, None)
"""The thresholds of 1, 2 and 4 m among those that are counted: .25, .5, 1, 2, 4 m."""
SAMPLES = [[(0, 0), (1, 0)], [(1, 1), (2, 0)]]


@pytest.fixture(scope="module")
def task(make_task):
    return make_task("model/sketch=dense")


def drawn_batch(task, samples):
    """Return a batch whose LiDAR hits classes 1 to 11 at 3 to 20 m, a quarter of them moving."""
    generator = torch.Generator().manual_seed(samples[0][1] + 7 * samples[0][0])
    batch = make_batch(task, samples)
    size = batch.lidar_range_m.shape
    labels = torch.randint(1, 12, size, generator=generator, dtype=torch.uint8)
    range_m = torch.empty(size).uniform_(3, 20, generator=generator)
    return batch._replace(
        lidar_labels=labels, lidar_range_m=range_m, lidar_moving=torch.rand(size, generator=generator) < 0.25
    )


def predicted(batch):
    return batch.voxels.roll(1, dims=1)


def test_the_scenes_together_have_the_counts_of_the_scores(task, spec):
    scores = Scores(task.model.geometry, spec)
    by_scene = SceneCounts(scores)
    for samples in SAMPLES:
        batch = drawn_batch(task, samples)
        scores.update(predicted(batch), batch)
        by_scene.update(predicted(batch), batch)
    found = by_scene.of_all()
    assert list(found) == ["0", "1", "2"]
    assert_sums(found, scores)


def assert_sums(found, scores):
    """Compare the counts of all scenes together with those of the scores."""
    for kind, metric in ((RAYS, scores.rays), (LIDAR, scores.lidar)):
        lines = torch.stack([torch.tensor(scene[kind]) for scene in found.values()]).sum(0)
        assert torch.equal(lines[0], metric.truth.sum(0))
        assert torch.equal(lines[1], metric.predicted.sum(0))
        assert torch.equal(lines[2:], metric.correct.sum(0)[COARSE])
        assert lines[0].sum() > 1000


def test_masks_and_rays_of_the_frames_count_as_in_the_scores(task, spec):
    """In the corners of a cuboid hits are beyond the reach; rays start up to 3 m from the ego origin."""
    grid = Cuboid((16, 16, 4))
    scores = Scores(grid, dataclasses.replace(spec, lidar_directions=None))
    by_scene, generator = SceneCounts(scores), torch.Generator().manual_seed(0)
    for samples in SAMPLES:
        batch = drawn_batch(task, samples)
        cells, rays = (len(samples), *grid.shape), (*batch.lidar_range_m.shape, 3)
        voxels = torch.randint(1, 12, cells, generator=generator) * (torch.rand(cells, generator=generator) < 0.2)
        ways = torch.randn(rays, generator=generator) * torch.tensor([1.0, 1.0, 0.1])
        batch = batch._replace(
            voxels=voxels.to(torch.uint8),
            scored=torch.rand(cells, generator=generator) < 0.9,
            lidar_range_m=torch.empty(rays[:2]).uniform_(3, 36, generator=generator),
            lidar_directions=torch.nn.functional.normalize(ways, dim=-1),
            lidar_origins=torch.empty(rays).uniform_(-3, 3, generator=generator),
        )
        scores.update(predicted(batch), batch)
        by_scene.update(predicted(batch), batch)
    assert_sums(by_scene.of_all(), scores)


def test_rays_from_other_origins_than_the_egos_are_not_counted(task, spec):
    by_scene, batch = SceneCounts(Scores(task.model.geometry, spec)), drawn_batch(task, SAMPLES[0])
    origins, times = torch.zeros(2, 1, 3), torch.zeros(2, 1, dtype=torch.int64)
    by_scene.update(predicted(batch), batch._replace(ray_origins=origins, ray_times=times))
    assert [set(scene) for scene in by_scene.of_all().values()] == [{LIDAR, MOVING}] * 2


def test_a_scene_has_the_counts_of_its_frames_alone(task, spec):
    """Scene 1 has a frame in both batches."""
    by_scene, alone = (SceneCounts(Scores(task.model.geometry, spec)) for _ in range(2))
    for samples in SAMPLES:
        batch = drawn_batch(task, samples)
        by_scene.update(predicted(batch), batch)
        kept = [k for k, (scene, _) in enumerate(samples) if scene == 1]
        parts = {
            name: getattr(batch, name)[kept] for name in ("voxels", "lidar_range_m", "lidar_labels", "lidar_moving")
        }
        alone.update(predicted(batch)[kept], batch._replace(frame_ids=tuple(batch.frame_ids[k] for k in kept), **parts))
    assert by_scene.of_all()["1"] == alone.of_all()["1"]
    alone.reset()
    assert alone.of_all() == {}


def test_moving_rays_are_scored_as_if_all_others_were_unknown(task, spec):
    scores = Scores(task.model.geometry, spec)
    by_scene, batch = SceneCounts(scores), drawn_batch(task, SAMPLES[0])
    by_scene.update(predicted(batch), batch)
    masked = batch.lidar_labels.masked_fill(~batch.lidar_moving, UNKNOWN)
    scores.update(predicted(batch), batch._replace(lidar_labels=masked))
    lines = torch.stack([torch.tensor(scene[MOVING]) for scene in by_scene.of_all().values()]).sum(0)
    assert torch.equal(lines[2:], scores.lidar.correct.sum(0)[COARSE])
    assert 0.2 < lines[0].sum() / batch.lidar_labels.numel() < 0.3


def test_scores_of_groups_are_those_of_their_frames(task, spec, tmp_path):
    """Scenes 0 and 2 in rain, 1 in fog: each group has the score of `Scores` over its frames."""
    by_scene = SceneCounts(Scores(task.model.geometry, spec))
    rain, fog = (Scores(task.model.geometry, spec) for _ in range(2))
    for samples in [[(0, 0)], [(1, 0)], [(1, 1)], [(2, 0)]]:
        batch = drawn_batch(task, samples)
        by_scene.update(predicted(batch), batch)
        (fog if samples[0][0] == 1 else rain).update(predicted(batch), batch)
    conditions = {"0": {"weather": "rain"}, "1": {"weather": "fog", "place": "campus"}, "2": {"weather": "rain"}}
    save_scenes(tmp_path, by_scene.of_all(), conditions, spec.classes.names, (1.0, 2.0, 4.0))
    found = scene_figures(tmp_path)
    for weather, scores in (("rain", rain), ("fog", fog)):
        expected = scores.compute()
        assert found[f"test/weather/{weather}/rayiou"] == pytest.approx(float(expected["rayiou"]))
        assert found[f"test/weather/{weather}/lidar/rayiou"] == pytest.approx(float(expected["lidar/rayiou"]))
    assert found["test/place/campus/rayiou"] == found["test/weather/fog/rayiou"]
    assert len((tmp_path / "scenes.json").read_text().splitlines()) == 7


@pytest.mark.parametrize(("counts", "kinds"), [((1, 4), ["one camera", "wide cameras around"]), ((4, 4), [])])
def test_the_kind_of_rig_is_a_condition_where_rigs_differ(counts, kinds, task, spec, tmp_path):
    class Scene(SceneReader):
        name, rigs, conditions = "", (), {"weather": "clear"}  # properties of scenes

        def __init__(self, name, cameras):
            write_rig_file("equidistant", cameras, tmp_path / name, False)
            self.name, self.rigs = name, [Rig.load(tmp_path / name)]

    batch = drawn_batch(task, SAMPLES[0])
    scores = Scores(task.model.geometry, spec)
    by_scene = SceneCounts(scores)
    by_scene.update(predicted(batch), batch)
    scenes = [Scene(name, count) for name, count in zip(by_scene.of_all(), counts, strict=True)]
    source = SimpleNamespace(scenes=lambda split: scenes, spec=spec)
    save_by_scene(tmp_path, scores, source, by_scene.of_all())
    found = [key.split("/")[2] for key in scene_figures(tmp_path) if key.startswith("test/rig/") and "lidar" not in key]
    assert sorted(found) == kinds
