"""The base of all metrics here: sums over a dataset that keep their types and join only those of an equal setting."""

from collections.abc import Callable
from typing import Any

import torch
from jaxtyping import UInt8
from torch import Tensor
from torch.nn import Module
from torchmetrics import Metric
from torchmetrics.utilities import dim_zero_sum

OTHER_SETTING = (
    "were counted with other arguments (grid, classes, thresholds, bands, rays or options); make both metrics with the "
    "same ones"
)


def only_one(hashes: UInt8[Tensor, "N 16"]) -> UInt8[Tensor, "16"]:
    """Return the hash of all these settings; raise ValueError if they differ."""
    if not torch.equal(hashes, hashes[:1].expand_as(hashes)):
        raise ValueError(f"these counts cannot be added: they {OTHER_SETTING}")
    return hashes[0]


class CountMetric(Metric):
    """A metric whose scores follow from sums over the dataset and all processes.

    The hash of its setting is its first state. Without it, torchmetrics would add counts of other settings, and let the
    metrics of a `MetricCollection` with equal states share them for good, even if they are equal only by chance, as
    after a first batch without known cells.
    """

    is_differentiable = False
    full_state_update = False
    plot_lower_bound = 0.0
    setting: Tensor

    def add_setting(self, setting: UInt8[Tensor, "16"]) -> None:
        """Add the state that keeps metrics of other settings apart; call this first.

        States are joined in the order in which they were added: where this one raises, the others have not changed.
        """
        self.add_state("setting", setting, dist_reduce_fx=only_one)

    def merge_state(self, incoming_state: "dict[str, Any] | Metric") -> None:
        """Add the counts of another metric, or of its `metric_state`.

        Raises:
            ValueError: if they are of another setting; then nothing is added.
        """
        given = incoming_state.metric_state if isinstance(incoming_state, type(self)) else incoming_state
        if isinstance(given, dict):
            # states of before the setting was one of them are still added
            kept = {name: value for name, value in self._defaults.items() if self._reductions[name] is not dim_zero_sum}
            given = {name: value.to(self.device) for name, value in {**kept, **given}.items()}
            self._check(given)
        super().merge_state(given)
        self._computed = None  # torchmetrics would go on to return the scores of before
        self._update_count += getattr(incoming_state, "update_count", 1)

    def _load_from_state_dict(self, state_dict: dict[str, Any], prefix: str, *args: Any) -> None:
        states = {name: state_dict[prefix + name] for name in self._defaults if prefix + name in state_dict}
        self._check(states)
        state_dict |= {prefix + name: value.to(self._defaults[name]) for name, value in states.items()}
        super()._load_from_state_dict(state_dict, prefix, *args)
        self._computed = None if states else self._computed

    def _check(self, states: dict[str, Any]) -> None:
        """Raise ValueError unless states are those of a metric of this setting."""
        own = self.metric_state
        fits = all(value.shape == torch.as_tensor(own[name]).shape for name, value in states.items() if name in own)
        if not fits or not torch.equal(states.get("setting", self.setting).to(self.setting), self.setting):
            raise ValueError(f"these counts cannot be taken into {type(self).__name__}: they {OTHER_SETTING}")

    def _apply(self, fn: Callable[[Tensor], Tensor], *args: Any, **kwargs: Any) -> Module:
        """Move the states to a device without a change of their type, in which counts would no longer be exact."""

        def moved(tensor: Tensor) -> Tensor:
            found = fn(tensor)
            return found if found.dtype == tensor.dtype else tensor.to(found.device)

        return super()._apply(moved, *args, **kwargs)
