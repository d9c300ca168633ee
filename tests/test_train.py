"""The scripts as users start them: whole runs, kills, mistakes."""

import json
from pathlib import Path

import pytest
import torch
from filelock import FileLock
from offline_file import files_of, history, runs_in, summary
from scripts import run_script

from omniocc.report.wandb.dashboard import sections

ROOT = Path(__file__).parents[1]
TWELVE_STEPS = ("stages.occupancy.max_steps=12", "checkpoint_every_n_steps=1")  # time enough to be killed in
pytestmark = [pytest.mark.slow, pytest.mark.whole_runs]


def smoke(data_root: Path, *more: str) -> list[str]:
    """Without the stages before occupancy, unless a sketch is chosen."""
    sketch = [] if any(override.startswith("model/sketch=") for override in more) else ["model/sketch=dense"]
    return ["preset=smoke", f"paths.data={data_root}", "logger.mode=disabled", "data.num_workers=0", *sketch, *more]


def metrics_of(folder: Path, name: str) -> dict:
    (path,) = folder.glob(f"runs/{name}-*/metrics.json")
    return json.loads(path.read_text())["metrics"]


@pytest.fixture(scope="session")
def whole(shared_folder, data_root) -> tuple[Path, list[str]]:
    """Folder and arguments of one run to its end, made once for all test processes; its output is in `output.txt`."""
    folder = shared_folder / "whole"
    arguments = smoke(data_root, *TWELVE_STEPS, "name=whole", "logger.mode=offline", "test_images=1")
    with FileLock(f"{folder}.lock"):
        if not (folder / "output.txt").exists():
            folder.mkdir(exist_ok=True)
            result = run_script("train.py", *arguments, cwd=folder)
            assert result.returncode == 0, result.stdout + result.stderr
            (folder / "output.txt").write_text(result.stdout)
    return folder, arguments


def test_a_run_leaves_figures_images_and_curves(whole):
    place, arguments = whole
    metrics = metrics_of(place, "whole")
    for key in (
        "test/rayiou",
        "test/rayiou@1",
        "test/rayiou/Road",
        "test/rayiou_0-8.5m",
        "prior/rayiou",
        "label/lidar/rayiou",
        "test/voxel/miou",
    ):
        assert key in metrics
    assert metrics["label/rayiou"] == 1.0
    (folder,) = place.glob("runs/whole-*")
    facts = json.loads((folder / "metrics.json").read_text())
    assert min(facts[key] for key in ("million parameters", "GFLOP a frame", "peak MiB")) > 0
    assert (facts["stages"], facts["classes"][0]["name"], len(facts["classes"])) == ({"occupancy": 12}, "Road", 11)
    assert facts["fraction of candidates"] == 1
    assert set(facts["protocol"]) == {"rayiou", "lidar/rayiou", "voxel"}
    assert "rays (39 elevations x 360 azimuths, as SparseOcc) from the ego origin; " in facts["protocol"]["rayiou"]
    assert facts["protocol"]["voxel"] in (folder / "table.md").read_text()
    assert list(folder.glob("images/test-00-*.png"))
    assert list(folder.glob("wandb/offline-run-*/*.wandb"))
    assert (folder / "config.yaml").exists()
    assert "RayIoU" in (place / "output.txt").read_text()

    again = run_script("train.py", *arguments, cwd=place)
    assert again.returncode == 0
    assert "is finished" in again.stdout

    evaluated = run_script(
        "evaluate.py",
        str(folder / "best.ckpt" if (folder / "best.ckpt").exists() else folder / "last.ckpt"),
        "--images",
        "0",
        cwd=place,
    )
    assert evaluated.returncode == 0, evaluated.stdout + evaluated.stderr
    (path,) = folder.glob("evaluation-*/metrics.json")
    tested = {key: value for key, value in metrics.items() if not key.startswith("val/")}
    assert json.loads(path.read_text())["metrics"] == tested
    assert 0 <= metrics["val/rayiou"] < 1


def test_killed_training_continues_to_the_same_figures(tmp_path, data_root, whole):
    arguments = smoke(data_root, *TWELVE_STEPS, "test_images=0")
    run_script(
        "train.py",
        *arguments,
        "name=killed",
        cwd=tmp_path,
        kill_when=lambda: any(tmp_path.glob("runs/killed-*/last.ckpt")),
    )
    assert list(tmp_path.glob("runs/killed-*/last.ckpt"))
    assert not list(tmp_path.glob("runs/killed-*/metrics.json")), "the run ended before it could be killed"

    resumed = run_script("train.py", *arguments, "name=killed", cwd=tmp_path)
    assert resumed.returncode == 0, resumed.stdout + resumed.stderr
    assert "goes on from" in resumed.stdout
    assert metrics_of(tmp_path, "killed") == pytest.approx(metrics_of(whole[0], "whole"), abs=1e-6, nan_ok=True)


