"""Readers of point clouds: every format gives the same points, and damage is named."""

import zipfile

import numpy as np
import pytest
from log_files import write_bin, write_pcd, write_ply

from omniocc.data import DataError
from omniocc.data.check_source import out_of_reach
from omniocc.data.formats.clouds import _undo_lzf, read_cloud, read_scan

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
    assert _undo_lzf(np.frombuffer(packed, np.uint8), result) == 20
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
        (
            "1.pcd",
            lambda path: swap(path, b"SIZE 4 4 4 4 2", b"SIZE 4 4 4 4 48"),
            "label of type U and 48 bytes cannot",
        ),
        ("1.pcd", lambda path: swap(path, b"TYPE F F", b"TYPE FI F"), "the field x of type FI and 4 bytes cannot be"),
        ("1.pcd", lambda path: swap(path, b"WIDTH 401", b"WIDTH 77"), "WIDTH 77 and HEIGHT 1 of the header do not"),
        ("1.pcd", lambda path: swap(path, b"POINTS 401", b"POINTS 10"), "WIDTH 401 and HEIGHT 1 of the header do"),
        ("1.pcd", lambda path: few(path, "binary"), "7,038 bytes are left over after the 10 points"),
        ("1.pcd", lambda path: few(path, "ascii"), "bytes are left over after the 10 points that the header names"),
        ("1.pcd", lambda path: added(path), "5 bytes are left over after the 401 points"),
        (
            "1.ply",
            lambda path: swap(path, b"vertex 401", b"vertex 10"),
            "7,038 bytes are left over after the 10 points",
        ),
        ("1.ply", lambda path: swap(path, b"element vertex 401", b"element"), "first element of the file must be"),
        ("1.ply", lambda path: swap(path, b"vertex 401", b"vertex 401 401"), "element vertex is '401 401'"),
        ("1.npz", lambda path: np.savez(path, points=POINTS.T), "the shape (3, 401); it must be (P, 3), a row for"),
        ("1.npz", lambda path: np.savez(path, points=POINTS, labels=LABELS[:-1]), "'labels' has the shape (400,)"),
        ("1.npz", lambda path: np.savez(path, points=POINTS.astype(str)), "its array 'points' is of <U32"),
        (
            "1.npz",
            lambda path: np.savez(path, points=POINTS > 0),
            "its array 'points' is of bool; it must hold numbers",
        ),
        ("1.npz", lambda path: np.savez(path, points=POINTS.astype("c8")), "its array 'points' is of complex64"),
        ("1.npz", lambda path: np.savez(path, points=POINTS.astype("M8[s]")), "its array 'points' is of datetime64[s]"),
        ("1.bin", lambda path: looped(path.with_suffix(".label")), "1.label cannot be read: Too many levels"),
        ("1.bin", lambda path: folder(path.with_suffix(".label")), "1.label cannot be read: it is a folder"),
        ("1.xyz", lambda path: path.touch(), "points are read from .bin, .pcd, .ply, .npz"),
        ("1.bin", lambda path: cut(path.with_suffix(".label"), 8), "1.label: the file has 8 bytes instead of 1,604"),
        ("1.pcd", lambda path: swap(path, b"z intensity", b"x intensity"), "the field 'x' stands twice"),
        ("1.pcd", lambda path: swap(path, b"HEIGHT 1\n", b"SIZE 4 4 4 4 2\n"), "the line of its header 'SIZE' stands"),
        ("1.ply", lambda path: swap(path, b"float intensity", b"float y"), "the property 'y' stands twice"),
        ("1.npz", lambda path: np.savez(path, points=POINTS, x=LABELS), "and the arrays 'x' stands twice"),
        ("1.npz", lambda path: doubled(path), "the array 'labels' stands twice"),
        ("1.npz", lambda path: np.savez(path, points=POINTS, label=LABELS + 0.6), "its field 'label': the array of"),
        ("1.npz", lambda path: np.savez(path, points=POINTS, label=LABELS * np.nan), "no whole numbers: nan"),
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
    assert str(caught.value).startswith((str(tmp_path / name), str(tmp_path / "1.label")))
    assert "\n" not in str(caught.value)


def few(path, encoding):
    """Name 10 of the 401 points in the whole header."""
    write_pcd(path, POINTS, LABELS, encoding)
    swap(path, b"WIDTH 401", b"WIDTH 10")
    swap(path, b"POINTS 401", b"POINTS 10")


def added(path):
    path.write_bytes(path.read_bytes() + b" more")


def doubled(path):
    with zipfile.ZipFile(path, "a") as file, file.open("labels", "w") as entry:
        np.lib.format.write_array(entry, LABELS)


def looped(path):
    path.unlink()
    path.symlink_to(path.name)


def folder(path):
    path.unlink()
    path.mkdir()


def test_underscores_in_numbers_of_points_are_refused(tmp_path):
    write_pcd(tmp_path / "1.pcd", np.full((3, 3), 12.5, np.float32), np.arange(3), "ascii")
    swap(tmp_path / "1.pcd", b"12.5", b"1_2.5")
    with pytest.raises(DataError, match=r"1\.pcd: the points are not 3 lines of 5 numbers"):
        read_cloud(tmp_path / "1.pcd")


