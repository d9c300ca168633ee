import itertools
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import torch
from fake_scene import FakeWorld
from fake_source import FakeLabels, FakeSource
from lightning.pytorch import LightningModule, Trainer
from lightning.pytorch.callbacks import Callback

from omniocc.data import OccupancyData, SceneReader
from omniocc.data.labels.survival import lost_line
from omniocc.data.module import EpochSampler, RankSampler, shuffled
from omniocc.data.source import BenchmarkFrame
from omniocc.errors import DataError, UserError
from omniocc.geometry import Cylinder, resample
from omniocc.parts import Parts
from omniocc.runs.plan import validation_times
from omniocc.scores import Scores, within_reach
from omniocc.train.data_module import DataModule

GRID = Cylinder(shape=(4, 6, 2), radius_m=(0.0, 25.6), height_m=(-2.8, 3.6))
HIGH = Cylinder(shape=(4, 6, 1), radius_m=(0.0, 25.6), height_m=(-1.0, 5.4))
pytestmark = [
    pytest.mark.filterwarnings("ignore::UserWarning:lightning.*"),
    pytest.mark.filterwarnings("ignore:`isinstance:FutureWarning"),
]


class Recorder(LightningModule):
    """Learns nothing; remembers which samples it saw."""

    def __init__(self):
        super().__init__()
        self.weight = torch.nn.Parameter(torch.zeros(()))
        self.seen = []

    def training_step(self, batch, batch_index):
        self.seen.append(batch.frame_ids)
        return self.weight * batch.images.float().mean()

    def validation_step(self, batch, batch_index):
        pass

    def configure_optimizers(self):
        return torch.optim.SGD(self.parameters(), lr=0.1)


class SaveEverywhere(Callback):
    def __init__(self, folder, moments=("batch", "validation", "epoch")):
        self.folder, self.moments = folder, moments
        self.seen = {}

    def save(self, trainer, module, moment):
        if moment not in self.moments:
            return
        path = self.folder / f"{len(self.seen):02d}-{moment}.ckpt"
        trainer.save_checkpoint(path)
        self.seen[path] = len(module.seen)

    def on_train_batch_end(self, trainer, module, *_):
        self.save(trainer, module, "batch")

    def on_validation_end(self, trainer, module):
        if not trainer.sanity_checking:
            self.save(trainer, module, "validation")

    def on_train_epoch_end(self, trainer, module):
        self.save(trainer, module, "epoch")


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    root = tmp_path_factory.mktemp("data")
    make(root).prepare_data()
    return root


def make(root, num_workers=0, batch_size=2, seed=0, grid=GRID, **options):
    return OccupancyData(FakeWorld(root), 12, grid, 1, batch_size, num_workers, seed, **options)


def run(root, length, checkpoint=None, callbacks=(), num_workers=0):
    module = Recorder()
    trainer = Trainer(
        accelerator="cpu",
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        callbacks=list(callbacks),
        num_sanity_val_steps=0,
        **length,
    )
    trainer.fit(module, datamodule=DataModule(make(root, num_workers)), ckpt_path=checkpoint)
    return module.seen


@pytest.mark.parametrize(
    ("length", "moments"),
    [
        ({"max_epochs": 3}, ("batch", "validation", "epoch")),
        ({"max_epochs": -1, "max_steps": 10, "val_check_interval": 2}, ("batch", "validation")),
    ],
)
def test_a_resumed_run_sees_the_batches_that_were_left(root, tmp_path, length, moments):
    saver = SaveEverywhere(tmp_path, moments)
    whole = run(root, length, callbacks=[saver])
    assert len(set(whole[:4])) == 4
    assert whole[:4] != whole[4:8]
    assert len(whole) == (12 if "max_steps" not in length else 10)
    assert all("OccupancyData" in torch.load(path, weights_only=True) for path in saver.seen)  # so old ones go on
    for path, seen in saver.seen.items():
        assert run(root, length, checkpoint=path) == whole[seen:], path.name


def test_accumulated_batches_of_a_step_are_of_one_epoch(root, tmp_path):
    saver = SaveEverywhere(tmp_path, ("validation",))
    length = {"max_epochs": -1, "max_steps": 5, "accumulate_grad_batches": 3, **validation_times(5, None, None, 3)}
    whole = run(root, length, callbacks=[saver])  # four batches an epoch, one of which is left out
    assert len(whole) == 5 * 3
    assert list(saver.seen.values()) == [3, 6, 9, 12, 15]  # the last validation is at the end of training
    for path, seen in saver.seen.items():
        assert run(root, length, checkpoint=path) == whole[seen:], path.name
    module = DataModule(make(root))
    module.setup("fit")
    module.trainer = Trainer(accelerator="cpu", logger=False, accumulate_grad_batches=5, enable_checkpointing=False)
    with pytest.raises(UserError, match="8 training samples per process are less than the 10 of a step"):
        module.train_dataloader()