def test_a_damaged_checkpoint_costs_the_steps_since_the_one_before(tmp_path, data_root):
    arguments = smoke(
        data_root, "stages.occupancy.max_steps=2", "checkpoint_every_n_steps=1", "test_images=0", "name=damaged"
    )
    whole = run_script("train.py", *arguments, cwd=tmp_path)
    assert whole.returncode == 0, whole.stdout + whole.stderr
    (folder,) = tmp_path.glob("runs/damaged-*")
    figures = metrics_of(tmp_path, "damaged")
    (folder / "metrics.json").unlink()
    last = folder / "last.ckpt"
    last.write_bytes(last.read_bytes()[:-1000])
    resumed = run_script("train.py", *arguments, cwd=tmp_path)
    assert resumed.returncode == 0, resumed.stdout + resumed.stderr
    assert resumed.stdout.count("goes on from the one before, last.previous.ckpt") == 1
    assert metrics_of(tmp_path, "damaged") == pytest.approx(figures, abs=1e-6, nan_ok=True)

    (folder / "metrics.json").unlink()
    for path in (last, folder / "last.previous.ckpt"):
        path.write_bytes(b"damaged")
    refused = run_script("train.py", *arguments, cwd=tmp_path)
    assert refused.returncode == 1
    (line,) = refused.stderr.strip().splitlines()
    assert "neither" in line
    assert "To train again from the first step, move" in line


def test_a_loss_that_is_not_finite_is_one_line(tmp_path, data_root):
    (tmp_path / "faulty.py").write_text(
        "from omniocc.loss import CrossEntropy\n\n\nclass Faulty(CrossEntropy):\n    calls = 0\n\n"
        "    def forward(self, *given):\n        self.calls += 1\n"
        "        return super().forward(*given) * (1 if self.calls < 2 else float('nan'))\n"
    )
    words = smoke(data_root, "model/sketch=dense", "test_images=0", "packages=[faulty]")
    words += ["loss.voxel.ce._target_=faulty.Faulty"]
    result = run_script("train.py", *words, cwd=tmp_path, PYTHONPATH=str(tmp_path))
    assert result.returncode == 1
    *before, line = result.stderr.strip().splitlines()  # lines before: of rendering, where this test is the first
    assert not [words for words in before if "Traceback" in words or "Warning" in words or "finite" in words]
    assert line.startswith("the loss is not finite at step 1 (ce=nan")
    assert "frames: train-" in line


