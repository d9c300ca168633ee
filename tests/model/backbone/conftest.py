import pytest
import torch


@pytest.fixture
def assert_aligned():
    """Check that a changed patch of an image changes the map of stride 4 most where the patch is."""

    def check(backbone):
        backbone.eval()
        image = torch.rand(1, 1, 3, 32, 64)
        changed = image.clone()
        changed[..., 16:20, 40:44] = 0.5
        difference = (backbone(changed)[0] - backbone(image)[0]).abs().sum((0, 1, 2))
        row, column = divmod(int(difference.argmax()), 16)
        assert abs(row - 4) <= 1
        assert abs(column - 10) <= 1

    return check