def test_a_resumed_run_with_loader_processes(root, tmp_path):
    saver = SaveEverywhere(tmp_path)
    whole = run(root, {"max_epochs": 2}, callbacks=[saver])
    for path, seen in saver.seen.items():
        if path.name[:2] in ("02", "05"):  # within the first epoch, and right after it
            assert run(root, {"max_epochs": 2}, checkpoint=path, num_workers=1) == whole[seen:], path.name


def test_loaders(root):
    data = make(root, batch_size=3)
    data.setup()
    train = list(data.train_dataloader())
    assert [len(batch.frame_ids) for batch in train] == [3, 3]
    test = list(data.in_order("test"))
    assert [batch.frame_ids for batch in test] == [
        ("test-000-suburb/000000", "test-000-suburb/000001", "test-000-suburb/000002"),
        ("test-000-suburb/000003",),
    ]
    assert data.voxel_counts().shape == (12, *GRID.shape)
    assert data.voxel_counts().sum() == 8 * 48


def test_moving_a_batch_leaves_rigs_alone(root):
    data = make(root)
    data.setup()
    batch = next(iter(data.in_order("val")))
    moved = DataModule(data).transfer_batch_to_device(batch, torch.device("meta"), 0)
    assert moved.images.device.type == moved.world_from_ego.device.type == "meta"
    assert moved.rigs is batch.rigs
    assert moved.frame_ids == batch.frame_ids


def test_more_than_a_batch_is_needed(root):
    data = make(root, batch_size=9)
    data.setup()
    with pytest.raises(ValueError, match=r"8 training samples.* the 9 of a step: use more scenes"):
        data.train_dataloader()
    with pytest.raises(ValueError, match="got 0, 1 and 0"):
        make(root, batch_size=0)
    with pytest.raises(ValueError, match="got 2, 0 and 0"):
        OccupancyData(FakeWorld(root), 12, GRID, window=1, batch_size=2, num_workers=0, seed=0, samples_per_scene=0)


def test_scores_have_the_bands_that_were_asked_for(root):
    own, far = make(root), make(root, range_edges_m=[0, 20, 50.0])
    assert own.spec.range_edges_m == (0.0, 8.5, 17.0, 25.6)
    assert far.spec.range_edges_m == (0.0, 20.0, 50.0)
    assert far.spec.reach_m == 50
    scores = Scores(GRID, far.spec)
    assert [metric.counter.range_edges_m for metric in (scores.rays, scores.lidar)] == [(0, 20, 50)] * 2


def test_the_rays_of_voxel_rayiou_are_as_many_as_asked_for(root):
    own, few = make(root), make(root, ray_azimuths=10)
    scores = Scores(few.geometry, few.spec)
    assert own.spec.ray_directions is None
    assert scores.rays.counter.scan.directions.shape == (390, 3)
    assert "390 rays" in scores.rays.protocol()
    with pytest.raises(ValueError, match="ray_azimuths must be at least 1, got 0"):
        make(root, ray_azimuths=0)


def test_lidar_hits_count_up_to_the_last_band(root):
    grid = Cylinder(shape=(100, 4, 2), radius_m=(0.0, 50.0), height_m=(-2.8, 3.6))
    hits = [make(root, grid=grid, range_edges_m=edges).spec for edges in (None, [0, 50])]
    labels, range_m = torch.full((1, 2), 7, dtype=torch.uint8), torch.tensor([[20.0, 40.0]])
    ahead = torch.tensor([[1.0, 0.0, 0.0]]).expand(2, 3)
    counted = [within_reach(labels, range_m, ahead, spec.reach_m, None).tolist() for spec in hits]
    assert counted == [[[7, 0]], [[7, 7]]]


@pytest.mark.parametrize("edges", [[0], [0, 20, 20], [20, 0]])
def test_bands_that_make_no_sense_are_an_error(root, edges):
    with pytest.raises(UserError, match=r"data\.range_edges_m=.*two or more increasing"):
        make(root, range_edges_m=edges).check_classes()


def test_it_is_said_where_the_scores_end_before_the_grid_does(root, monkeypatch):
    far = Cylinder(shape=(4, 6, 2), radius_m=(0.0, 40.0), height_m=(-2.8, 3.6))
    assert list(make(root).remarks()) == []
    (line,) = make(root, grid=far).remarks()
    assert "neither trained nor scored" in line, "the points of the virtual world end at 26 m"
    monkeypatch.setattr("omniworld.source.RENDERED_REACH_M", None)
    (line,) = make(root, grid=far).remarks()
    assert "from 25.6 m on" in line
    assert list(make(root, grid=far, range_edges_m=[0, 40]).remarks()) == []


