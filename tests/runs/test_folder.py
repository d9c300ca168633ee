import json
from pathlib import Path

import pytest

from omniocc.config import plain
from omniocc.errors import UserError
from omniocc.runs.checkpoint_io import LAST, write_checkpoint
from omniocc.runs.distributed import is_first
from omniocc.runs.folder import COMMANDS, command_line, command_of, open_run, run_hash
from omniocc.runs.results import METRICS
from omniocc.train.stage_keys import stage_keys


def test_the_hash_depends_only_on_what_decides_the_result():
    config = {
        "seed": 0,
        "model": {"sketch": {"_target_": "omniocc.model.sketch.Dense"}},
        "data": {},
        "depth": {"spheres": 8},
        "stages": {"depth": {"max_steps": 1}, "occupancy": {"max_steps": 2}},
        "paths": {"runs": "a"},
        "resume": "auto",
    }
    assert run_hash(config, "data") == run_hash({**config, "paths": {"runs": "b"}, "resume": "never"}, "data")
    assert run_hash(config, "data") != run_hash({**config, "seed": 1}, "data")
    assert run_hash(config, "data") != run_hash(config, "other data")
    assert run_hash(config, "data") == run_hash({**config, "occupied_above": None}, "data"), "as before this key"
    assert run_hash(config, "data") != run_hash({**config, "occupied_above": 0.2}, "data")
    assert run_hash(config, "data") == run_hash({**config, "depth": {"spheres": 9}}, "data"), "nothing looks at depth"
    stages = {**config["stages"], "depth": {"max_steps": 9}}
    assert run_hash(config, "data") == run_hash({**config, "stages": stages}, "data")
    stages = {**config["stages"], "occupancy": {"max_steps": 9}}
    assert run_hash(config, "data") != run_hash({**config, "stages": stages}, "data")
    learned = {**config, "model": {"sketch": {"_target_": "omniocc.model.sketch.Omni"}}}
    assert run_hash(learned, "data") != run_hash({**learned, "depth": {"spheres": 9}}, "data")


def test_the_file_of_weights_that_a_run_starts_from_is_part_of_its_hash(tmp_path):
    config = {"seed": 0, "model": {"sketch": {"_target_": "omniocc.model.sketch.Dense"}}, "data": {}}

    def hashed(weights):
        return run_hash({**config, "stages": {"occupancy": {"weights": weights}}}, "data")

    files = [tmp_path / name for name in ("a.ckpt", "b.ckpt", "c.ckpt")]
    for path, content in zip(files, ("one", "one", "two"), strict=True):
        path.write_text(content)
    none, *given = [hashed(path and str(path)) for path in (None, *files)]
    assert given[0] == given[1] != given[2]
    assert none not in given
    with pytest.raises(FileNotFoundError, match=r"weights=gone\.ckpt: .*no such checkpoint"):
        hashed("gone.ckpt")


@pytest.mark.parametrize(
    "words",
    [
        "paths.data=elsewhere",
        "data.num_workers=3",
        "data.source.workers=1",
        "data.source.cache=beside",
        "trainer.accelerator=cpu",
        "trainer.log_every_n_steps=1",
        "logger.mode=disabled",
        "test_images=0",
    ],
)
def test_where_data_lie_and_what_a_machine_reads_and_tells_decides_nothing(words, smoke):
    """A finished run is found again when its data have moved, and depth and sketch are not trained again."""
    first, other = plain(smoke()), smoke(words)
    assert run_hash(first, "data") == run_hash(plain(other), "data")
    assert stage_keys(smoke(), "data") == stage_keys(other, "data")


def test_the_times_of_validation_decide_the_best_checkpoint_and_no_earlier_stage(smoke):
    first, other = smoke(), smoke("+trainer.val_check_interval=2")
    assert run_hash(plain(first), "data") != run_hash(plain(other), "data")
    assert stage_keys(first, "data") == stage_keys(other, "data")


def test_a_run_that_goes_on_from_another_has_a_folder_of_its_own(smoke, tmp_path):
    path, hashes = tmp_path / "last.ckpt", [run_hash(plain(smoke()), "data")]
    for content in ("one", "other"):
        path.write_text(content)
        hashes.append(run_hash(plain(smoke(f"resume={path}")), "data"))
    assert len(set(hashes)) == 3


@pytest.mark.parametrize(
    "words",
    ["seed=1", "trainer.precision=bf16-mixed", "data.batch_size=1", "data.range_edges_m=[0,9]", "data.ray_azimuths=36"],
)
def test_what_changes_a_result_decides(words, smoke):
    assert run_hash(plain(smoke()), "data") != run_hash(plain(smoke(words)), "data")


def test_code_of_own_classes_is_part_of_the_hash(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("OMNIOCC_PACKAGES", "ownpart")
    hashes = []
    for number in (1, 1, 2):
        (tmp_path / "ownpart.py").write_text(f"class Bottom:\n    layers = {number}\n")
        config = {"model": {"sketch": {"_target_": "ownpart.Bottom"}}, "data": {}, "stages": {"occupancy": {}}}
        hashes.append(run_hash(config, "data"))
    assert hashes[0] == hashes[1] != hashes[2]


def test_same_command_finds_its_folder_and_checkpoint(tmp_path):
    first = open_run(tmp_path, "train", "abc", "auto")
    assert first.checkpoint is None
    assert not first.finished
    write_checkpoint({"config": {}, "state_dict": {}}, first.path / LAST)
    first.lock.release()
    second = open_run(tmp_path, "train", "abc", "auto")
    assert second.path == first.path
    assert second.checkpoint == first.path / LAST
    (second.path / METRICS).write_text(json.dumps({}))
    assert second.finished


def test_resume_never_makes_a_new_folder(tmp_path):
    names = [open_run(tmp_path, "train", "abc", "never").path.name for _ in range(3)]
    assert names == ["train-abc", "train-abc-2", "train-abc-3"]


def test_two_processes_do_not_share_a_folder(tmp_path):
    held = open_run(tmp_path, "train", "abc", "auto")
    with pytest.raises(UserError, match="another process"):
        open_run(tmp_path, "train", "abc", "auto")
    held.lock.release()
    open_run(tmp_path, "train", "abc", "auto")


def test_a_missing_checkpoint_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"gone\.ckpt"):
        open_run(tmp_path, "train", "abc", str(tmp_path / "gone.ckpt"))


