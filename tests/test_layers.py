"""Who imports whom at run time; `make lint` checks what the code says."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
LEFT_OUT = "[name for name in sys.modules if name.startswith(('omniworld', 'omniocc.extras'))]"


def run(code: str) -> str:
    path = {"PYTHONPATH": str(ROOT / "src")}
    done = subprocess.run([sys.executable, "-c", code], env=path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_recorded_scenes_and_the_model_of_the_paper_need_no_world_and_no_extras(tmp_path):
    code = (
        "import sys\n"
        "from omniocc.config import check\n"
        "from omniocc.runs.script import train_config\n"
        "from omniocc.parts import Parts\n"
        f"words = ['preset=smoke', 'data=recorded', 'data.source.root={tmp_path}', 'logger.mode=disabled']\n"
        "cfg = train_config(words)\n"
        "check(cfg)\n"
        "parts = Parts(cfg)\n"
        "model = parts.model()\n"
        "parts.data(), parts.depth(), parts.task_parts(), parts.recipe('occupancy'), parts.trainer()\n"
        "import omniocc.evaluate, omniocc.predict, omniocc.report.write, omniocc.train\n"
        f"print(type(model).__name__, {LEFT_OUT})"
    )
    assert run(code) == "OccupancyModel []"


def test_the_data_of_the_platform_need_no_world():
    assert run(f"import sys, omniocc.data; print({LEFT_OUT})") == "[]"


def test_predictions_are_made_and_shown_without_lightning_and_metrics():
    code = (
        "import sys, omniocc\n"
        "import omniocc.predict.depth, omniocc.predict.occupancy, omniocc.extras.viewer.collect\n"
        "trained = omniocc.load('any-rig')\n"
        "trained.occupancy, trained.facts\n"
        "print([name for name in ('lightning', 'torchmetrics', 'transformers') if name in sys.modules])"
    )
    assert run(code) == "[]"
