import math

from omniocc.run.wandb.journal import Journal


def test_rows_come_back_but_for_one_that_was_torn(tmp_path):
    journal = Journal(tmp_path / "wandb" / "rows.jsonl")
    assert journal.read() == []
    journal.add(0, {"train/loss": 2.5})
    journal.add(3, {"val/rayiou/Pole": math.nan, "epoch": 1})
    with journal.path.open("a") as file:
        file.write('{"step": 4, "fig')
    first, second = journal.read()
    assert first == (0, {"train/loss": 2.5})
    assert second[0] == 3
    assert math.isnan(second[1]["val/rayiou/Pole"])
    journal.add(4, {"train/loss": 1.0})
    assert [step for step, _ in journal.read()] == [0, 3, 4]
