import pytest

from omniocc.errors import ANY_FOLDER, DataError, first_line, moved_by


def test_the_innermost_key_that_moves_a_folder_is_named():
    named = pytest.raises(DataError, match=r"^cannot write a: choose another one \(data.source.cache=\.\.\.\)$")
    with named, moved_by("paths.data"), moved_by("data.source.cache"):
        raise DataError(f"cannot write a: choose another one ({ANY_FOLDER})")
    with pytest.raises(DataError, match=r"^a is damaged$"), moved_by("paths.data"):
        raise DataError("a is damaged")


def test_the_first_line_of_an_error_is_never_empty():
    assert first_line(ValueError("\nwrong size\nof image")) == "wrong size"
    assert first_line(AssertionError()) == "AssertionError"
