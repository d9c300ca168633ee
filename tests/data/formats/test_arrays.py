"""Files of arrays and point clouds whose headers claim more than they hold."""

import io
import os
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch

from omniocc.data.formats import clouds
from omniocc.data.formats.arrays import LIMIT_BYTES, npz_arrays
from omniocc.data.formats.files import load_npy, read_bytes, read_npz
from omniocc.errors import DataError, UserError
from omniocc.geometry import Cuboid
from omniocc.predict.output.voxel_files import VOXELS, read_labels, read_voxels
from omniocc.runs.checkpoint_io import read_checkpoint
from omniocc.runs.weights import read_weights

pytestmark = pytest.mark.usefixtures("little_memory")


def npy(shape: tuple[int, ...], dtype: str = "<f8", content: bytes = bytes(64)) -> bytes:
    """Return an npy file whose header claims a shape."""
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": dtype, "fortran_order": False, "shape": shape})
    return file.getvalue() + content


def npz(path: Path, **members: bytes) -> Path:
    """Write an npz file of members as they are."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return path


def npz_of_zeros(path: Path, name: str, shape: tuple[int, ...]) -> Path:
    """Write a compressed npz file of uint8 zeros, piece by piece."""
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open(f"{name}.npy", "w", force_zip64=True) as file,
    ):
        file.write(npy(shape, "|u1", b""))
        for _ in range(0, int(np.prod(shape)), 2**22):
            file.write(bytes(2**22))
    return path


@pytest.mark.parametrize("shape", [(9,), (2**62, 2**62), (-8,), (-1, -8)], ids=str)
def test_a_header_that_claims_more_than_the_file(shape, tmp_path):
    path = tmp_path / "a.npy"
    path.write_bytes(npy(shape))
    said = rf"a\.np[yz]: the file is damaged \(its header claims {re_escape(shape)} of float64, .* but 64 follow\)"
    with pytest.raises(DataError, match=said):
        load_npy(path)
    with pytest.raises(DataError, match=said):
        read_npz(npz(tmp_path / "a.npz", pred=npy(shape)), {"pred": (8,)})
    with pytest.raises(DataError, match=said):
        clouds.read_npz(npz(tmp_path / "a.npz", points=npy(shape)))


def re_escape(shape: tuple[int, ...]) -> str:
    return str(shape).replace("(", r"\(").replace(")", r"\)")


def test_arrays_that_fit_are_read(tmp_path):
    path = tmp_path / "a.npy"
    for array in (np.arange(8.0), np.zeros((0, 4), np.uint8), np.float32(3.0), np.asfortranarray(np.eye(3))):
        np.save(path, array)
        np.testing.assert_array_equal(load_npy(path), array)
    np.savez(tmp_path / "b.npz", a=np.arange(3), b=np.array(["x", "yz"]))
    assert {name: array.tolist() for name, array in npz_arrays(tmp_path / "b.npz").items()} == {
        "a": [0, 1, 2],
        "b": ["x", "yz"],
    }
    assert list(npz_arrays(tmp_path / "b.npz", ["b", "c"])) == ["b"]


def test_objects_of_python_are_not_read(tmp_path):
    np.save(tmp_path / "a.npy", np.array([{}, None]), allow_pickle=True)
    with pytest.raises(DataError, match=r"a\.npy: the file is damaged \(it holds objects of Python"):
        load_npy(tmp_path / "a.npy")
    np.savez(tmp_path / VOXELS, labels=np.array([{}, None]), allow_pickle=True)
    with pytest.raises(UserError, match="it holds objects of Python"):
        read_labels(tmp_path, Cuboid((2, 2, 2)))


def test_a_small_file_of_large_arrays(tmp_path):
    shape = (1024, 1024, 1025)
    path = npz_of_zeros(tmp_path / VOXELS, "labels", shape)
    assert path.stat().st_size < 2**23
    said = rf"its arrays unpack to [\d,]+ bytes, at most {LIMIT_BYTES:,} are read"
    for read in (
        lambda: read_labels(tmp_path, Cuboid((2, 2, 2))),
        lambda: read_voxels(path),
        lambda: read_npz(path, {"labels": shape}),
        lambda: clouds.read_npz(path),
    ):
        with pytest.raises((DataError, UserError), match=said) as error:
            read()
        assert str(path) in str(error.value)


PCD = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 {times}\nPOINTS {count}\nDATA {encoding}\n"
PROPERTIES = "property float x\nproperty float y\nproperty float z\n"
PLY = "ply\nformat {encoding} 1.0\nelement vertex {count}\n" + PROPERTIES + "end_header\n"
MANY = ("1" + 12 * "0", "1" + 19 * "0", "1" + 4500 * "0", "\u0663\u00b2")
"""Numbers of points: more than the file holds, more than fit a machine's integer, more than Python reads as one."""


