import json
import math

import numpy as np
import pytest

from omniocc.errors import UserError
from omniocc.runs.robustness import (
    UNDISTURBED,
    PartScores,
    Robustness,
    drop_of,
    drops_by_kind,
    jackknife_error,
    load_part,
    load_robustness,
    read_robustness,
    relative_drop,
    save_part,
    save_robustness,
)


def part(name, score, without, group="kind", scenes=("a", "b", "c")):
    return PartScores(name, group, list(scenes), 6, 1.5, {"rayiou": score}, without={"rayiou": list(without)})


BASE = part(UNDISTURBED, 0.5, [0.45, 0.5, 0.55], UNDISTURBED)
WORSE = part("noise_5_percent", 0.3, [0.26, 0.3, 0.34])


def test_the_jackknife_of_a_mean_is_its_standard_error():
    values = np.random.default_rng(0).normal(size=20)
    without = (values.sum() - values) / 19
    assert jackknife_error(without) == pytest.approx(values.std(ddof=1) / math.sqrt(20))
    assert math.isnan(jackknife_error(np.array([0.3])))


def test_a_drop_on_the_same_scenes_has_the_error_of_the_difference():
    drop = drop_of(WORSE, BASE)
    assert drop.value == pytest.approx(0.2)
    differences = [0.19, 0.2, 0.21]
    assert drop.error == pytest.approx(math.sqrt(2 / 3 * sum((d - 0.2) ** 2 for d in differences)))
    assert relative_drop(WORSE, BASE) == pytest.approx(0.4)


def test_a_drop_on_other_scenes_has_the_errors_of_both_sides():
    other = WORSE._replace(scenes=["d", "e", "f"])
    own = [math.sqrt(2 / 3 * 2 * step**2) for step in (0.05, 0.04)]
    assert drop_of(other, BASE).error == pytest.approx(math.hypot(*own))


def test_what_was_not_scored_has_no_drop():
    assert all(map(math.isnan, drop_of(WORSE, BASE, "lidar/rayiou")))
    nothing = BASE._replace(scores={"rayiou": 0.0})
    assert math.isnan(relative_drop(WORSE, nothing))


def test_losses_of_a_kind_are_means_over_its_parts():
    milder = part("noise_2_percent", 0.4, [0.4, 0.4, 0.4])
    blur = part("blur_1_px", 0.45, [0.4, 0.4, 0.4], "blur")
    record = Robustness("some", {}, [BASE, milder, WORSE, blur])
    assert drops_by_kind(record) == {"kind": pytest.approx(0.3), "blur": pytest.approx(0.1)}
    assert drops_by_kind(record, {"noise_5_percent"}) == {"kind": pytest.approx(0.4)}


def test_parts_and_records_survive_their_files(tmp_path):
    empty = part("view_90_deg", math.nan, [math.nan, 0.1, 0.2])
    path = tmp_path / "view_90_deg.json"
    save_part(path, empty, "key")
    again = load_part(path, "key")
    assert math.isnan(again.scores["rayiou"])
    assert again.without["rayiou"][1:] == [0.1, 0.2]
    assert load_part(path, "another key") is None
    assert load_part(tmp_path / "absent.json", "key") is None
    record = Robustness("ours-12345678", {"seed": 0}, [BASE, WORSE])
    assert load_robustness(save_robustness(tmp_path, record)) == record


def test_damaged_files_are_named(tmp_path, capsys):
    path = tmp_path / "part.json"
    for text in ("", "{", "[]", '{"key": "key"}'):
        path.write_text(text)
        with pytest.raises(UserError, match=r"part\.json is damaged"):
            load_part(path, "key")
    good = Robustness("ours-12345678", {}, [BASE, WORSE])
    save_robustness(tmp_path / "ours-12345678" / "robustness-best", good)
    save_robustness(tmp_path / "robustness-tiny", good._replace(system="tiny"))
    broken = tmp_path / "robustness-any" / "robustness.json"
    broken.parent.mkdir()
    broken.write_text("{}")
    assert [record.system for record in read_robustness(tmp_path)] == ["ours-12345678", "tiny"]
    assert f"left out: {broken} is damaged" in capsys.readouterr().err
    content = json.loads((tmp_path / "robustness-tiny" / "robustness.json").read_text())
    content["parts"][0]["scores"]["rayiou"] = 10**400
    broken.write_text(json.dumps(content))
    with pytest.raises(UserError, match=r"robustness\.json is damaged \(a score is 1000"):
        load_robustness(broken)
