"""Numbers as they are typed."""

from argparse import ArgumentTypeError

import pytest

from marl_lanes.cli.values import MAX_SEED, file_name, number, whole_number


@pytest.mark.parametrize(("text", "value"), [("0", 0), ("+7", 7), ("007", 7), ("1_000", 1000)])
def test_a_whole_number(text, value):
    assert whole_number()(text) == value


def test_limits_are_allowed():
    parse = whole_number(3, MAX_SEED)
    assert (parse("3"), parse(str(MAX_SEED))) == (3, MAX_SEED)
    for text in ("2", str(MAX_SEED + 1)):
        with pytest.raises(ArgumentTypeError, match=f"^'{text}': must be a whole number, 3 to 184"):
            parse(text)
    parse = number(0.5, 2.0, unit=" s")
    assert (parse("0.5"), parse("2"), parse("1e0")) == (0.5, 2.0, 1.0)
    for text in ("0.49", "2.1", "nan", "inf"):
        with pytest.raises(ArgumentTypeError, match=f"^'{text}': must be a number, 0.5 to 2 s$"):
            parse(text)


@pytest.mark.parametrize("text", ["", " ", "\t", "a\0b"])
def test_the_name_of_a_file(text):
    with pytest.raises(ArgumentTypeError, match="must be the name of a file"):
        file_name(text)
