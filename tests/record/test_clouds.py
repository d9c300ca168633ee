"""Readers of point clouds: every format gives the same points, and damage is named."""

import numpy as np
import pytest
from log_files import write_bin, write_pcd, write_ply

from omniocc.data import DataError
from omniocc.data.formats.clouds import _lzf, read_cloud

RNG = np.random.default_rng(0)
POINTS = RNG.uniform(-50, 50, (401, 3)).astype(np.float32)  # odd: a quarter of it is no whole number
LABELS = RNG.integers(0, 300, 401)


@pytest.mark.parametrize("encoding", ["ascii", "binary", "binary_compressed"])
def test_pcd(tmp_path, encoding):
    write_pcd(tmp_path / "1.pcd", POINTS, LABELS, encoding)
    same(tmp_path / "1.pcd")


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian"])
def test_ply(tmp_path, encoding):
    write_ply(tmp_path / "1.ply", POINTS, LABELS, encoding)
    same(tmp_path / "1.ply")


def test_bin_with_labels_beside(tmp_path):
    write_bin(tmp_path / "1.bin", POINTS, LABELS)
    same(tmp_path / "1.bin")
    (tmp_path / "1.label").unlink()
    assert read_cloud(tmp_path / "1.bin").labels is None
    POINTS.tofile(tmp_path / "2.bin")
    assert np.array_equal(read_cloud(tmp_path / "2.bin", columns=3).points_m, POINTS)


@pytest.mark.parametrize("numbers", [POINTS.astype(np.float64), np.float64(POINTS) + 1 / 3, POINTS * 1000])
def test_bin_of_another_type_or_unit_is_named(tmp_path, numbers):
    """Of the first the lower halves are those of float32, mostly zeros; the last is in millimetres."""
    numbers[:400].tofile(tmp_path / "1.bin")
    with pytest.raises(DataError, match=r"1.bin: \d+% of its coordinates are no distances in metres"):
        read_cloud(tmp_path / "1.bin", columns=3)


def test_an_empty_bin_has_no_points(tmp_path):
    (tmp_path / "1.bin").write_bytes(b"")
    assert read_cloud(tmp_path / "1.bin").points_m.shape == (0, 3)


def test_npz(tmp_path):
    np.savez(tmp_path / "1.npz", points=POINTS, labels=LABELS)
    same(tmp_path / "1.npz")
    np.savez(tmp_path / "2.npz", points=np.column_stack([POINTS, LABELS]), kind=LABELS)
    assert np.array_equal(read_cloud(tmp_path / "2.npz", "kind").labels, LABELS)
    assert read_cloud(tmp_path / "2.npz").labels is None


def test_points_that_are_not_finite_are_left_out_with_their_labels(tmp_path):
    points = POINTS.copy()
    points[[3, 7], [0, 2]] = np.nan, np.inf
    np.savez(tmp_path / "1.npz", points=points, labels=LABELS)
    cloud = read_cloud(tmp_path / "1.npz")
    kept = np.isfinite(points).all(1)
    assert np.array_equal(cloud.points_m, points[kept])
    assert np.array_equal(cloud.labels, LABELS[kept])


def test_lzf_undoes_a_known_stream():
    """Bytes by hand after the definition of LZF: 'ab', then 5 bytes from 2 back, then 12 from 1 back, then 'c'."""
    packed = bytes([1, 97, 98, (5 - 2) << 5, 1, 7 << 5, 12 - 9, 0, 0, 99])
    result = np.empty(20, np.uint8)
    assert _lzf(np.frombuffer(packed, np.uint8), result) == 20
    assert result.tobytes() == b"ab" + b"ababa" + b"a" * 12 + b"c"


def cut(path, size):
    path.write_bytes(path.read_bytes()[:size])


@pytest.mark.parametrize(
    ("name", "harm", "words"),
    [
        ("1.bin", lambda path: cut(path, 1000), "the file has 1,000 bytes instead of a multiple of 16"),
        ("1.pcd", lambda path: cut(path, 900), "compressed bytes instead of"),
        ("1.pcd", lambda path: cut(path, 100), "the header of a PCD file is missing"),
        ("1.pcd", lambda path: swap(path, b"FIELDS x", b"FIELDS a"), "the field x is missing; the file has a, y, z"),
        ("1.pcd", lambda path: swap(path, b"SIZE 4 4", b"SIZE 4"), "FIELDS, SIZE, TYPE and COUNT"),
        ("1.pcd", lambda path: swap(path, b"binary_compressed", b"secret"), "DATA secret cannot be read"),
        ("1.ply", lambda path: cut(path, 2000), "bytes follow the header instead of"),
        ("1.ply", lambda path: swap(path, b"little", b"big"), "the format binary_big_endian cannot be read"),
        ("1.ply", lambda path: cut(path, 50), "the header of a PLY file is missing"),
        ("1.npz", lambda path: cut(path, 300), "the file is damaged"),
        ("1.npz", lambda path: np.savez(path, dots=POINTS), "its array 'points' is missing"),
        ("1.xyz", lambda path: path.touch(), "points are read from .bin, .pcd, .ply, .npz"),
        ("1.bin", lambda path: cut(path.with_suffix(".label"), 8), "1.label: the file has 8 bytes instead of 1,604"),
    ],
)
def test_what_is_wrong_with_a_file_is_named(tmp_path, name, harm, words):
    write_bin(tmp_path / "1.bin", POINTS, LABELS)
    write_pcd(tmp_path / "1.pcd", POINTS, LABELS)
    write_ply(tmp_path / "1.ply", POINTS, LABELS)
    np.savez(tmp_path / "1.npz", points=POINTS, labels=LABELS)
    harm(tmp_path / name)
    with pytest.raises(DataError) as caught:
        read_cloud(tmp_path / name)
    assert words in str(caught.value)
    assert str(caught.value).startswith(str(tmp_path))
    assert "\n" not in str(caught.value)


def swap(path, old, new):
    assert old in path.read_bytes()
    path.write_bytes(path.read_bytes().replace(old, new, 1))


def same(path):
    cloud = read_cloud(path)
    assert np.array_equal(cloud.points_m, POINTS)
    assert np.array_equal(cloud.labels, LABELS)
