"""Temporal slot: what past frames add."""

from omniocc.model.protocols import Temporal
from omniocc.model.temporal.mean import Mean
from omniocc.model.temporal.none import NoTemporal
from omniocc.model.temporal.recurrent import Recurrent

__all__ = ["Mean", "NoTemporal", "Recurrent", "Temporal"]
