import struct

import pytest

from omniocc.errors import UserError
from omniocc.run.wandb.wandb_file import files_of, raw_records

HEADER = b":W&B\xe1\xbe\x00"


def part(content: bytes, kind: int) -> bytes:
    return struct.pack("<IHB", 0, len(content), kind) + content


def test_records_are_put_together_over_blocks_and_a_torn_one_is_left_out(tmp_path):
    path = tmp_path / "run.wandb"
    whole, long = b"a" * 32700, b"b" * 100
    first = HEADER + part(whole, 1)
    # 54 bytes of the first block are left: 47 of the second record go there, 53 into the next block
    assert 32768 - len(first) == 54
    split = part(long[:47], 2) + part(long[47:], 4)
    path.write_bytes(first + split + part(b"torn", 1)[:-2])
    assert list(raw_records(path)) == [whole, long]


def test_a_block_without_room_for_a_head_ends_in_zeros(tmp_path):
    path = tmp_path / "run.wandb"
    first = HEADER + part(b"a" * (32768 - 7 - 7 - 5), 1)
    path.write_bytes(first + bytes(5) + part(b"next", 1))
    assert [len(record) for record in raw_records(path)] == [32749, 4]


def test_another_file_is_refused_and_an_empty_one_has_no_records(tmp_path):
    path = tmp_path / "run.wandb"
    path.write_bytes(b"")
    assert list(raw_records(path)) == []
    path.write_bytes(b"PK\x03\x04 and more")
    with pytest.raises(UserError, match=r"run\.wandb.*W&B"):
        list(raw_records(path))


def test_files_are_in_the_order_in_which_the_run_was_started(tmp_path):
    names = ["run-20260102_000000-x", "offline-run-20260101_000000-x", "offline-run-20260103_000000-x"]
    for name in names:
        (tmp_path / "wandb" / name).mkdir(parents=True)
        (tmp_path / "wandb" / name / "run-x.wandb").touch()
    assert [path.parent.name for path in files_of(tmp_path)] == [names[1], names[0], names[2]]
