"""Silence the banners, tips and warnings of other libraries."""

import logging
import os
import warnings


def quiet() -> None:
    """Silence the banners, tips and known harmless warnings of other libraries in this process."""
    for name in ("lightning.pytorch", "lightning.fabric"):
        logging.getLogger(name).setLevel(logging.ERROR)
    os.environ.setdefault("TOKENIZERS_PARALLELISM", "false")
    warnings.filterwarnings("ignore", module="lightning")
    warnings.filterwarnings("ignore", module="torch.utils.data")
    warnings.filterwarnings("ignore", message="Grad strides do not match bucket view strides")
