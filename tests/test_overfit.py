"""One frame, learned by heart: everything between pixels and metric has to be in order for that."""

import pytest
import torch

from omniocc.config import build
from omniocc.task.build import build_task
from omniocc.task.scores import Scores


@pytest.mark.slow
@pytest.mark.parametrize(("model", "steps"), [("default", 200), ("flashocc", 200), ("fosocc", 300), ("oneocc", 500)])
def test_one_frame_is_learned_by_heart(model, steps, data_root, smoke):
    torch.manual_seed(0)
    cfg = smoke(f"model={model}", f"paths.data={data_root}", "preset.channels=16", "data.batch_size=1")
    data = build(cfg.data)
    data.prepare_data()
    data.setup()
    batch = next(iter(data.val_dataloader()))
    task = build_task(cfg, data.source.spec)
    task.set_training_statistics(data.voxel_counts())
    optimizer = torch.optim.AdamW(task.parameters(), lr=1e-2, weight_decay=0.0)
    for _ in range(steps):  # the default is at 1 after 150
        terms = task.loss(task.predict(batch), batch.voxels, batch.pixel_labels, batch.camera_range_m)
        optimizer.zero_grad()
        torch.stack(list(terms.values())).sum().backward()
        optimizer.step()
    scores = Scores(task.model.geometry, data.source.spec)
    scores.update(task.predict(batch).logits.argmax(1).to(torch.uint8), batch)
    assert scores.compute()["rayiou"] > 0.9
