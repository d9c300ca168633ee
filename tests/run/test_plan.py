import pytest

from omniocc.run.plan import plan_line


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ((1000, None, 400, 2, 1, 1), "1000 steps of 2 samples: 5.0 epochs of 400 frames"),
        ((-1, 40, 43_200, 1, 4, 1), "432000 steps of 1 x 4 devices samples: 40.0 epochs of 43200 frames"),
        ((-1, 40, 43_200, 1, 1, 1), "1728000 steps of 1 samples: 40.0 epochs of 43200 frames"),
        ((-1, 2, 7, 2, 1, 2), "4 steps of 2 x 2 batches samples: 2.3 epochs of 7 frames"),
        ((100, 1, 400, 2, 1, 1), "100 steps of 2 samples: 0.5 epochs of 400 frames"),
        ((-1, -1, 9, 1, 1, 1), "without end, over 9 frames"),
    ],
)
def test_steps_samples_and_epochs(arguments, line):
    assert plan_line(*arguments) == line
