from omniocc.data.spacing import evenly_spaced


def test_both_ends_are_included():
    assert evenly_spaced(10, 3) == [0, 4, 9]
    assert evenly_spaced(2, 6) == [0, 1]
    assert evenly_spaced(5, 1) == [0]
