"""Tables of results in Markdown documents."""

import pytest

from marl_lanes.report.documents import check_document, format_table, insert_tables

TEXT = """# Title
<!-- one -->
old
<!-- end of one -->
between
<!-- two -->
<!-- end of two -->
"""


@pytest.fixture
def document(tmp_path):
    path = tmp_path / "page.md"
    path.write_text(TEXT, encoding="utf-8")
    return path


def test_cells_of_every_kind():
    rows = [{"a": "x", "b": 0.123456, "c": 12345}, {"a": None, "b": 12345.6, "c": 2}]
    wanted = "| a | b | c |\n| --- | --- | --- |\n| x | 0.1235 | 12,345 |\n| - | 12,346 | 2 |\n"
    assert format_table(rows) == wanted


def test_a_table_takes_the_place_of_the_one_before(document):
    for table in (r"| \1 |" + "\n", "| second |\n"):
        insert_tables(document, {"one": table, "two": "| other |\n"})
        text = document.read_text(encoding="utf-8")
        assert f"<!-- one -->\n\n{table}\n<!-- end of one -->\nbetween" in text
        assert text.count("| other |") == 1
        assert "old" not in text


def test_a_document_without_the_place_is_refused_and_stays(document):
    with pytest.raises(ValueError, match=r"page\.md'?: must have the lines <!-- three -->"):
        check_document(document, ["one", "three"])
    with pytest.raises(ValueError, match="<!-- three -->"):
        insert_tables(document, {"one": "new", "three": "new"})
    assert document.read_text(encoding="utf-8") == TEXT