@pytest.mark.parametrize("rest", [b"", b"\n", b"\0" * 100])
def test_padding_after_the_points_is_no_point(tmp_path, rest):
    write_pcd(tmp_path / "1.pcd", POINTS, LABELS, "binary")
    (tmp_path / "1.pcd").write_bytes((tmp_path / "1.pcd").read_bytes() + rest)
    same(tmp_path / "1.pcd")


def test_faces_may_follow_the_vertices(tmp_path):
    for encoding, faces in (("ascii", b"3 0 1 2\n"), ("binary_little_endian", b"\x03" + bytes(8) + b"\1\0\0\0")):
        write_ply(tmp_path / "1.ply", POINTS, LABELS, encoding)
        swap(tmp_path / "1.ply", b"face 0", b"face 1")
        (tmp_path / "1.ply").write_bytes((tmp_path / "1.ply").read_bytes() + faces)
        same(tmp_path / "1.ply")


def swap(path, old, new):
    assert old in path.read_bytes()
    path.write_bytes(path.read_bytes().replace(old, new, 1))


def same(path):
    cloud = read_cloud(path)
    assert np.array_equal(cloud.points_m, POINTS)
    assert np.array_equal(cloud.labels, LABELS)


PCD = "FIELDS label z intensity y x\nSIZE 4 4 4 4 4\nTYPE U F F F F\nCOUNT 1 1 1 1 1\nPOINTS 2\nDATA "
ORDERS = {
    "ascii.pcd": PCD + "ascii\n",
    "binary.pcd": PCD + "binary\n",
    "ascii.ply": "ply\nformat ascii 1.0\nelement vertex 2\nproperty uint label\nproperty float z\nproperty float "
    "intensity\nproperty float y\nproperty float x\nend_header\n",
    "binary.ply": "ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty uint label\nproperty float z\n"
    "property float intensity\nproperty float y\nproperty float x\nend_header\n",
}


@pytest.mark.parametrize("name", ORDERS)
def test_fields_are_read_by_their_names_in_any_order(tmp_path, name):
    rows = [(40, 3.0, 0.5, 2.0, 1.0), (70, 6.0, 0.5, 5.0, 4.0)]
    if name.startswith("ascii"):
        body = "".join(" ".join(map(str, row)) + "\n" for row in rows).encode()
    else:
        body = np.array(rows, "<u4,<f4,<f4,<f4,<f4").tobytes()
    (tmp_path / name).write_bytes(ORDERS[name].encode() + body)
    cloud = read_cloud(tmp_path / name)
    assert cloud.points_m.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert cloud.labels.tolist() == [40, 70]


@pytest.mark.parametrize("kind", ["npz", "bin", "pcd", "ply"])
def test_rays_that_did_not_come_back_are_no_points_whatever_their_label(tmp_path, kind):
    lost = np.array([[0, 0, 0], [np.nan, 1, 1], [np.inf, 0, 0], [-0.0, 0, 0]], np.float32)
    points, labels = np.insert(POINTS, [0, 3, 3, 401], lost, axis=0), np.insert(LABELS, [0, 3, 3, 401], 9999)
    path = tmp_path / f"1.{kind}"
    if kind == "npz":
        np.savez(path, points=points, labels=np.where(labels == 9999, np.nan, labels))
    else:
        {"bin": write_bin, "pcd": write_pcd, "ply": write_ply}[kind](path, points, labels)
    same(path)


def test_scans_of_datasets_hold_what_came_back(tmp_path):
    rows = np.array([[1, 2, 3, 9, 9], [0, 0, 0, 9, 9], [0, 0, -2, 9, 9], [1, np.nan, 0, 9, 9]], "<f4")
    rows.tofile(tmp_path / "1.pcd.bin")
    points_m, kept = read_scan(tmp_path / "1.pcd.bin", 5)
    assert points_m.tolist() == [[1, 2, 3], [0, 0, -2]]
    assert kept.tolist() == [True, False, True, False]


@pytest.mark.parametrize(
    ("scale", "shift", "words"),
    [
        (1.0, (0, 0, 0), ""),
        (1000.0, (0, 0, 0), "which looks like millimetres or another unit"),
        (1.0, (5e5, 5e6, 400), "which looks like world coordinates (UTM, map)"),
        (1.0, (3000, 0, 0), "which looks like world coordinates (UTM, map)"),
        (1.0, (200, 0, 0), "are the unit (m) and the pose of the LiDAR right?"),
    ],
)
def test_why_no_point_is_within_reach(scale, shift, words):
    found = out_of_reach(np.float64(POINTS) * scale + shift, 25.6)
    assert words in found
    assert bool(found) == bool(words)


def test_a_stray_point_near_the_car_makes_no_scan_of_points_in_millimetres():
    many = np.concatenate([np.tile(POINTS, (10, 1)) * 1000, np.zeros((1, 3), np.float32)])
    assert out_of_reach(many, 25.6).startswith("1 of its 4,011 points lie within 25.6 m: their median distance is 3")
    assert out_of_reach(many[-500:], 25.6) == ""
