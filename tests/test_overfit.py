"""One frame, learned by heart: everything between pixels and metric has to be in order for that."""

import pytest
import torch

from omniocc.config import build
from omniocc.parts import Parts
from omniocc.scores import Scores
from omniocc.train import Muon
from omniocc.train.build import build_task

MOST_STEPS = 600
CHECK_EVERY = 25


def ray_iou_of(task, spec, batch) -> float:
    scores = Scores(task.model.geometry, spec)
    with torch.no_grad():
        scores.update(task.predict(batch).logits.argmax(1).to(torch.uint8), batch)
    return float(scores.compute()["rayiou"])


RIVALS = ("flashocc", "fosocc", "oneocc", "adaptiveocc")


@pytest.mark.whole_runs
@pytest.mark.slow
@pytest.mark.parametrize("model", ["default", *RIVALS])
def test_one_frame_is_learned_by_heart(model, data_root, smoke):
    torch.manual_seed(0)
    cfg = smoke(f"model={model}", f"paths.data={data_root}", "preset.channels=16", "data.batch_size=1")
    data = build(cfg.data)
    data.prepare_data()
    data.setup()
    batch = next(iter(data.in_order("val")))
    task = build_task(Parts(cfg), data.source.spec)
    task.set_training_statistics(data.voxel_counts())
    optimizer = Muon(1e-2, 0, 0.0, 1.0).configure(task.model, MOST_STEPS)["optimizer"]
    scores = []
    for step in range(MOST_STEPS):
        terms = task.loss(task.predict(batch), batch.voxels, batch.pixel_labels, batch.camera_range_m)
        optimizer.zero_grad()
        torch.stack(list(terms.values())).sum().backward()
        optimizer.step()
        if step % CHECK_EVERY == CHECK_EVERY - 1:
            scores.append(ray_iou_of(task, data.source.spec, batch))
            if scores[-1] > 0.9:
                return
    raise AssertionError(f"RayIoU after every {CHECK_EVERY} steps: {scores}")
