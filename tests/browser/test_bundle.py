"""The replay's HTML file: nothing foreign in it, and text stays text."""

import base64
import hashlib
import json
import re
from html.parser import HTMLParser

import pytest
from recordings import record

from marl_lanes import load_scenario
from marl_lanes.browser.bundle import (
    FILE_ENTRY,
    PREFIX,
    make_page,
    make_replay,
    make_style,
    needed_modules,
    read_modules,
    write_replay,
)
from marl_lanes.colours import DARK, LIGHT, TRAFFIC
from marl_lanes.trajectory.file import Trajectory
from marl_lanes.trajectory.metadata import Metadata, TrajectoryError

JSON = "application/json"
HOSTILE = "</script><script>window.owned = 1</script><img src=x onerror='window.owned = 2'>"


class Elements(HTMLParser):
    """The elements of a page with their attributes, and the content of scripts and styles."""

    def __init__(self, text):
        super().__init__()
        self.found, self.open = [], None
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.open = [tag, dict(attributes), ""]
        self.found.append(self.open)

    def handle_endtag(self, _tag):
        self.open = None

    def handle_data(self, text):
        if self.open is not None:
            self.open[2] += text

    def of(self, tag):
        return [(attributes, text) for name, attributes, text in self.found if name == tag]


@pytest.fixture(scope="module")
def trajectory():
    return record("paper", 60, num_envs=2)


def renamed(trajectory, name):
    fields = trajectory.scenario.model_dump(mode="json") | {"name": name, "description": name}
    return Trajectory(Metadata(load_scenario(fields), 0, name), trajectory.rows)


def scripts(text):
    return {attributes.get("id"): content for attributes, content in Elements(text).of("script")}


def test_no_element_refers_to_anything_outside(trajectory):
    text = make_replay(trajectory, 0, None)
    allowed = {"canvas", "svg", "path"}
    for tag, attributes, _ in Elements(text).found:
        assert tag not in {"link", "iframe", "object", "embed", "img", "base"}
        for name in ("src", "href", "action", "data", "srcset"):
            assert name not in attributes or tag in allowed, (tag, attributes)
    # What is encoded may hold any letters.
    plain = re.sub(r"[A-Za-z0-9+/=]{80,}", "", text)
    assert "http" not in plain.replace("http-equiv", "")
    assert not any("http" in source for source in read_modules().values())
    style = make_style()
    assert "url(" not in style
    assert "@import" not in style


def test_the_policy_allows_the_own_scripts_and_style_alone(trajectory):
    elements = Elements(make_replay(trajectory, 0, None))
    (policy,) = (
        attributes["content"]
        for attributes, _ in elements.of("meta")
        if attributes.get("http-equiv") == "Content-Security-Policy"
    )
    rules = dict(rule.split(" ", 1) for rule in policy.split("; "))
    assert rules["default-src"] == "'none'"
    assert rules["connect-src"] == "'none'"
    assert "unsafe" not in policy
    run = [text for attributes, text in elements.of("script") if attributes["type"] != JSON]
    assert len(run) == 2
    ((_, style),) = elements.of("style")
    for content, rule in [*((text, "script-src") for text in run), (style, "style-src")]:
        digest = base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
        assert f"'sha256-{digest}'" in rules[rule]


def test_text_of_the_trajectory_is_no_markup(trajectory):
    plain = Elements(make_replay(trajectory, 0, None))
    hostile = Elements(make_replay(renamed(trajectory, HOSTILE), 0, {0: {"reason": HOSTILE}}))
    assert [tag for tag, *_ in hostile.found] == [tag for tag, *_ in plain.found]
    held = {attributes.get("id"): text for attributes, text in hostile.of("script")}
    header = json.loads(held["header"])
    assert header["scenario"] == header["policy"] == header["description"] == HOSTILE
    assert json.loads(held["optima"])["0"]["reason"] == HOSTILE
    ((_, title),) = hostile.of("title")
    assert title == f"{HOSTILE}: replay"


def test_every_module_is_in_the_import_map(trajectory):
    elements = Elements(make_replay(trajectory, 0, None))
    (imports,) = (text for tag, text in elements.of("script") if tag["type"] == "importmap")
    held = {
        name.removeprefix(PREFIX): base64.b64decode(address.partition(",")[2]).decode()
        for name, address in json.loads(imports)["imports"].items()
    }
    assert sorted(held) == needed_modules(FILE_ENTRY)
    modules = read_modules()
    for name, source in held.items():
        assert source == modules[name]
        wanted = set(re.findall(r'from "([^"]+)"', source))
        assert {one.removeprefix(PREFIX) for one in wanted} <= set(held), name
    (start,) = (text for tag, text in elements.of("script") if tag["type"] == "module")
    assert start == f'import "{PREFIX}{FILE_ENTRY}";'


def test_no_module_makes_markup_of_text():
    for name, source in read_modules().items():
        for way in ("innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval("):
            assert way not in source, name
        assert len(source.splitlines()) <= 300, name


def test_the_colours_are_those_of_all_pictures():
    style = make_style()
    for theme in (LIGHT, DARK):
        assert f"--background:{theme.background};" in style
        assert f"--series-0:{theme.series[0]};" in style
    assert f"--changer:{TRAFFIC.changer};" in style
    assert f"--brake-light:{TRAFFIC.brake_light};" in style
    used = set(re.findall(r"var\(--([\w-]+)\)", style))
    assert used - set(re.findall(r"--([\w-]+):", style)) == set()


def test_the_road_is_chosen(trajectory):
    for road in (0, 1):
        held = scripts(make_replay(trajectory, road, None))
        assert json.loads(held["header"])["road"] == road
        (chunk,) = json.loads(held["chunks"])
        assert chunk["num_rows"] == trajectory.rows_of(road).size
    with pytest.raises(TrajectoryError, match=r"road = 2: must be one of \[0, 1\]"):
        make_replay(trajectory, 2, None)


def test_the_same_trajectory_gives_the_same_bytes(trajectory, tmp_path):
    size = write_replay(tmp_path / "deep" / "a.html", trajectory, 0, None)
    write_replay(tmp_path / "b.html", trajectory, 0, None)
    written = (tmp_path / "b.html").read_bytes()
    assert (tmp_path / "deep" / "a.html").read_bytes() == written
    assert size == len(written)


def test_a_served_page_may_connect_to_its_server_alone():
    text = make_page(
        title="<b>",
        entry="main",
        addresses={"main": "/page/main.js"},
        data={"header": {"a": "<"}},
        sources=["'self'"],
    )
    assert "connect-src &#x27;self&#x27;" in text
    assert "script-src &#x27;self&#x27; &#x27;sha256-" in text
    assert "data:" not in text
    assert "<title>&lt;b&gt;</title>" in text
    assert '{"replay/main":"/page/main.js"}' in text
    assert scripts(text)["header"] == '{"a":"\\u003c"}'
