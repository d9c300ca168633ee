"""What is checked before anything is made."""

import pytest
import torch

from omniocc.errors import UserError
from omniocc.task.build import check_devices


def test_a_machine_that_lacks_what_is_asked_for_is_a_line(smoke):
    check_devices(smoke().trainer)
    if torch.cuda.is_available():
        pytest.skip("this machine has a GPU")
    with pytest.raises(UserError) as caught:
        check_devices(smoke("trainer.accelerator=gpu").trainer)
    assert str(caught.value).startswith("trainer.accelerator=gpu trainer.devices=1 trainer.strategy=auto: this machine")
    assert "\n" not in str(caught.value)
