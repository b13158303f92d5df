"""The public API is that of ``public_api.txt``: no name goes, no signature changes unnoticed."""

import difflib

from public_api import FILE, describe


def test_the_public_api_is_as_it_is_written():
    written, found = (text.splitlines() for text in (FILE.read_text("utf-8"), describe()))
    changes = list(difflib.unified_diff(written, found, "tests/public_api.txt", "now", lineterm=""))
    hint = "if it is meant: python tests/public_api.py, and an entry in CHANGELOG.md"
    assert changes == [], "\n".join([*changes, hint])
