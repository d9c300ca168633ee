from omniocc.errors import first_line


def test_the_first_line_of_an_error_is_never_empty():
    assert first_line(ValueError("\nwrong size\nof image")) == "wrong size"
    assert first_line(AssertionError()) == "AssertionError"
