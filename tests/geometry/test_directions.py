import torch

from omniocc.metric import eight_origins


def test_eight_evenly_spaced_positions_are_taken():
    positions = torch.zeros(20, 3)
    positions[:, 0] = torch.arange(20) - 9.0
    # round(linspace(0, 19, 8)) = 0, 2.7, 5.4, 8.1, 10.9, 13.6, 16.3, 19
    assert (eight_origins(positions)[:, 0] + 9).tolist() == [0, 3, 5, 8, 11, 14, 16, 19]


def test_few_positions_are_kept_and_far_ones_dropped():
    positions = torch.tensor(
        [[38.9, 0.0, 0.0], [39.0, 0.0, 0.0], [-39.0, 0.0, 0.0], [0.0, -38.0, 500.0], [0.0, 40.0, 0.0], [1.0, 1.0, 1.0]]
    )
    assert eight_origins(positions).tolist() == positions[[0, 3, 5]].tolist()
    assert len(eight_origins(torch.zeros(8, 3))) == 8  # those of a standing car are all kept
    assert eight_origins(torch.full((4, 3), 50.0)).shape == (0, 3)
