"""The page: its numbers are those of the files, its links lead somewhere, foreign text is text."""

import base64
import json
import os
import re
from html.parser import HTMLParser

import pytest
from report.runs import ROWS, add_replays, make_run, row

from marl_lanes.colours import DARK, LIGHT
from marl_lanes.evaluation.headlines import HEADLINES
from marl_lanes.extras import MissingExtraError
from marl_lanes.report import page
from marl_lanes.report.page import make_numbers, write_report
from marl_lanes.report.run_files import Evaluation, Interval, ReportError

VOID = {"meta", "link", "br", "img", "input", "hr"}


class Page(HTMLParser):
    """The elements of a page: name, attributes, text; every one is closed in its order."""

    def __init__(self, path):
        super().__init__()
        self.elements, self.open = [], []
        self.feed(path.read_text(encoding="utf-8"))
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        element = {"tag": tag, "text": "", **dict(attrs)}
        self.elements.append(element)
        if tag not in VOID:
            self.open.append(element)

    def handle_endtag(self, tag):
        assert self.open.pop()["tag"] == tag

    def handle_data(self, data):
        for element in self.open:
            element["text"] += data

    def all(self, tag, **attributes):
        return [
            element
            for element in self.elements
            if element["tag"] == tag
            and all(element.get(name) == value for name, value in attributes.items())
        ]

    def texts(self, tag, **attributes):
        return [" ".join(element["text"].split()) for element in self.all(tag, **attributes)]


def report(tmp_path, *, film=None, replays=(), **options):
    run = make_run(tmp_path / "run", **options)
    if film is not None:
        (run / "film.mp4").write_bytes(film)
    if replays:
        add_replays(run, *replays)
    assert write_report(run) == run / "report.html"
    return Page(run / "report.html")


@pytest.mark.parametrize(
    ("num_maneuvers", "value"), [(40, "97.5 %"), (1000, "99.9 %"), (10_000, "99.99 %")]
)
def test_one_failure_does_not_look_like_none(num_maneuvers, value):
    rate = Interval(value=1.0 - 1.0 / num_maneuvers, low=0.9, high=1.0)
    numbers = make_numbers(
        Evaluation(
            scenario="paper",
            policy="checkpoints/final.pt",
            seed=0,
            num_maneuvers=num_maneuvers,
            no_cost_ratio=None,
            confidence=0.95,
            intervals={headline.key: rate for headline in HEADLINES},
            versions={},
        )
    )
    assert numbers[0].key == "success_rate"
    assert numbers[0].value.replace("\N{NO-BREAK SPACE}", " ") == value


def test_every_number_is_that_of_the_file(tmp_path):
    found = report(tmp_path)
    stored = json.loads((tmp_path / "run" / "evaluation.json").read_text(encoding="utf-8"))
    for headline in HEADLINES:
        (card,) = found.all("li", id=headline.key)
        title, value, interval, meaning = [line for line in card["text"].split("\n") if line]
        numbers = stored["intervals"][headline.key]
        factor = 100.0 if headline.unit == "%" else 1.0
        wanted = [f"{factor * numbers[end]:.{headline.decimals}f}" for end in numbers]
        assert re.findall(r"\d+\.\d+", value) == wanted[:1], title
        assert re.findall(r"\d+\.\d+", interval) == wanted[1:], title
        assert value.endswith(headline.unit) == (headline.unit != "1")
        assert meaning == headline.meaning
    text = " ".join(found.all("body")[0]["text"].split())
    assert "2 of 4 lane changes succeeded: 50.0 %, 95 % interval 43.8 to 56.2 %." in text
    assert "on 2 roads of seed 1000000" in text
    assert "numpy2.4.6" in text.replace(" ", "")
    assert "training1,156.25" in text
    assert found.texts("pre")[-1] == "scenario: paper seed: 0"
    assert "python train.py seed=0" in found.texts("pre")


def test_a_number_that_another_version_did_not_write_is_left_out(tmp_path):
    rate = {"value": 0.5, "low": 0.25, "high": 0.75}
    intervals = {one.key: rate for one in HEADLINES if one.key != "timed_out_rate"}
    found = report(tmp_path, intervals=intervals)
    assert found.all("li", id="missed_rate")
    assert not found.all("li", id="timed_out_rate")


def test_a_number_that_is_not_defined(tmp_path):
    nothing = {"value": None, "low": None, "high": None}
    one_road = {"value": 0.5, "low": None, "high": None}
    intervals = {headline.key: one_road for headline in HEADLINES} | {"cost_ratio": nothing}
    found = report(tmp_path, intervals=intervals, no_cost_ratio="no maneuver was completed")
    (card,) = found.all("li", id="cost_ratio")
    assert "not defined" in card["text"]
    assert card["text"].strip().endswith("Here there is none: no maneuver was completed.")
    assert " to " not in found.all("li", id="missed_rate")[0]["text"].partition("Share")[0]


def test_the_table_of_failed_maneuvers(tmp_path):
    found = report(tmp_path, replays=[1])
    rows = [text.split("\n") for text in (one["text"] for one in found.all("tr"))]
    cells = found.texts("td")
    wanted = [one for one in ROWS if one["failure"]]
    for maneuver in wanted:
        start = cells.index(maneuver["failure"])
        assert cells[start : start + 10] == [
            maneuver["failure"],
            "watch" if maneuver["road"] == 1 else "\N{EN DASH}",
            maneuver["outcome"],
            *(str(maneuver[name]) for name in ("road", "command", "vehicle")),
            *("10.5", "21.2", "23.5"),
            str(maneuver["num_aborts"]),
        ]
    assert len(rows) == 1 + 2 + 2 + 2
    assert [one["href"] for one in found.all("a") if one["text"] == "watch"] == [
        "replays/road_0001.html#command=0"
    ]
    assert "2 of 4: 1 failed after completion, 1 missed." in " ".join(found.texts("p"))
    # The command is for a failed maneuver that has no replay yet.
    assert any("--road 0 " in text for text in found.texts("pre"))


