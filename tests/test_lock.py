import errno
import fcntl
import os
from pathlib import Path

import pytest

from omniocc import lock as module
from omniocc.errors import DataError
from omniocc.lock import Held, acquire, locked

NOT_RUNNING = 2**22 - 3  # Linux gives no higher number than 2**22


def refuse_locks(monkeypatch, number: int) -> None:
    def flock(*_):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(fcntl, "flock", flock)


def test_one_process_at_a_time_holds_a_lock(tmp_path):
    path = tmp_path / "run" / ".lock"
    with locked(path), pytest.raises(Held) as held:
        acquire(path)
    assert held.value.remedy == "", "the system releases it when the other process ends"
    acquire(path).release()


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.EROFS, errno.ENOSPC])
@pytest.mark.parametrize("wait", [True, False])
def test_a_folder_that_cannot_be_locked_is_a_line(tmp_path, monkeypatch, number, wait):
    (path := tmp_path / ".lock").touch()
    refuse_locks(monkeypatch, number)
    with pytest.raises(DataError, match=rf"^cannot write {path}: .*: (choose|free) .*same command again") as raised:
        acquire(path, wait)
    assert "\n" not in str(raised.value)


@pytest.mark.filterwarnings("ignore:flock not supported")
class TestWithoutFlock:
    @pytest.fixture(autouse=True)
    def no_flock(self, monkeypatch):
        refuse_locks(monkeypatch, errno.ENOSYS)
        monkeypatch.setattr(module, "BEGUN_S", 0.2)

    def test_the_file_itself_is_the_lock(self, tmp_path):
        path = tmp_path / ".lock"
        with (
            locked(path),
            pytest.raises(Held, match=f"; if process {os.getpid()} does not run any more, remove {path}"),
        ):
            acquire(path)
        assert not path.exists()

    @pytest.mark.parametrize("wait", [True, False])
    def test_a_file_that_names_no_process_is_a_line(self, tmp_path, wait):
        (path := tmp_path / ".lock").touch()  # a lock by `flock` leaves it so
        with pytest.raises(DataError, match=rf"^{path} locks this folder.*: remove the file if no other process"):
            acquire(path, wait)

    def test_a_process_that_has_ended_is_not_waited_for(self, tmp_path):
        (path := tmp_path / ".lock").write_text(f"{NOT_RUNNING}\n{os.uname().nodename}\n")
        acquire(path, wait=True).release()

    def test_waiting_for_a_process_of_another_machine_is_told(self, tmp_path, monkeypatch, capsys):
        (path := tmp_path / ".lock").write_text("99\nelsewhere\n")
        monkeypatch.setattr(module, "print", lambda text, **_: (print(text), Path(path).unlink()), raising=False)
        acquire(path, wait=True).release()
        line = f"waits for another process that holds {path}; if process 99 does not run any more, remove {path}\n"
        assert capsys.readouterr().out == line
