"""Which rays the errors of range count."""

import pytest
import torch
from batches import RIG, make_batch

from omniocc.parts import Parts
from omniocc.train.depth import DepthTask

ERROR_M = 0.5


@pytest.mark.parametrize(("option", "counts_all"), [("centred", False), ("omnimvs", True)])
def test_rays_that_a_network_leaves_out_have_no_error(option, counts_all, smoke, spec, make_task, monkeypatch):
    parts = Parts(smoke(f"model/depth={option}"))
    model = parts.depth()
    task = DepthTask(model, parts.recipe("depth").optimizer, model.rig_spheres(RIG), spec.range_edges_m, 0, {})
    batch = make_batch(make_task("model=flashocc"), [(0, 0), (1, 0)])._replace(
        erp_range_m=10 + 10 * torch.rand(2, 12, 48)
    )
    answer = model(batch.images[:, -1], batch.newest_rigs)
    valid = torch.zeros_like(answer.valid)
    valid[..., ::2] = True
    range_m = torch.where(valid, batch.erp_range_m + ERROR_M, torch.full_like(answer.range_m, 1e5))
    monkeypatch.setattr(model, "forward", lambda *_: answer._replace(range_m=range_m, valid=valid))
    logged = {}
    monkeypatch.setattr(task, "log_dict", lambda scores, **_: logged.update(scores))
    task.validation_step(batch, 0)
    task.log_scores("val")
    assert float(logged["val/depth/coverage"]) == 0.5
    assert (float(logged["val/depth/mae"]) > 10) == counts_all
    assert counts_all or float(logged["val/depth/mae"]) == pytest.approx(ERROR_M)