def test_it_is_said_that_hardly_any_label_is_left_in_the_grid(root):
    data = make(root, grid=Cylinder(shape=(4, 6, 2), radius_m=(60.0, 70.0), height_m=(-2.8, 3.6)))
    lines = [line for line in data.remarks() if "hardly anything to learn" in line]
    assert len(lines) == 1
    assert lines[0].startswith("the model's grid keeps 0 of ")
    assert "points in the first training frame" in lines[0]


def test_it_is_said_that_hardly_any_voxel_of_a_dataset_is_left_in_the_grid(tmp_path):
    """A road 1.6 m thick fills a quarter of cells that are 6.4 m high; two fifths are needed."""
    source = FakeSource(str(tmp_path))
    (scene,) = source.scenes("train")[:1]
    own = source.spec.benchmark.grid

    class Thin(FakeLabels):
        def __init__(self, grid):
            self.grid = grid

        def benchmark(self, scene, frame):
            voxels = torch.zeros(own.shape, dtype=torch.uint8)
            voxels[:, :, 0] = 1
            return BenchmarkFrame(voxels)

        def read(self, scene, frame):
            return resample(self.benchmark(scene, frame).voxels, own, self.grid)

    line = lost_line(scene, Thin(HIGH), HIGH)
    assert line.startswith(f"the model's grid keeps 0 of {own.shape[0] * own.shape[1]:,} occupied cells of the dataset")
    assert lost_line(scene, Thin(own), own) is None


def test_it_is_said_that_a_log_does_not_see_all_free_cells(root, monkeypatch):
    real = SceneReader.meta.func
    log = property(lambda scene: real(scene) | {"facts": real(scene)["facts"] | {"log": {}}})
    monkeypatch.setattr(SceneReader, "meta", log)
    (line,) = make(root).remarks()
    assert "data.ignore=unobserved" in line
    assert list(make(root, ignore="unobserved").remarks()) == []


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


def test_an_epoch_has_whole_steps():
    order = epoch(EpochSampler(20, seed=0), 1)
    assert epoch(EpochSampler(20, seed=0, of_step=6), 1) == order[:18]
    assert [epoch(EpochSampler(20, 0, rank, 2, of_step=4), 1) for rank in range(2)] == [order[:16:2], order[1:16:2]]
    assert len(EpochSampler(20, 0, 1, 2, of_step=4)) == 8


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


@pytest.fixture
def read_only() -> Iterator[Callable[[Path], None]]:
    """A function that makes a folder read-only until the test ends, for root as well."""
    mounted = []

    def mount(folder: Path) -> None:
        for options in (["--bind", folder], ["-o", "remount,ro,bind"]):
            done = subprocess.run(["mount", *options, folder], capture_output=True, text=True, check=False)
            if done.returncode:
                pytest.skip(f"only root may mount a folder: {done.stderr.strip()}")
            mounted[:] = [folder]

    yield mount
    for folder in mounted:
        subprocess.run(["umount", folder], check=True)


def test_complete_data_on_a_read_only_disk_are_used_and_other_voxels_name_the_key_of_their_folder(tmp_path, read_only):
    made = make(tmp_path)
    made.prepare_data()
    made.setup()
    counts = made.voxel_counts()
    read_only(tmp_path)
    data = make(tmp_path)
    data.prepare_data()
    data.setup()
    assert torch.equal(data.voxel_counts(), counts)
    assert len(list(data.train_dataloader())) == 4
    with pytest.raises(
        DataError, match=r"^cannot write .*: the folder is read-only: .* \(data\.source\.cache=\.\.\.\)"
    ):
        make(tmp_path, grid=HIGH).prepare_data()
    with pytest.raises(DataError, match=r"^cannot write .*: the folder is read-only: .* \(paths\.data=\.\.\.\)"):
        make(tmp_path / "more").prepare_data()


def test_only_the_scenes_of_one_split_are_made_and_opened_where_the_others_are_not_needed(smoke, tmp_path):
    data = Parts(smoke(f"paths.data={tmp_path}", "data.source.workers=0")).data()
    data.restrict_to("test")
    data.prepare_data()
    assert {meta.parent.name[:5] for meta in data.source.folder.glob("*/meta.json")} == {"test-"}
    data.setup()
    assert len(list(data.in_order("test"))) == 1
