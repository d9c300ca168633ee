"""The occupancy task on random batches: what trains, what is scored, what is saved."""

from itertools import product
from pathlib import Path

import pytest
import torch
from batches import BESIDE, make_batch
from lightning.pytorch import Callback, LightningDataModule, Trainer
from lightning.pytorch.callbacks import ModelCheckpoint

from omniocc.errors import UserError
from omniocc.predict import load
from omniocc.scores import Scores
from omniocc.train.stage_task import step_generator

CONF = Path(__file__).parents[2] / "conf"
pytestmark = [
    pytest.mark.filterwarnings("ignore::UserWarning:lightning.*"),
    pytest.mark.filterwarnings("ignore:`isinstance:FutureWarning"),
]


SAMPLES = [[(0, 0), (0, 1)], [(0, 2), (0, 3)], [(1, 0), (1, 1)], [(1, 2)]]


def test_streamed_evaluation_scores_what_whole_windows_score(make_task, spec):
    task = make_task("model/temporal=mean", "model/sketch=dense").eval()
    expected, lifted = Scores(task.model.geometry, spec), []
    lift = task.model.lift
    for samples in SAMPLES:
        batch = make_batch(task, samples)
        labels = task.predict(batch).logits.argmax(1).to(torch.uint8)
        expected.update(labels, batch)
        task.model.lift = lambda images, *rest: lifted.append(len(images)) or lift(images, *rest)
        assert torch.equal(task.validation_step(batch, 0), labels)
        task.model.lift = lift
    assert lifted == [2, 2, 2, 1]
    assert {k: float(v) for k, v in task.scores.compute().items()} == pytest.approx(
        {k: float(v) for k, v in expected.compute().items()}, nan_ok=True
    )


def test_every_evaluation_begins_without_memories(make_task):
    task = make_task("model/temporal=mean", "model/sketch=dense").eval()
    for begin, step in (
        (task.on_validation_epoch_start, task.validation_step),
        (task.on_test_epoch_start, task.test_step),
    ):
        step(make_batch(task, SAMPLES[1]), 0)
        assert len(task.stream) == 2
        begin()
        assert len(task.stream) == 0


def options(slot):
    return sorted(path.stem for path in (CONF / "model" / slot).glob("*.yaml"))


PAIRS = [
    [f"model/temporal={temporal}", f"model/refiner={refiner}", f"model/semantic_head={head}"]
    for temporal, refiner, head in product(options("temporal"), options("refiner"), options("semantic_head"))
]
HISTORY = ["model/temporal=mean", "model.temporal.history_gradient=true"]
ONE_BY_ONE = ("backbone", "geometry", "lifter", "sketch", "hints")
SINGLES = [[f"model/{slot}={name}"] for slot in ONE_BY_ONE for name in options(slot)]


@pytest.mark.whole_runs
@pytest.mark.parametrize(
    "overrides", [*PAIRS, *SINGLES, ["model/temporal=mean", "model.temporal.history_gradient=true"]]
)
def test_every_combination_trains_all_its_parameters(overrides, make_task):
    beside = [BESIDE[option] for option in overrides if option in BESIDE]
    task = make_task("model/sketch=dense", *overrides, *beside)
    counts = torch.randint(1, 100, (12, *task.model.geometry.shape))
    task.set_training_statistics(counts)
    batch = make_batch(task, [(0, 1), (1, 2)])
    batch = task.augment(batch, step_generator(task, task.config["seed"], 0))
    terms = task.loss(task.predict(batch), batch.voxels, batch.pixel_labels)
    torch.stack(list(terms.values())).sum().backward()
    trained = {name: p.grad for name, p in task.model.named_parameters() if p.requires_grad}
    assert [name for name, grad in trained.items() if grad is None] == []
    assert [name for name, grad in trained.items() if not grad.isfinite().all()] == []
    frozen = [p.grad for p in task.model.sketch.parameters()] if hasattr(task.model.sketch, "parameters") else []
    assert all(grad is None for grad in frozen)


def test_a_part_with_factor_0_keeps_weights_and_statistics(make_task, tmp_path):
    task = make_task("model/sketch=dense", "model/temporal=mean", "lr_multipliers={backbone: 0, refiner: 0.5}")
    before = {name: value.clone() for name, value in task.model.state_dict().items()}
    train(tmp_path, task, 2)
    changed = {name.split(".")[0] for name, value in task.model.state_dict().items() if not value.equal(before[name])}
    assert "backbone" not in changed
    assert {"refiner", "lifter", "classifier"} <= changed
    assert task.model.lifter.training
    assert not any(part.training for part in task.model.backbone.modules())


@pytest.mark.parametrize(
    ("factors", "message"),
    [
        ("{backbon: 0}", "lr_multipliers.backbon: the model has no such part; it has backbone, "),
        ("{backbone: -1}", "lr_multipliers.backbone=-1: give 0"),
        (
            "{backbone: 0, lifter: 0, temporal: 0, refiner: 0, semantic_head: 0, classifier: 0}",
            "nothing of the model is left to train",
        ),
    ],
)
def test_factors_that_cannot_be_are_refused(factors, message, make_task):
    with pytest.raises(UserError, match=message):
        make_task("model/sketch=dense", f"lr_multipliers={factors}")


