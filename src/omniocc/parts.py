"""From a configuration to objects: every part of a run is built here, when it is asked for."""

from functools import cached_property
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, open_dict

from omniocc.config import build, plain, target_of

if TYPE_CHECKING:  # a script that renders or records starts without torch and Lightning
    from lightning.pytorch import Callback, Trainer
    from torch import nn

    from omniocc.data import OccupancyData, SceneSource
    from omniocc.model import OccupancyModel

OF_TASK = ("model", "loss", "optimizer", "augment")
"""Root keys from which the occupancy task is built."""
NO_HEAD = {"_target_": "omniocc.model.semantic_head.NoSemanticHead"}
"""The option `model/semantic_head=none`."""


class Parts:
    """The parts that a checked configuration describes; each call builds a new object, with new random weights.

    All methods raise ConfigError when a constructor refuses a value.

    Args:
        cfg: of `train.yaml`, or the part of it that is asked for.
    """

    def __init__(self, cfg: DictConfig):
        self.cfg = cfg

    @cached_property
    def config(self) -> dict[str, Any]:
        """Return the whole tree, resolved, as plain dicts and lists."""
        return plain(self.cfg)

    def data(self, **changes: Any) -> "OccupancyData":
        """Return the data, with other arguments than those of the configuration."""
        return build(self.cfg.data, **changes)

    def source(self, **changes: Any) -> "SceneSource":
        """Return the source of the scenes alone, with other arguments than those of the configuration."""
        return build(self.cfg.data.source, **changes)

    def depth(self) -> "nn.Module":
        """Return the depth option, with which no sketch is built yet."""
        return build(self.cfg.depth)

    def sketch(self) -> "nn.Module":
        """Return the sketch, its depth included."""
        return build(self.cfg.model.sketch)

    def model(self) -> "OccupancyModel":
        """Return the occupancy model, its sketch included."""
        return build(self.cfg.model)

    def appearance(self) -> Any:
        """Return the changes of the depth stage's images, `omniocc.data.Appearance`; None without any."""
        return None if self.cfg.appearance is None else build(self.cfg.appearance)

    def of_task(self) -> tuple[Any, Any, Any]:
        """Return loss, optimiser and augmentation of the occupancy stage."""
        return build(self.cfg.loss), build(self.cfg.optimizer), build(self.cfg.augment)

    def recipe(self, stage: str) -> Any:
        """Return how a stage is trained, `omniocc.train.Recipe`."""
        return build(self.cfg.stages[stage])

    def trainer(self, **changes: Any) -> "Trainer":
        """Return Lightning's trainer on this machine; without changes one that writes nothing, to ask for devices."""
        return build(self.cfg.trainer, **(changes or {"logger": False, "enable_checkpointing": False}))

    def callbacks(self) -> "list[Callback]":
        """Return the user's own callbacks of the last stage."""
        return [build(callback) for callback in self.cfg.callbacks.values()]

    def loggers(self) -> Any:
        """Return what makes the loggers of a run, `omniocc.runs.wandb.loggers.Loggers`."""
        return build(self.cfg.logger)

    def recorder(self) -> Any:
        """Return what records scenes."""
        return build(self.cfg.recorder)

    @property
    def has_head(self) -> bool:
        """Return whether the 2D head classifies pixels; foreign heads do unless they say `CLASSIFIES = False`."""
        return getattr(target_of(self.cfg.model.semantic_head), "CLASSIFIES", True)

    def without_head(self) -> "Parts":
        """Return the same parts without the 2D head and what looks its classes up."""
        cfg = self.cfg.copy()
        with open_dict(cfg):
            cfg.model.semantic_head = NO_HEAD
            cfg.model.hints.pixel_classes = False
        return Parts(cfg)

    def without_pretrained(self) -> "Parts":
        """Return the same parts, whose model loads no pretrained weights, since those of a checkpoint replace them.

        A backbone names the arguments that only load weights in `PRETRAINED`; one without it is built as it is.
        """
        cfg = self.cfg.copy()
        for name in getattr(target_of(cfg.model.backbone), "PRETRAINED", ()):
            cfg.model.backbone[name] = None
        return Parts(cfg)