@pytest.mark.slow(60)
def test_stages_run_once_and_are_shared(tmp_path, data_root):
    arguments = smoke(data_root, "model/sketch=omni", "stages.occupancy.max_steps=3", "trainer.log_every_n_steps=1")
    logged = ["logger.mode=offline", "test_images=1"]
    depth = run_script("train.py", *arguments, "stage=depth", *logged, cwd=tmp_path)
    assert depth.returncode == 0, depth.stdout + depth.stderr
    assert "depth, stage 1 of 1 begins" in depth.stdout
    assert "AbsRel" in depth.stdout
    assert not list(tmp_path.glob("runs/stages/sketch-*"))
    assert not list(tmp_path.glob("runs/stages/depth-*/ranges/*.frames"))  # nothing follows that reads them
    (trained,) = tmp_path.glob("runs/stages/depth-*/last.ckpt")
    fitted = torch.load(trained, weights_only=False)["state_dict"]["model.confidence.weights"]
    assert fitted.tolist() != [1, 0, 0]  # to the validation scenes

    whole = run_script("train.py", *arguments, "name=whole", *logged, cwd=tmp_path)
    assert whole.returncode == 0, whole.stdout + whole.stderr
    runs_of_wandb_are_complete(tmp_path / "runs")
    assert "depth, stage 1 of 3 is finished" in whole.stdout
    assert "sketch, stage 2 of 3 begins" in whole.stdout
    metrics = metrics_of(tmp_path, "whole")
    (path,) = tmp_path.glob("runs/whole-*/metrics.json")
    assert json.loads(path.read_text())["stages"] == {"depth": 4, "sketch": 4, "occupancy": 3}
    for key in (
        "test/rayiou",
        "test/depth/mae_0-8.5m",
        "test/depth/ece",
        "test/sketch/recall",
        "test/sketch/raw/recall_17-25.6m",
    ):
        assert key in metrics

    chosen = ["model.sketch.threshold=null", "model.sketch.fraction=0.1", "model.sketch.dilation_m=[0,0,0]"]
    fewer = run_script("train.py", *arguments, "stage=sketch", *chosen, cwd=tmp_path)
    assert fewer.returncode == 0, fewer.stdout + fewer.stderr
    assert len(list(tmp_path.glob("runs/stages/sketch-*"))) == 1  # other candidates of the same network
    fractions = {
        json.loads(path.read_text())["metrics"]["test/sketch/fraction"]: path.parent
        for path in tmp_path.glob("runs/stages/sketch-*/candidates-*/metrics.json")
    }
    assert len(fractions) == 2
    assert min(abs(fraction - 0.1) for fraction in fractions) < 1e-3

    checkpoint = str(next(tmp_path.glob("runs/whole-*/last.ckpt")))
    evaluated = run_script("evaluate.py", checkpoint, "--images=0", "--origins", "trajectory", cwd=tmp_path)
    assert evaluated.returncode == 0, evaluated.stdout + evaluated.stderr
    (path,) = tmp_path.glob("runs/whole-*/evaluation-last-trajectory/metrics.json")
    content = json.loads(path.read_text())
    assert "where the car was in past, present and future frames" in content["protocol"]["rayiou"]
    assert {"test/rayiou_past", "prior/rayiou_now", "label/rayiou_future"} <= set(content["metrics"])
    assert content["metrics"]["label/rayiou_now"] == 1
    online = content["metrics"]["test/voxel/miou"]  # the sketch at work, not its cache
    assert online == pytest.approx(metrics["test/voxel/miou"], abs=2e-3)
    checkpoint = str(next(tmp_path.glob("runs/whole-*/last.ckpt")))
    disturbed = [checkpoint, "robustness=[view_90_deg,night]", "--scenes=1", "data.source.workers=0"]
    broken = run_script("evaluate.py", *disturbed, "logger.mode=disabled", cwd=tmp_path)
    assert broken.returncode == 0, broken.stdout + broken.stderr
    assert "loses" in broken.stdout
    (folder,) = tmp_path.glob("runs/whole-*/robustness-last")
    parts = json.loads((folder / "robustness.json").read_text())["parts"]
    assert [part["part"] for part in parts] == ["undisturbed", "view_90_deg", "night"]
    assert parts[0]["scores"]["rayiou"] > 0
    audited = run_script("evaluate.py", checkpoint, "--audit", cwd=tmp_path)
    assert audited.returncode == 0, audited.stdout + audited.stderr
    assert "voxel IoU (precision, recall) of the model" in audited.stdout
    assert "error of range, 0-8.5m" in audited.stdout

    cached = next(fractions[metrics["test/sketch/fraction"]].glob("train-*.frames"))
    blob = bytearray(cached.read_bytes())
    blob[3] ^= 1
    cached.write_bytes(blob)
    damaged = run_script("train.py", *arguments, "name=damaged", "model/refiner=none", cwd=tmp_path)
    assert damaged.returncode == 1
    assert "sketch, stage 2 of 3 is finished" in damaged.stdout
    assert f"{cached.name}: frame 0 is damaged; delete the file" in damaged.stderr
    assert "Traceback" not in damaged.stderr


def test_a_killed_stage_continues_to_the_same_figures(tmp_path, data_root):
    arguments = smoke(
        data_root,
        "model/sketch=omni",
        "model/depth=truth",
        "stage=sketch",
        "stages.sketch.max_steps=12",
        "test_images=0",
    )
    whole = run_script("train.py", *arguments, "checkpoint_every_n_steps=1", "paths.runs=whole", cwd=tmp_path)
    assert whole.returncode == 0, whole.stdout + whole.stderr
    run_script(
        "train.py",
        *arguments,
        "checkpoint_every_n_steps=1",
        "paths.runs=killed",
        cwd=tmp_path,
        kill_when=lambda: any(tmp_path.glob("killed/stages/sketch-*/last.previous.ckpt")),
    )
    next(tmp_path.glob("killed/stages/sketch-*/last.previous.ckpt")).with_name("last.ckpt").write_bytes(b"damaged")
    assert not list(tmp_path.glob("killed/stages/sketch-*/*/metrics.json")), "it ended before it could be killed"
    resumed = run_script("train.py", *arguments, "checkpoint_every_n_steps=1", "paths.runs=killed", cwd=tmp_path)
    assert resumed.returncode == 0, resumed.stdout + resumed.stderr
    assert "sketch, stage 2 of 2 goes on" in resumed.stdout
    assert resumed.stdout.count("goes on from the one before, last.previous.ckpt") == 1
    figures = [
        json.loads(next(tmp_path.glob(f"{runs}/stages/sketch-*/candidates-*/metrics.json")).read_text())["metrics"]
        for runs in ("whole", "killed")
    ]
    assert figures[0] == pytest.approx(figures[1], abs=1e-6, nan_ok=True)