@pytest.mark.parametrize("encoding", ["ascii", "binary", "binary_compressed"])
def test_a_pcd_file_of_too_many_points(encoding, tmp_path):
    path = tmp_path / "a.pcd"
    body = np.array([12, 2**32 - 1], "<u4").tobytes() + b"1 2 3\n4 5 6\n"
    for facts in [facts for many in MANY for facts in ({"times": 1, "count": many}, {"times": many, "count": 2})]:
        path.write_bytes(PCD.format(**facts, encoding=encoding).encode() + body)
        with pytest.raises(DataError, match=rf"^{path}: ") as error:
            clouds.read_pcd(path)
        assert len(str(error.value)) < 400
        assert "\n" not in str(error.value)


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian"])
def test_a_ply_file_of_too_many_points(encoding, tmp_path):
    path = tmp_path / "a.ply"
    for count in MANY:
        path.write_bytes(PLY.format(count=count, encoding=encoding).encode() + b"1 2 3\n4 5 6\n")
        with pytest.raises(DataError, match=rf"^{path}: ") as error:
            clouds.read_ply(path)
        assert len(str(error.value)) < 400
    path.write_bytes(f"ply\nformat {encoding} 1.0\nelement vertex 2\nend_header\n1 2 3\n".encode())
    with pytest.raises(DataError, match="its vertices have no properties"):
        clouds.read_ply(path)


def test_compressed_points_that_shrank_by_more_than_they_can(tmp_path):
    path, count = tmp_path / "a.pcd", 357_913_941
    header = PCD.format(times=1, count=count, encoding="binary_compressed").encode()
    path.write_bytes(header + np.array([12, 12 * count], "<u4").tobytes() + bytes(12))
    with pytest.raises(DataError, match=rf"12 compressed bytes state {12 * count:,} bytes; .*more than 88"):
        clouds.read_pcd(path)


def test_what_is_no_file_is_not_opened(tmp_path):
    os.mkfifo(tmp_path / "a")
    for read in (read_bytes, clouds.read_bin, clouds.read_pcd, clouds.read_ply, clouds.read_npz, load_npy, npz_arrays):
        with pytest.raises(DataError, match=rf"^{tmp_path}/a cannot be read: it is a pipe, not a file"):
            read(tmp_path / "a")
    with pytest.raises(UserError, match="it is a pipe, not a file"):
        read_voxels(tmp_path / "a")
    with (tmp_path / "hole").open("wb") as file:
        file.truncate(2**42)
    with pytest.raises(DataError, match=rf"^{tmp_path}/hole: the file has {2**42:,} bytes, more than can be read"):
        read_bytes(tmp_path / "hole")


def test_weights_and_checkpoints_that_claim_more_than_they_hold(tmp_path):
    header = b'{"a":{"dtype":"F32","shape":[1000000,1000000],"data_offsets":[0,4000000000000]}}'
    path = tmp_path / "a.safetensors"
    for length in (len(header), 2**40):
        path.write_bytes(length.to_bytes(8, "little") + header + bytes(64))
        with pytest.raises(UserError, match=r"a\.safetensors is damaged or not a file of weights"):
            read_weights(path)
    torch.save({"config": {}, "state_dict": {"a": torch.zeros(2**22)}}, tmp_path / "plain.ckpt")
    assert read_checkpoint(tmp_path / "plain.ckpt")["config"] == {}
    with (
        zipfile.ZipFile(tmp_path / "plain.ckpt") as plain,
        zipfile.ZipFile(tmp_path / "a.ckpt", "w", zipfile.ZIP_DEFLATED) as packed,
    ):
        for member in plain.infolist():
            packed.writestr(member.filename, plain.read(member))
    assert (tmp_path / "a.ckpt").stat().st_size < 2**16
    with pytest.raises(UserError, match=r"a\.ckpt is not a checkpoint .*it has [\d,]+ bytes, but its parts state 16,"):
        read_checkpoint(tmp_path / "a.ckpt")


def test_many_properties_take_no_time(tmp_path):
    names = "".join(f"property float p{number}\n" for number in [*range(40_000), 39_999])
    (tmp_path / "a.ply").write_text(f"ply\nformat ascii 1.0\nelement vertex 0\n{names}end_header\n")
    begun = time.monotonic()
    with pytest.raises(DataError, match="the property 'p39999' stands twice"):
        clouds.read_ply(tmp_path / "a.ply")
    assert time.monotonic() - begun < 5
