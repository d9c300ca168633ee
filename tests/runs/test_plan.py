import pytest

from omniocc.runs.plan import Amount, hours_line, validation_times


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ((1000, None, 400, 2, 1, 1), "1000 steps of 2 samples: 5.0 epochs of 400 frames"),
        ((-1, 40, 43_200, 1, 4, 1), "432000 steps of 1 x 4 devices samples: 40.0 epochs of 43200 frames"),
        ((-1, 40, 43_200, 1, 1, 1), "1728000 steps of 1 samples: 40.0 epochs of 43200 frames"),
        ((-1, 2, 7, 2, 1, 2), "2 steps of 2 x 2 batches samples: 1.1 epochs of 7 frames"),
        ((100, 1, 400, 2, 1, 1), "100 steps of 2 samples: 0.5 epochs of 400 frames"),
        ((-1, -1, 9, 1, 1, 1), "without end, over 9 frames"),
        ((-1, None, 9, 1, 1, 1), "9000 steps of 1 samples: 1000.0 epochs of 9 frames"),
    ],
)
def test_steps_samples_and_epochs(arguments, line):
    amount = Amount(*arguments)
    assert amount.line == line
    assert line.startswith("without end" if amount.steps is None else f"{amount.steps} steps")


@pytest.mark.parametrize(("limit", "steps"), [(1.0, 6), (2, 2), (3, 4), (100, 6), (0.5, 4)])
def test_limited_epochs_have_fewer_steps(limit, steps):
    assert Amount(-1, 2, 13, 2, 1, 2, limit).steps == steps  # three steps of two batches in an epoch


def test_hours():
    assert hours_line(1000, 0.35) == "0.35 s a step: 5:50 min"
    assert hours_line(1_728_000, 0.5) == "0.50 s a step: 10.0 days"
    assert hours_line(None, 0.5) == "0.50 s a step: without end"


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, {"check_val_every_n_epoch": None, "val_check_interval": 200}),
        ({"accumulated": 4}, {"check_val_every_n_epoch": None, "val_check_interval": 800}),
        ({"max_steps": 12}, {"check_val_every_n_epoch": None, "val_check_interval": 3}),
        ({"max_steps": 7}, {"check_val_every_n_epoch": None, "val_check_interval": 7}),
        ({"max_steps": -1, "max_epochs": 40}, {"check_val_every_n_epoch": 1}),
        ({"max_epochs": 2}, {"check_val_every_n_epoch": 1}),
        ({"every_n_epochs": 3}, {"check_val_every_n_epoch": 3}),
    ],
)
def test_the_end_of_training_is_validated(changes, expected):
    plain = {"max_steps": 1000, "max_epochs": None, "accumulated": 1, "every_n_epochs": None}
    assert validation_times(**plain | changes) == expected