def test_a_run_without_failures(tmp_path):
    found = report(tmp_path, rows=[row(road, 0) for road in range(20)])
    assert "None: all 20 lane changes succeeded." in found.texts("p")
    assert found.all("section", **{"aria-label": "Warnings"}) == []
    assert "No road has a replay in the run folder." in found.texts("p")


def test_warnings_come_first(tmp_path):
    found = report(tmp_path, rows=[row(0, 0), row(1, 0, "missed", "late"), *ROWS[1:3]])
    (section,) = found.all("section", **{"aria-label": "Warnings"})
    assert "Most lane changes fail: 3 of 4." in section["text"]
    assert found.all("section")[0] is section


@pytest.mark.parametrize("replays", [(), (0, 1)])
@pytest.mark.parametrize("film", [None, b"film"])
def test_every_link_leads_to_a_file_and_nothing_is_loaded(tmp_path, film, replays):
    found = report(tmp_path, film=film, replays=replays)
    run = tmp_path / "run"
    links = [element["href"] for element in found.all("a")]
    assert len(links) == 8 + (film is not None) + 2 * len(replays)
    for link in links:
        assert (run / link.partition("#")[0]).is_file(), link
    text = (run / "report.html").read_text(encoding="utf-8")
    assert re.search(r"https?:|//[a-z]", text) is None
    assert found.all("script") + found.all("link") + found.all("iframe") == []
    sources = [element["src"] for element in found.elements if "src" in element]
    assert all(source.startswith("data:") for source in sources)
    (policy,) = found.all("meta", **{"http-equiv": "Content-Security-Policy"})
    assert policy["content"].startswith("default-src 'none'")


def test_a_film_is_contained_if_it_is_small(tmp_path, monkeypatch):
    (video,) = report(tmp_path / "a", film=b"a film").all("video")
    assert base64.b64decode(video["src"].removeprefix("data:video/mp4;base64,")) == b"a film"
    monkeypatch.setattr(page, "MAX_FILM_BYTES", 5)
    large = report(tmp_path / "b", film=b"a film")
    assert large.all("video") == []
    assert [one["href"] for one in large.all("a") if "film" in one["href"]] == ["film.mp4"]


HOSTILE = "<script>alert(1)</script><img src=x onerror=alert(2)>\"'&"


def test_foreign_text_is_text(tmp_path):
    run = make_run(
        tmp_path / (HOSTILE.replace("/", "") if os.name == "posix" else "&'"),
        rows=[row(0, 0, HOSTILE, HOSTILE)],
        choice=HOSTILE,
        scenario=HOSTILE,
        policy=HOSTILE,
        no_cost_ratio=HOSTILE,
        versions={HOSTILE: HOSTILE},
    )
    (run / "config.yaml").write_text(f"scenario: |-\n  {HOSTILE}\n", encoding="utf-8")
    (run / "command.txt").write_text(HOSTILE, encoding="utf-8")
    (run / "training.json").write_text(json.dumps({HOSTILE: 1.0}), encoding="utf-8")
    found = Page(write_report(run))
    assert found.all("script") + found.all("img") == []
    assert [one for one in found.elements if any(name.startswith("on") for name in one)] == []
    text = found.all("body")[0]["text"]
    assert text.count(HOSTILE) >= 9
    assert found.texts("title") == [f"{HOSTILE}: report of a training"]


def test_the_figures_are_part_of_the_page(tmp_path):
    found = report(tmp_path)
    assert [one["aria-label"] for one in found.all("svg")] == list(page.FIGURES.values())
    ids = [one["id"] for one in found.elements if "id" in one]
    assert len(ids) == len(set(ids))
    targets = {one["aria-labelledby"] for one in found.elements if "aria-labelledby" in one}
    assert targets <= set(ids)


def test_the_page_is_light_or_dark_as_the_reader_wishes(tmp_path):
    report(tmp_path)
    text = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    light, dark = text.split("@media (prefers-color-scheme: dark)")
    used = set(re.findall(r"var\(--([\w-]+)\)", text))
    assert {"series-0", "text", "background", "warning"} <= used
    for part, theme in ((light, LIGHT), (dark, DARK)):
        found = dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6});", part))
        assert used <= set(found)
        assert (found["text"], found["series-1"]) == (theme.text, theme.series[1])


def test_the_same_run_gives_the_same_bytes(tmp_path):
    run = make_run(tmp_path / "run")
    first = write_report(run).read_bytes()
    assert write_report(run).read_bytes() == first


def test_nothing_is_written_for_a_broken_run(tmp_path):
    run = make_run(tmp_path / "run")
    (run / "figures" / "loss.svg").unlink()
    with pytest.raises(ReportError, match=r"loss\.svg: is missing"):
        write_report(run)
    assert not (run / "report.html").exists()


def test_jinja_is_part_of_an_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "jinja2", None)
    with pytest.raises(MissingExtraError, match="view"):
        write_report(make_run(tmp_path / "run"))
