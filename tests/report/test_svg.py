"""A figure on a page: in the page's colours, its ids apart, nothing that runs or loads."""

import re

import pytest
from report.runs import SVG

from marl_lanes.colours import DARK, LIGHT
from marl_lanes.report.run_files import ReportError
from marl_lanes.report.svg import VARIABLES, inline_svg


def inline(tmp_path, text, prefix="loss"):
    path = tmp_path / "figures" / "loss.svg"
    path.parent.mkdir(exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return inline_svg(path, prefix, 'a "b" <c>')


def test_a_figure_is_one_element_in_the_pages_colours(tmp_path):
    found = inline(tmp_path, SVG)
    assert found.startswith("<svg ")
    assert 'viewBox="0 0 460 280"' in found
    assert "460pt" not in found
    assert 'aria-label="a &quot;b&quot; &lt;c&gt;"' in found
    assert "return R [1]" in found
    assert "stroke: var(--series-0)" in found
    assert "fill: var(--text)" in found
    assert re.search(r"#[0-9a-f]{6}", found) is None
    assert {'id="loss-p1"', 'clip-path="url(#loss-p1)"', 'href="#loss-line_1"'} <= set(
        re.findall(r'[\w-]+="[^"]*"', found)
    )
    assert "http" not in found


def test_every_colour_of_the_style_has_a_variable_in_both_themes():
    assert set(VARIABLES.values()) == {LIGHT.background, LIGHT.text, LIGHT.grid, *LIGHT.series}
    assert len(VARIABLES) == len(set(VARIABLES.values()))
    assert len(DARK.series) == len(LIGHT.series)


@pytest.mark.parametrize(
    "part",
    [
        "<script>alert(1)</script>",
        '<g onload="alert(1)"/>',
        '<image xlink:href="https://example.org/a.png"/>',
        '<image xlink:href="data:image/svg+xml;base64,AAAA"/>',
        '<use xlink:href="other.svg#a"/>',
        '<a xlink:href="javascript:alert(1)"><text>a</text></a>',
        "<style>@import url(https://example.org/a.css)</style>",
        '<rect style="fill: url(https://example.org/a#b)"/>',
        '<rect style="fill: u\\72l(https://example.org/a#b)"/>',
        '<rect style="fill: URL(https://example.org/a#b)"/>',
        '<rect fill="Url(https://example.org/a#b)"/>',
        '<g style="fill: none; position: fixed; inset: 0"/>',
        '<foreignObject><iframe src="https://example.org"/></foreignObject>',
        '<rect filter="url(https://example.org/a#b)"/>',
    ],
)
def test_nothing_that_runs_or_loads_is_let_through(tmp_path, part):
    found = inline(tmp_path, SVG.replace("</svg>", f"{part}</svg>"))
    for word in (
        "script",
        "alert",
        "onload",
        "example",
        "svg+xml",
        "other",
        "foreign",
        "import",
        "fixed",
    ):
        assert word not in found
    assert "return R [1]" in found


def test_an_image_of_points_stays(tmp_path):
    image = '<image xlink:href="data:image/png;base64,AA+/&#10;A=" width="3" height="4"/>'
    assert "data:image/png;base64,AA+/" in inline(tmp_path, SVG.replace("</svg>", f"{image}</svg>"))


@pytest.mark.parametrize("text", ["", "<svg", "<html></html>"])
def test_what_is_no_svg(tmp_path, text):
    with pytest.raises(ReportError, match=r"loss\.svg: cannot be read as SVG"):
        inline(tmp_path, text)


def test_a_figure_that_is_missing(tmp_path):
    with pytest.raises(ReportError, match=r"a\.svg: is missing; resume="):
        inline_svg(tmp_path / "figures" / "a.svg", "a", "a")
