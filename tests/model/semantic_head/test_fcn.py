import torch

from omniocc.model.semantic_head import FCN


def test_classifies_the_pixels_of_the_finest_map():
    finest, coarse = torch.randn(2, 6, 8, 9, 16), torch.randn(2, 6, 8, 5, 8)
    head = FCN(8, 4, 12).eval()
    logits = head([finest, coarse])
    assert logits.shape == (2, 6, 12, 9, 16)
    torch.testing.assert_close(logits[1, 2], head.layers(finest[1, 2:3])[0])
