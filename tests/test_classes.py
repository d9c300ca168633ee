import json

import numpy as np
import pytest

from omniocc.classes import CLASSES, NUM_CLASSES, WORLD_CLASSES, ClassTable, SemanticClass

ROWS = (SemanticClass(0, "free", (255, 255, 255)), SemanticClass(1, "car", (0, 0, 142)))


def test_world_table_has_the_rows_of_the_world():
    assert WORLD_CLASSES.num_classes == NUM_CLASSES == len(CLASSES) == 12
    assert WORLD_CLASSES.names[1] == "Road"
    assert WORLD_CLASSES.occupied == tuple(range(1, 12))
    palette = WORLD_CLASSES.palette
    assert palette.shape == (256, 3)
    assert palette.dtype == np.uint8
    assert palette[1].tolist() == [128, 64, 128]
    assert not palette[12:].any()


def test_dictionary_survives_json():
    for table in (WORLD_CLASSES, ClassTable(ROWS)):
        again = ClassTable.from_dict(json.loads(json.dumps(table.to_dict())))
        assert again == table
        assert hash(again) == hash(table)
    assert ClassTable(ROWS) != WORLD_CLASSES


def test_ids_with_two_digits_keep_their_order():
    data = dict(sorted(WORLD_CLASSES.to_dict().items()))
    assert list(data)[1:3] == ["1", "10"]
    assert ClassTable.from_dict(data) == WORLD_CLASSES


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (ROWS[:1], "1 rows.*2 to 255"),
        ((ROWS[0], ROWS[1]._replace(id=2)), "'car' has id 2 in row 1"),
        ((ROWS[0], ROWS[1]._replace(name="free")), "class 0 has the name 'free'.*unique"),
        ((ROWS[0], ROWS[1]._replace(rgb=(0, 0, 256))), "'car' has rgb.*256.*0..255"),
    ],
)
def test_error_names_the_wrong_row(rows, message):
    with pytest.raises(ValueError, match=message):
        ClassTable(rows)


@pytest.mark.parametrize("data", [{"x": {"name": "free", "rgb": [0, 0, 0]}}, {"0": {"rgb": [0, 0, 0]}}, {"0": 1}])
def test_error_for_other_dictionaries(data):
    with pytest.raises(ValueError, match="must map ids to name and rgb"):
        ClassTable.from_dict(data)
