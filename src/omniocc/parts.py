"""From a configuration to objects: every part of a run is built here, when it is asked for."""

from functools import cached_property
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf, open_dict

from omniocc.config import build, plain, target_of

if TYPE_CHECKING:  # a script that renders or records starts without torch and Lightning
    from lightning.pytorch import Callback, Trainer
    from torch import nn

    from omniocc.data import OccupancyData, SceneSource
    from omniocc.model import OccupancyModel

TASK_KEYS = ("model", "loss", "optimizer", "augment")
"""Root keys from which the occupancy task is built."""
NO_HEAD = {"_target_": "omniocc.model.semantic_head.NoSemanticHead"}
"""The option `model/semantic_head=none`."""


class Parts:
    """The parts that a checked configuration describes; each call builds a new object, with new random weights.

    All methods raise ConfigError when a constructor refuses a value.

    Args:
        cfg: configuration of `train.yaml`, or the part of it that the called methods build from.
    """

    def __init__(self, cfg: DictConfig):
        self.cfg = cfg

    @cached_property
    def config(self) -> dict[str, Any]:
        """Return the whole tree, resolved, as plain dicts and lists."""
        return plain(self.cfg)

    def data(self, **changes: Any) -> "OccupancyData":
        """Return the data; `changes` replace arguments of the configuration."""
        return build(self.cfg.data, **changes)

    def source(self, **changes: Any) -> "SceneSource":
        """Return only the source of the scenes; `changes` replace arguments of the configuration."""
        return build(self.cfg.data.source, **changes)

    def depth(self) -> "nn.Module":
        """Return the depth option alone, without the sketch that uses it."""
        return build(self.cfg.depth)

    def sketch(self) -> "nn.Module":
        """Return the sketch, its depth included."""
        return build(self.cfg.model.sketch)

    def model(self) -> "OccupancyModel":
        """Return the occupancy model, its sketch included."""
        return build(self.cfg.model)

    def appearance(self) -> Any:
        """Return the augmentation of the depth stage, `omniocc.data.Appearance` or `Disturbances`; None without any."""
        return None if self.cfg.appearance is None else build(self.cfg.appearance)

    def loss(self) -> Any:
        """Return the loss of the occupancy stage, `omniocc.loss.TotalLoss`."""
        return build(self.cfg.loss)

    def task_parts(self) -> tuple[Any, Any, Any]:
        """Return loss, optimiser and augmentation of the occupancy stage."""
        return self.loss(), build(self.cfg.optimizer), build(self.cfg.augment)

    def recipe(self, stage: str) -> Any:
        """Return the training recipe of a stage, `omniocc.train.Recipe`."""
        return build(self.cfg.stages[stage])

    def trainer(self, **changes: Any) -> "Trainer":
        """Return Lightning's trainer; without changes it writes nothing and serves to ask for devices."""
        return build(self.cfg.trainer, **(changes or {"logger": False, "enable_checkpointing": False}))

    def callbacks(self) -> "list[Callback]":
        """Return the user's own callbacks of the last stage."""
        return [build(callback) for callback in self.cfg.callbacks.values()]

    def loggers(self) -> Any:
        """Return the factory of a run's loggers, `omniocc.runs.wandb.loggers.Loggers`."""
        return build(self.cfg.logger)

    def recorder(self) -> Any:
        """Return the recorder of scenes."""
        return build(self.cfg.recorder)

    @property
    def has_head(self) -> bool:
        """Return whether the 2D head classifies pixels; without the attribute `CLASSIFIES`, True."""
        return getattr(target_of(self.cfg.model.semantic_head), "CLASSIFIES", True)

    def without_head(self) -> "Parts":
        """Return the same parts without the 2D head and without the hint that looks its classes up."""
        cfg = self.cfg.copy()
        with open_dict(cfg):
            cfg.model.semantic_head = NO_HEAD
            cfg.model.hints.pixel_classes = False
        return Parts(cfg)

    def without_pretrained(self) -> "Parts":
        """Return the same parts without pretrained weights, for models whose weights come from a checkpoint.

        Backbone and depth name the arguments that only load weights in `PRETRAINED`; others are built as they are.
        """
        cfg = self.cfg.copy()
        for key in ("model.backbone", "depth", "model.sketch.depth"):
            if (part := OmegaConf.select(cfg, key)) is not None:
                part.update(dict.fromkeys(getattr(target_of(part), "PRETRAINED", ())))
        return Parts(cfg)