def test_a_run_started_from_a_checkpoint_and_stopped_goes_on_from_its_own(tmp_path):
    given, other = (tmp_path / name for name in ("given.ckpt", "other.ckpt"))
    content = {"config": {}, "state_dict": {}}
    for path in (given, other):
        write_checkpoint(content, path)
    last = tmp_path / "train-abc" / LAST
    last.parent.mkdir()
    write_checkpoint(content, last)

    def start_of(resume: Path) -> Path | None:
        run = open_run(tmp_path, "train", "abc", str(resume))
        run.lock.release()
        return run.checkpoint

    assert start_of(given) == given, "the folder's checkpoint is from before this start"
    assert start_of(given) == given, "stopped before it had saved anything"
    write_checkpoint(content, last)
    assert start_of(given) == last
    assert start_of(given) == last
    assert start_of(other) == other, "it was started from another checkpoint"


def test_of_processes_that_slurm_starts_only_the_first_claims_the_folder(tmp_path, monkeypatch):
    monkeypatch.delenv("LOCAL_RANK", raising=False)
    monkeypatch.delenv("OMNIOCC_RUN_FOLDER", raising=False)
    monkeypatch.setenv("SLURM_PROCID", "1")
    second = open_run(tmp_path, "train", "abc", "auto")
    assert (second.lock, second.path.is_dir()) == (None, True)
    monkeypatch.setenv("SLURM_PROCID", "0")
    first = open_run(tmp_path, "train", "abc", "auto")
    assert first.lock is not None
    assert first.path == second.path


OF_PROCESSES = ("RANK", "WORLD_SIZE", "LOCAL_RANK", "NODE_RANK", "GROUP_RANK", "SLURM_PROCID", "SLURM_NTASKS")


@pytest.mark.parametrize(
    ("given", "first", "several"),
    [
        ({}, True, False),
        ({"LOCAL_RANK": "1", "NODE_RANK": "0"}, False, False),  # a child that Lightning has started
        ({"LOCAL_RANK": "0", "NODE_RANK": "0"}, True, False),
        ({"NODE_RANK": "1"}, False, False),  # the first process of another machine
        ({"RANK": "0", "LOCAL_RANK": "0", "WORLD_SIZE": "4", "GROUP_RANK": "0"}, True, True),
        ({"RANK": "2", "LOCAL_RANK": "0", "WORLD_SIZE": "4", "GROUP_RANK": "1"}, False, True),  # torchrun --nnodes 2
        ({"RANK": "0", "LOCAL_RANK": "0", "WORLD_SIZE": "1"}, True, False),
        ({"SLURM_PROCID": "0", "SLURM_NTASKS": "2"}, True, True),
        ({"SLURM_PROCID": "1", "SLURM_NTASKS": "2"}, False, True),
        ({"SLURM_PROCID": "0", "SLURM_NTASKS": "1"}, True, False),
    ],
)
def test_of_all_processes_on_all_machines_one_is_the_first(given, first, several, tmp_path, monkeypatch):
    for name in OF_PROCESSES:
        monkeypatch.delenv(name, raising=False)
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    assert is_first() == first
    if several:
        with pytest.raises(UserError, match=r"resume=never: .* another name="):
            open_run(tmp_path, "train", "abc", "never")
    else:
        open_run(tmp_path, "train", "abc", "never")


def test_a_command_names_no_machine(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for script in ("src/train.py", str(tmp_path / "src" / "train.py")):
        monkeypatch.setattr("sys.argv", [script, "name=my run", "+ablation=mono"])
        assert command_line() == "python src/train.py 'name=my run' +ablation=mono"
    monkeypatch.setattr("sys.argv", [str(COMMANDS / "train.py"), "seed=1"])  # as an installed package starts it
    assert command_line() == "omniocc train seed=1"


def test_environment_variables_that_decide_are_part_of_the_command(monkeypatch):
    monkeypatch.setattr("sys.argv", ["src/train.py", "model/sketch=own"])
    monkeypatch.setenv("OMNIOCC_PACKAGES", "my_package,other")
    monkeypatch.setenv("OMNIOCC_PRESET", "smoke")
    expected = "OMNIOCC_PACKAGES=my_package,other OMNIOCC_PRESET=smoke python src/train.py model/sketch=own"
    assert command_line() == expected


def test_the_packages_that_a_recorded_command_lacks_are_added():
    own = {
        "model": {
            "sketch": {"_target_": "my_package.Sketch"},
            "refiner": {"_target_": "omniocc.model.refiner.NoRefiner"},
        }
    }
    facts = {"command": "python src/train.py model/sketch=own"}
    assert command_of(facts, own) == f"OMNIOCC_PACKAGES=my_package {facts['command']}"
    assert command_of({"command": command_of(facts, own)}, own) == f"OMNIOCC_PACKAGES=my_package {facts['command']}"
    assert command_of(facts, own | {"packages": ["my_package"]}) == facts["command"]
    assert command_of(facts, {}) == facts["command"]
    assert command_of({}, own) is None