def runs_of_wandb_are_complete(runs: Path) -> None:
    """One for each stage, two of them in one process; together they have all that the dashboard shows."""
    seen = set()
    for folder, job_type, tags in (
        ("stages/depth-*", "depth", []),
        ("stages/sketch-*", "sketch", []),
        ("whole-*", "occupancy", ["whole"]),
    ):
        (path,) = files_of(next(runs.glob(folder)))
        (begun,) = runs_in(path)
        assert (begun.job_type, begun.run_group, list(begun.tags)) == (job_type, "smoke", tags)
        config = {item.key: json.loads(item.value_json) for item in begun.config.update}
        assert config["slots"]["sketch"] == "omni"
        charts = {key for row in history(path) for key in row}
        assert not {key for key in charts if key.startswith(("prior/", "label/", "test/rayiou"))}
        assert not (job_type == "occupancy" and "val/depth/mae" in charts)
        seen |= charts | set(summary(path))
    (metrics,) = runs.glob("whole-*/metrics.json")
    charts = sections(json.loads(metrics.read_text())["metrics"])
    keys = {key for part in charts.values() for chart in part for key in chart.keys}
    assert {"test/rayiou_0-8.5m", "test/rayiou/Pedestrian", "test/depth/mae_17-25.6m", "test/rayiou@4"} <= keys
    assert keys - seen == set()
    assert {"train/loss/ce", "train/loss/dice"} <= seen


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("model/sketch=mnoo", ["mnoo", "dense", "random"]),
        ("stage=dpeth", ["dpeth", "depth, sketch, occupancy"]),
        ("model.lifter.points=many", ["model.lifter.points", "'many' is not a whole number"]),
        ("+model.lifter.pionts=3", ["did you mean 'points'"]),
        ("resume=nowhere.ckpt", ["nowhere.ckpt"]),
    ],
)
def test_mistakes_end_in_lines_not_tracebacks(override, expected, tmp_path, data_root):
    result = run_script("train.py", *smoke(data_root, override), cwd=tmp_path)
    text = result.stdout + result.stderr
    assert result.returncode != 0
    assert "Traceback" not in text
    for words in expected:
        assert words in text


def test_mistakes_in_the_last_stage_are_reported_before_the_first_trains(tmp_path, data_root):
    for override, message in (
        ("model.lifter.heads=5", "model.lifter: 8 channels cannot be split among 5 heads; give a divisor"),
        ("resume=nowhere.ckpt", "resume=nowhere.ckpt: there is no such checkpoint"),
    ):
        result = run_script("train.py", *smoke(data_root, "model/sketch=omni", override), cwd=tmp_path)
        assert result.returncode != 0
        assert message in result.stderr
    assert not list(tmp_path.glob("runs/stages/*"))


@pytest.mark.parametrize(
    "overrides",
    [
        ("model/sketch=random", "model/refiner=none", "model/semantic_head=none"),
        ("model=bevdet", "loss=with_ranges"),
    ],
)
def test_swapped_modules_train(overrides, tmp_path, data_root):
    result = run_script(
        "train.py", *smoke(data_root, *overrides, "stages.occupancy.max_steps=2", "test_images=0"), cwd=tmp_path
    )
    assert result.returncode == 0, result.stdout + result.stderr


def test_a_file_that_is_no_checkpoint_is_one_line(tmp_path):
    bad = tmp_path / "bad.ckpt"
    bad.write_bytes(b"not a checkpoint")
    result = run_script("evaluate.py", str(bad), cwd=tmp_path)
    assert result.returncode != 0
    assert "Traceback" not in result.stderr
    assert "bad.ckpt" in result.stderr
