"""The style: every series has a look of its own, text upon heat maps is readable, the formats."""

import itertools

import pytest
from matplotlib import rcParams
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from marl_lanes.colours import LIGHT
from marl_lanes.evaluation.style import HEAT, STYLE, styled, write_figure


def test_series_differ_without_their_colour():
    looks = list(itertools.islice(STYLE["axes.prop_cycle"], 20))
    assert len({(look["color"], look["linestyle"]) for look in looks}) == 20
    assert len({look["linestyle"] for look in looks[:4]}) == 4
    assert len({look["color"] for look in looks[:5]}) == 5
    assert {look["color"] for look in looks} < set(LIGHT.series)


def luminance(colour):
    linear = [one / 12.92 if one <= 0.04045 else ((one + 0.055) / 1.055) ** 2.4 for one in colour]
    return sum(share * one for share, one in zip((0.2126, 0.7152, 0.0722), linear, strict=True))


@pytest.mark.parametrize("value", [0.0, 0.5, 1.0])
def test_text_can_be_read_on_every_colour_of_a_heat_map(value):
    place, text = luminance(HEAT(value)[:3]), luminance(to_rgb(LIGHT.text))
    assert (place + 0.05) / (text + 0.05) >= 4.5


def test_the_style_is_not_left_behind():
    @styled
    def look():
        return rcParams["svg.fonttype"], rcParams["svg.hashsalt"]

    before = rcParams["svg.fonttype"], rcParams["svg.hashsalt"]
    assert look() == look() == ("none", "marl-lanes")
    assert (rcParams["svg.fonttype"], rcParams["svg.hashsalt"]) == before


@styled
def write(path):
    figure = Figure()
    figure.subplots().plot([1.0, 2.0], label="a")
    write_figure(figure, path)


@pytest.mark.parametrize("kind", ["svg", "png", "pdf", "PNG"])
def test_a_file_names_no_time(tmp_path, monkeypatch, kind):
    path = tmp_path / f"one.{kind}"
    found = []
    for seconds in ("0", "1000000000"):
        monkeypatch.setenv("SOURCE_DATE_EPOCH", seconds)
        write(path)
        found.append(path.read_bytes())
    assert found[0] == found[1]
    starts = {"svg": b"<?xml", "png": b"\x89PNG", "pdf": b"%PDF"}
    assert found[0].startswith(starts[kind.lower()])


def test_text_is_text(tmp_path):
    write(tmp_path / "one.svg")
    text = (tmp_path / "one.svg").read_text(encoding="utf-8")
    assert "<text" in text
    assert "DejaVu Sans" in text
    assert "<dc:date>" not in text