class Batches(LightningDataModule):
    def __init__(self, task):
        super().__init__()
        self.train = [make_batch(task, SAMPLES[0]), make_batch(task, SAMPLES[1])]
        self.val = [make_batch(task, SAMPLES[2])]

    def train_dataloader(self):
        return torch.utils.data.DataLoader(self.train, batch_size=None)

    def val_dataloader(self):
        return torch.utils.data.DataLoader(self.val, batch_size=None)

    def transfer_batch_to_device(self, batch, device, dataloader_idx):
        return batch


class Remember(Callback):
    """Weights after every step, and while validating."""

    def __init__(self):
        self.steps, self.validated = [], []

    def on_train_batch_end(self, trainer, module, *_):
        self.steps.append(module.model.classifier.linear.weight.detach().clone())

    def on_validation_batch_end(self, trainer, module, *_):
        self.validated.append(module.model.classifier.linear.weight.detach().clone())


def train(folder, task, max_steps, checkpoint=None):
    remember = Remember()
    trainer = Trainer(
        accelerator="cpu",
        logger=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        num_sanity_val_steps=0,
        max_steps=max_steps,
        gradient_clip_val=35.0,
        callbacks=[
            remember,
            ModelCheckpoint(folder, "last", every_n_train_steps=1, enable_version_counter=False),
            ModelCheckpoint(folder, "best", monitor="val/rayiou", mode="max", enable_version_counter=False),
        ],
    )
    trainer.fit(task, datamodule=Batches(task), ckpt_path=checkpoint)
    return remember


EMA = ("model/sketch=dense", "model/temporal=mean", "ema_decay=0.9", "stages.occupancy.max_steps=4")


@pytest.fixture(scope="session")
def averaging_task(make_task):
    def make():
        task = make_task(*EMA)
        task.set_training_statistics(torch.randint(1, 100, (12, *task.model.geometry.shape)))
        assert len(task.prior.unique()) == 12
        return task

    return make


@pytest.fixture(scope="module")
def averaged(tmp_path_factory, averaging_task):
    folder = tmp_path_factory.mktemp("whole")
    task = averaging_task()
    return folder, train(folder, task, 4), task.prior.clone()


def test_the_average_is_validated_and_saved(averaged, averaging_task):
    folder, remembered, prior = averaged
    average, averages = remembered.steps[0], []
    for step, weights in enumerate(remembered.steps):
        average = weights if step == 0 else 0.9 * average + 0.1 * weights
        averages.append(average)
    assert len(averages) == 4
    torch.testing.assert_close(remembered.validated, [averages[1], averages[3]])
    last, best = (torch.load(folder / f"{name}.ckpt", weights_only=True) for name in ("last", "best"))
    torch.testing.assert_close(last["state_dict"]["model.classifier.linear.weight"], averages[3])
    torch.testing.assert_close(last["current_model_state"]["model.classifier.linear.weight"], remembered.steps[3])
    torch.testing.assert_close(best["state_dict"]["model.classifier.linear.weight"], averages[best["global_step"] - 1])
    assert torch.equal(last["state_dict"]["prior"], prior)
    assert torch.equal(prior, averaging_task().prior)
    torch.testing.assert_close(load(folder / "last.ckpt").task.model.classifier.linear.weight, averages[3])


def test_a_resumed_run_goes_on_with_weights_and_average(averaged, averaging_task, tmp_path):
    folder, whole, _ = averaged
    first = train(tmp_path, averaging_task(), 2)
    torch.testing.assert_close(first.steps, whole.steps[:2], rtol=0, atol=1e-7)
    rest = train(tmp_path, averaging_task(), 4, tmp_path / "last.ckpt")
    torch.testing.assert_close(rest.steps, whole.steps[2:], rtol=0, atol=1e-7)
    saved = [torch.load(place / "last.ckpt", weights_only=True)["state_dict"] for place in (folder, tmp_path)]
    torch.testing.assert_close(*[state["model.classifier.linear.weight"] for state in saved], rtol=0, atol=1e-7)


def test_only_training_is_augmented(make_task):
    task = make_task("model/sketch=dense", "model/refiner=none", "model/semantic_head=none")
    asked = []
    task.augment = lambda batch, generator: asked.append(batch) or batch
    batch = make_batch(task, SAMPLES[0])
    task.log = task.log_dict = lambda *_, **__: None
    task.training_step(batch, 0)
    assert len(asked) == 1
    task.eval()
    task.validation_step(batch, 0)
    task.test_step(batch, 0)
    task.predict(batch)
    assert len(asked) == 1


def test_draws_are_a_function_of_seed_and_batch(make_task):
    task = make_task("model/sketch=dense")
    places = ((0, 0), (0, 0), (0, 1), (1, 0))
    draws = [torch.rand(4, generator=step_generator(task, seed, batch)).tolist() for seed, batch in places]
    assert draws[0] == draws[1]
    assert len({tuple(draw) for draw in draws}) == 3
