from types import SimpleNamespace

import psutil
import pytest

from marl_lanes.memory import check_memory


@pytest.fixture(autouse=True)
def small(monkeypatch):
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=3 * 2**30))


def test_what_does_not_fit_is_refused_with_what_would():
    with pytest.raises(ValueError, match=r"^num_envs = 1000: needs about 6 GiB of memory, 3 GiB"):
        check_memory("num_envs", 1000, 6 * 2**30)
    with pytest.raises(ValueError, match=r"must be at most 500 here$"):
        check_memory("num_envs", 1000, 6 * 2**30)


def test_what_fits_passes():
    check_memory("num_envs", 1000, 3 * 2**30)
