"""The command line of evaluate.py."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from omniocc import evaluate as module
from omniocc.commands.evaluate import main, parser_of
from omniocc.errors import UserError
from omniocc.evaluate import Evaluation, results_folder, score_checkpoint
from omniocc.predict import load
from omniocc.runs.weights import SHIPPED


def test_words_are_checkpoints_settings_and_what_is_asked_for(tmp_path):
    other = tmp_path / "epoch=1-step=2.ckpt"
    other.touch()
    words = Evaluation.from_words(
        ["tiny", "data.batch_size=1", str(other), "robustness=[view, noise_5_percent]", "packages=[a,b]"]
    )
    assert words.checkpoints == [SHIPPED / "tiny.safetensors", other]
    assert words.overrides == ["data.batch_size=1", "packages=[a,b]"]
    assert words.robustness == ["view", "noise_5_percent"]
    assert words.predictions is None
    assert Evaluation.from_words(["robustness=all", "tiny"]).robustness == ["all"]
    assert Evaluation.from_words(["predictions=2024", "data=carlasc"]).predictions == Path("2024")


def test_help_lists_the_kinds_of_disturbances():
    text = parser_of().format_help()
    for kind in ("camera_dropped", "extrinsics_deg", "camera_late", "night", "places_never_trained_on"):
        assert kind in text


def test_results_are_beside_the_checkpoint_or_in_the_folder_that_is_named():
    best = Path("runs/ours-1/best.ckpt")
    assert results_folder(best, "evaluation-best", None, True) == Path("runs/ours-1/evaluation-best")
    assert results_folder(SHIPPED / "tiny.safetensors", "evaluation-tiny", None, False) == Path("runs/evaluation-tiny")
    assert results_folder(best, "evaluation-best", Path("out"), False) == Path("out")
    assert results_folder(best, "evaluation-best", Path("out"), True) == Path("out/ours-1/evaluation-best")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["data.batch_size=1"], "name a checkpoint"),
        (["tiny-depth", "robustness=all"], "of the depth stage; this needs one of the occupancy stage"),
        (["tiny-depth", "nowhere.ckpt"], r"of the depth stage.*\n.*nowhere\.ckpt"),
        (["tiny-depth", "nowhere.ckpt", "robustness=all"], r"of the depth stage.*\n.*nowhere\.ckpt"),
    ],
)
def test_mistakes_are_one_line(words, message):
    with pytest.raises(SystemExit, match=message):
        main(words)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["predictions=folder", "tiny"], "scores files alone"),
        (["predictions=folder", "robustness=all"], "scores files alone"),
        (["tiny", "robustness=all", "--audit"], "leave --audit and --origins out"),
        (["tiny", "robustness=all", "--origins", "ego"], "leave --audit and --origins out"),
    ],
)
def test_what_does_not_go_together_is_refused(words, message, capsys):
    with pytest.raises(SystemExit):
        main(words)
    assert message in capsys.readouterr().err


def test_a_checkpoint_is_scored_at_the_precision_of_its_training(monkeypatch, tmp_path):
    asked = {}

    class StopError(Exception): ...

    def trainer(**options):
        asked.update(options)
        raise StopError

    monkeypatch.setattr(module, "Trainer", trainer)
    trained = load("tiny", ["data.source.splits={train:1,val:0}", "data.source.themes=[downtown]"])
    assert trained.config.data.source.splits == {"train": 1, "val": 0}
    assert trained.config.data.source.themes == ["downtown"]
    trained.config.trainer.precision = "bf16-mixed"
    data = SimpleNamespace(num_classes=12, spec=SimpleNamespace(classes=None), source=SimpleNamespace(folder="here"))
    data.restrict_to = data.set_ray_origins = lambda _: None
    scored = SimpleNamespace(task=None, data=data, precision=trained.precision, path=trained.path)
    with pytest.raises(StopError):
        score_checkpoint(scored, tmp_path / "results", Evaluation([], [], None, None))
    assert asked["precision"] == "bf16-mixed"
    trained.config.trainer.precision = "8"
    with pytest.raises(UserError, match=r"is damaged: trainer\.precision is not one of '32-true'"):
        _ = trained.precision
