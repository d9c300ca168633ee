"""Which rays the errors of range count."""

import pytest
import torch
from batches import RIG, make_batch

from omniocc.parts import Parts
from omniocc.train.depth import DepthTask

ERROR_M = 0.5


def test_uncertain_rays_count_too(smoke, spec, make_task, monkeypatch):
    parts = Parts(smoke())
    model = parts.depth()
    task = DepthTask(model, parts.recipe("depth").optimizer, model.rig_spheres(RIG), spec.range_edges_m, 0, {})
    batch = make_batch(make_task("model=flashocc"), [(0, 0), (1, 0)])._replace(
        erp_range_m=10 + 10 * torch.rand(2, 12, 48)
    )
    answer = model(batch.images[:, -1], batch.newest_rigs)
    valid = torch.zeros_like(answer.valid)
    valid[..., ::2] = True
    range_m = batch.erp_range_m + torch.where(valid, ERROR_M, 3 * ERROR_M)
    monkeypatch.setattr(model, "forward", lambda *_: answer._replace(range_m=range_m, valid=valid))
    logged = {}
    monkeypatch.setattr(task, "log_dict", lambda scores, **_: logged.update(scores))
    task.validation_step(batch, 0)
    task.log_scores("val")
    assert float(logged["val/depth/coverage"]) == 0.5
    assert float(logged["val/depth/mae"]) == pytest.approx(2 * ERROR_M)
