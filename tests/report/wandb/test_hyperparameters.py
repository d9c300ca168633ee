"""The W&B sweep file, run as W&B's agent would run it, up to the composed configuration."""

from pathlib import Path

import pytest
import yaml
from wandb.sdk.launch.sweeps.utils import create_sweep_command, create_sweep_command_args

from omniocc.config import check_root

ROOT = Path(__file__).parents[3]
SWEEP = yaml.safe_load((ROOT / "sweeps" / "wandb" / "hyperparameters.yaml").read_text())


def ends(parameter):
    """The values at both ends of what may be drawn."""
    values = parameter.get("values") or [parameter["min"], parameter["max"]]
    return values[0], values[-1]


def agent_command(values):
    """Program and arguments, put together in the order of the agent."""
    parts = create_sweep_command_args({"args": {name: {"value": value} for name, value in values.items()}})
    parts |= {"env": ["/usr/bin/env"], "interpreter": ["python"], "program": [SWEEP["program"]]}
    command = []
    for word in create_sweep_command(list(SWEEP["command"])):
        command += parts[word[2:-1]] if word.startswith("${") else [word]
    return command


@pytest.mark.parametrize("end", [0, -1])
def test_what_an_agent_starts_is_a_configuration(end, composed):
    values = {name: ends(parameter)[end] for name, parameter in SWEEP["parameters"].items()}
    env, python, program, *overrides = agent_command(values)
    assert (env, python, program) == ("/usr/bin/env", "python", "src/train.py")
    assert (ROOT / program).exists()
    cfg = composed(*overrides)
    check_root(cfg)
    assert cfg.logger.mode == "online"
    assert cfg.optimizer.learning_rate == pytest.approx(values["optimizer.learning_rate"])
    assert cfg.loss.weights.scal == values["loss.weights.scal"]
    assert cfg.seed == values["seed"]


def test_the_method_and_what_it_looks_at_are_known_to_wandb():
    assert SWEEP["method"] in ("grid", "random", "bayes")
    assert SWEEP["metric"] == {"name": "val/rayiou", "goal": "maximize"}
    for parameter in SWEEP["parameters"].values():
        assert "values" in parameter or 0 < parameter["min"] < parameter["max"]
        assert parameter.get("distribution", "log_uniform_values") == "log_uniform_values"
