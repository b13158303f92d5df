import sys

import pytest

from marl_lanes.extras import MissingExtraError, need


def test_what_is_installed_is_imported():
    import json

    assert need("json", "view") is json


def test_a_missing_package_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(MissingExtraError, match=r"pygame: .* pip install 'marl-lanes\[view\]'"):
        need("pygame", "view")


def test_a_package_that_lacks_another_is_no_missing_extra(tmp_path, monkeypatch):
    (tmp_path / "broken_one.py").write_text("import not_there_at_all\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ModuleNotFoundError, match="not_there_at_all") as caught:
        need("broken_one", "view")
    assert not isinstance(caught.value, MissingExtraError)
