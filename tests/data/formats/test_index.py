import json
from typing import NamedTuple

import numpy as np
import pytest

from omniocc.data.formats.index import Index
from omniocc.errors import DataError


class Row(NamedTuple):
    tokens: np.ndarray
    poses: np.ndarray


def rows(seed=0):
    rng = np.random.default_rng(seed)
    return {name: Row(np.array([f"{name}{k}" for k in range(3)]), rng.random((3, 4, 4))) for name in ("b", "a")}


def index_of(folder, build=rows):
    return Index(folder / "cache" / "index", Row, build)


def test_it_is_built_once_and_read_by_scene(tmp_path):
    calls = []

    def build():
        calls.append(1)
        return rows()

    for _ in range(2):
        index = index_of(tmp_path, build)
        index.prepare()
        assert index.names == ["a", "b"]
        assert index.read("b").tokens.tolist() == ["b0", "b1", "b2"]
        np.testing.assert_array_equal(index.read("a").poses, rows()["a"].poses)
    assert calls == [1]


def test_its_fingerprint_is_that_of_the_content(tmp_path):
    indices = [index_of(tmp_path / str(k), lambda k=k: rows(k // 2)) for k in range(3)]
    for index in indices:
        index.prepare()
    assert indices[0].fingerprint == indices[1].fingerprint != indices[2].fingerprint


def test_what_stopped_on_the_way_is_built_again(tmp_path):
    def fails():
        raise DataError("no tables")

    with pytest.raises(DataError, match="no tables"):
        index_of(tmp_path, fails).prepare()
    with pytest.raises(DataError, match="the dataset has no scenes"):
        index_of(tmp_path, dict).prepare()
    index = index_of(tmp_path)
    index.prepare()
    (index.folder / "scenes.json").unlink()  # killed before the last file was written
    again = index_of(tmp_path)
    again.prepare()
    assert again.names == ["a", "b"]


def test_damage_is_named(tmp_path):
    index = index_of(tmp_path)
    index.prepare()
    (index.folder / "a.npz").write_bytes(b"PK")
    with pytest.raises(DataError, match=r"a\.npz: the index is damaged .* remove the folder"):
        index_of(tmp_path).read("a")
    (index.folder / "scenes.json").write_text(json.dumps([["a", "0"]])[:-3])
    with pytest.raises(DataError, match=r"scenes\.json: the index cannot be read"):
        _ = index_of(tmp_path).names
