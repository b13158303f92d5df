"""marl-lanes record: what it writes, what it shows, and what it refuses."""

import sys

import numpy as np
import pandas
import pytest
from cli.commands import QUICK, assert_refused, files
from films import describe, read_pictures

from marl_lanes.cli.main import main
from marl_lanes.traffic.machine.state import Outcome
from marl_lanes.trajectory.events import find_commands
from marl_lanes.trajectory.file import read_trajectory

RECORD = ["record", "tuned-cascade", "--scenario", "quick.yaml", "--size", "320x180"]
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A folder with every kind of file of one command."""
    folder = tmp_path_factory.mktemp("recorded")
    (folder / "quick.yaml").write_text(QUICK, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        names = [f"all{suffix}" for suffix in (".mp4", ".gif", ".png", ".parquet", ".csv")]
        outputs = [word for name in [*names, "all.fcd.xml"] for word in ("--out", name)]
        assert main([*RECORD, "--seed", "2", *outputs]) == 0
    return folder


@pytest.fixture
def folder(recorded, monkeypatch):
    """That folder, as the current one."""
    monkeypatch.chdir(recorded)
    return recorded


def shown(*commands, fps=30.0):
    """Frames of a film from 2 s before the commands' engagement to 3 s after their outcome."""
    start = min(one.engaged_steps[-1] for one in commands)
    end = max(one.last_step for one in commands)
    return round((0.1 * (end - start) + 5.0) * fps) + 1


def test_every_kind_of_file_is_of_the_same_road(folder):
    trajectory = read_trajectory(folder / "all.parquet")
    metadata = trajectory.metadata
    assert (metadata.policy, metadata.seed, metadata.scenario.name) == ("tuned-cascade", 2, "quick")
    commands = find_commands(trajectory.rows)
    assert [one.command for one in commands] == [0, 1, 2, 3]
    completed = [one for one in commands if one.outcome == Outcome.COMPLETED]
    first = min(completed, key=lambda one: one.last_step)
    assert len(read_pictures(folder / "all.mp4")) == pytest.approx(shown(first), abs=1)
    assert len(read_pictures(folder / "all.gif")) == pytest.approx(shown(first, fps=12.5), abs=1)
    assert read_pictures(folder / "all.png").shape == (1, 180, 320, 3)
    assert len(pandas.read_csv(folder / "all.csv")) == len(trajectory.rows)
    text = (folder / "all.fcd.xml").read_text(encoding="utf-8")
    assert text.count("<vehicle ") == len(trajectory.rows)


def test_a_film_shows_a_lane_change(folder):
    """The red vehicle, which the camera follows, moves from one lane to another."""
    pictures = read_pictures(folder / "all.mp4").astype(int)[:, :100, 100:170]
    # The last 3 s are after the change, where it is red no longer.
    places = []
    for picture in pictures[60:-100:20]:
        is_red = picture[..., 0] > np.maximum(picture[..., 1], picture[..., 2]) + 60
        places.append(np.nonzero(is_red)[0].mean())
    assert abs(places[-1] - places[0]) == pytest.approx(3.75 * 320 / 140, abs=2.5)


def test_a_recorded_road_is_filmed_without_simulation(folder, tmp_path, monkeypatch, capsys):
    monkeypatch.delattr("marl_lanes.evaluation.recording.record_road")
    out = str(tmp_path / "again.mp4")
    assert main(["record", "all.parquet", "--size", "320x180", "--out", out]) == 0
    assert capsys.readouterr().out == f"{out}\n"
    assert (tmp_path / "again.mp4").read_bytes() == (folder / "all.mp4").read_bytes()


def test_the_same_command_writes_the_same_bytes(folder, tmp_path):
    outputs = [f"{tmp_path}/all{suffix}" for suffix in (".parquet", ".csv", ".png")]
    out = [word for name in outputs for word in ("--out", name)]
    assert main([*RECORD, "--seed", "2", *out]) == 0
    for suffix in (".parquet", ".csv", ".png"):
        again = (tmp_path / f"all{suffix}").read_bytes()
        assert again == (folder / f"all{suffix}").read_bytes(), suffix


def test_a_given_maneuver(folder, tmp_path):
    commands = find_commands(read_trajectory(folder / "all.parquet").rows)
    # Not the one that is shown by default.
    last = max(commands, key=lambda one: one.last_step)
    number = str(last.command)
    out, data, followed = (tmp_path / name for name in ("k.mp4", "k.parquet", "followed.mp4"))
    options = ["--maneuver", number, "--out", str(out), "--out", str(data)]
    assert main(["record", "all.parquet", "--size", "320x180", *options]) == 0
    first = (last.engaged_steps or (last.first_step,))[0]
    lasts = 0.1 * (last.last_step - first) + 5.0
    assert len(read_pictures(out)) == pytest.approx(30 * lasts, abs=2)
    times = read_trajectory(data).rows["time"]
    assert times.max() == pytest.approx(0.1 * last.last_step + 3.0)
    assert times.max() - times.min() == pytest.approx(lasts, abs=0.11)
    options = ["--follow", f"changer_{number}", "--out", str(followed)]
    assert main(["record", "all.parquet", "--size", "320x180", *options]) == 0
    assert followed.stat().st_size == out.stat().st_size
    assert followed.read_bytes() != (folder / "all.mp4").read_bytes()


@pytest.mark.usefixtures("folder")
def test_a_given_time(tmp_path):
    out, data = tmp_path / "part.mp4", tmp_path / "part.csv"
    options = ["--start", "3", "--seconds", "1.5", "--out", str(out), "--out", str(data)]
    assert main([*RECORD, *options]) == 0
    assert len(read_pictures(out)) == 46
    times = pandas.read_csv(data)["time"]
    assert (times.min(), times.max()) == pytest.approx((3.0, 4.5))


@pytest.mark.usefixtures("folder")
def test_a_faster_film_of_another_size(tmp_path):
    out = tmp_path / "fast.mp4"
    options = ["--seconds", "2", "--speed", "4", "--span", "60", "--size", "640x360"]
    assert main(["record", "all.parquet", *options, "--out", str(out)]) == 0
    assert read_pictures(out).shape == (16, 360, 640, 3)


def test_a_named_changer_is_followed_after_its_command(folder, tmp_path):
    rows = read_trajectory(folder / "all.parquet").rows
    first = min(find_commands(rows), key=lambda one: one.last_step)
    time = f"{0.1 * first.last_step + 2.5:.1f}"
    pictures = set()
    for number, whom in enumerate((f"changer_{first.command}", str(first.vehicle))):
        out = tmp_path / f"{number}.png"
        options = ["--at", time, "--size", "320x180", "--follow", whom, "--out", str(out)]
        assert main(["record", "all.parquet", *options]) == 0
        pictures.add(out.read_bytes())
    assert len(pictures) == 1


@pytest.mark.usefixtures("folder")
def test_a_still_at_a_time(tmp_path):
    every = [tmp_path / f"{time}.png" for time in ("3", "9")]
    for path in every:
        options = ["--at", path.stem, "--size", "320x180", "--out", str(path)]
        assert main(["record", "all.parquet", *options]) == 0
    assert every[0].read_bytes() != every[1].read_bytes()


@pytest.mark.usefixtures("folder")
def test_followers_go_side_by_side_and_their_data_into_a_file_each(tmp_path, capsys):
    out = ["--out", f"{tmp_path}/film.mp4", "--out", f"{tmp_path}/rows.fcd.xml"]
    arguments = ["record", "tuned-cascade", "--scenario", "quick.yaml", "--seconds", "1"]
    arguments += ["--size", "320x440", "--followers", "neutral", "adversarial"]
    assert main([*arguments, *out]) == 0
    names = [f"rows-{kind}_followers.fcd.xml" for kind in ("neutral", "adversarial")]
    assert files(tmp_path) == {"film.mp4", *names}
    printed = capsys.readouterr().out.splitlines()
    assert printed == [str(tmp_path / name) for name in ("film.mp4", *names)]
    assert "320x440" in describe(tmp_path / "film.mp4")


@pytest.mark.usefixtures("folder")
def test_policies_on_the_same_traffic(tmp_path):
    out = tmp_path / "rows.parquet"
    arguments = ["record", "tuned-cascade", "lane-keeping@quick.yaml", "all.parquet"]
    assert main([*arguments, "--scenario", "quick.yaml", "--seed", "2", "--out", str(out)]) == 0
    names = ("tuned-cascade", "lane-keeping@quick", "all")
    found = [read_trajectory(tmp_path / f"rows-{name}.parquet") for name in names]
    assert found[0].rows.tobytes() == found[2].rows.tobytes()
    assert found[1].metadata.policy == "lane-keeping"
    # Until the first engagement they are the same.
    first = min(one.engaged_steps[0] for one in find_commands(found[0].rows))
    before = [one.rows[one.rows["step"] <= first].tobytes() for one in found]
    assert before[0] == before[1]


@pytest.mark.usefixtures("folder")
def test_a_road_of_an_evaluation(tmp_path):
    """The file has every road; one of them is filmed, or driven again."""
    arguments = ["--scenario", "quick.yaml", "--maneuvers", "8", "--seed", "2"]
    rows = str(tmp_path / "roads.parquet")
    assert main(["evaluate", "--policy", "tuned-cascade", *arguments, "--trajectories", rows]) == 0
    assert read_trajectory(tmp_path / "roads.parquet").roads == [0, 1]
    for name, source in (("one", [rows]), ("other", [*RECORD[1:4], "--seed", "2"])):
        out = str(tmp_path / f"{name}.csv")
        assert main(["record", *source, "--road", "1", "--out", out]) == 0
    assert (tmp_path / "one.csv").read_bytes() == (tmp_path / "other.csv").read_bytes()


def test_a_scenario_without_end_has_the_time_that_is_given(folder, tmp_path):
    (folder / "endless.yaml").write_text("{num_agents: null, horizon: null}", encoding="utf-8")
    out = tmp_path / "rows.csv"
    arguments = ["record", "tuned-cascade", "--scenario", "endless.yaml", "--out", str(out)]
    assert main(arguments) == 2
    assert main([*arguments, "--start", "1", "--seconds", "2"]) == 0
    times = pandas.read_csv(out)["time"]
    assert (times.min(), times.max()) == pytest.approx((1.0, 3.0))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["tuned-cascade", "--out", "a.avi"],
            "--out a.avi: must end in .mp4, .gif, .png, .parquet",
        ),
        (["tuned-cascade", "--out", ".mp4"], "--out .mp4: must end in"),
        (["tuned-cascade", "--out", "deep.png"], "--out deep.png: must be a file, not a folder"),
        (["tuned-cascade", "--scenario", "x", "--out", "a.png"], "scenario 'x': no such scenario"),
        (["tuned-cascade", "--seed", "-1", "--out", "a.csv"], "--seed: '-1': must be"),
        (["tuned-cascade", "--road", "-1", "--out", "a.csv"], "--road: '-1': must be"),
        (["none.pt", "--out", "a.png"], "checkpoint none.pt: cannot be read"),
        (["none.parquet", "--out", "a.png"], "none.parquet"),
        (["text.parquet", "--out", "a.png"], "text.parquet: not readable as Parquet"),
        (["all.parquet", "--road", "3", "--out", "a.png"], "road = 3: must be one of [0]"),
        (["all.parquet", "--seed", "1", "--out", "a.png"], "--seed 1: not with recorded"),
        (["all.parquet", "--scenario", "paper", "--out", "a.png"], "--scenario paper: not with"),
        (["all.parquet@dense", "--out", "a.png"], "all.parquet: is recorded"),
        (["all.parquet", "--followers", "neutral", "--out", "a.png"], "is recorded"),
        (["all.parquet", "--maneuver", "9", "--out", "a.png"], "maneuver = 9: must be a command"),
        (
            ["all.parquet", "--maneuver", "1", "--start", "1", "--out", "a.mp4"],
            "--start 1: not with",
        ),
        (["all.parquet", "--seconds", "0", "--out", "a.mp4"], "--seconds 0: must be above 0"),
        (["all.parquet", "--start", "-1", "--out", "a.mp4"], "--start: '-1': must be"),
        (["all.parquet", "--start", "900", "--out", "a.mp4"], "--start 900: recorded is the time"),
        (["all.parquet", "--at", "900", "--out", "a.png"], "--at 900: recorded is the time"),
        (["all.parquet", "--at", "1", "--out", "a.mp4"], "--at 1: is the time of a .png"),
        (["all.parquet", "--size", "big", "--out", "a.mp4"], "--size 'big': must be WxH"),
        (["all.parquet", "--size", "321x180", "--out", "a.mp4"], "size = (321, 180): must be"),
        (["all.parquet", "--span", "1", "--out", "a.mp4"], "--span: '1': must be a number, 20 to"),
        (["all.parquet", "--speed", "0", "--out", "a.mp4"], "--speed: '0': must be"),
        (["all.parquet", "--follow", "me", "--out", "a.mp4"], "follow = 'me': must be"),
        (["all.parquet", "--follow", "99999", "--out", "a.mp4"], "--follow 99999: must be on a"),
        (
            ["all.parquet", "--follow", "changer_99", "--seconds", "2", "--out", "a.mp4"],
            "--follow changer_99: must be on a recorded road",
        ),
        (["cascade", "--out", "a.png"], "without learning: tuned-cascade, assertive-c"),
        (["all.parquet", "--follow", "changer_x", "--out", "a.csv"], "follow = 'changer_x': must"),
        (
            ["all.parquet", "all.parquet", "--out", "a.mp4"],
            "POLICY all.parquet: must be given once",
        ),
        (
            ["random", "all.parquet", "--size", "320x180", "--out", "a.mp4"],
            "size = (320, 180): must be at least",
        ),
    ],
)
def test_bad_input_is_one_line_and_nothing_is_written(capsys, folder, arguments, message):
    (folder / "deep.png").mkdir(exist_ok=True)
    (folder / "text.parquet").write_text("hello\n", encoding="utf-8")
    assert_refused(capsys, folder, ["record", *arguments], message)


@pytest.mark.parametrize(("package", "out"), [("pyarrow", "a.csv"), ("imageio_ffmpeg", "a.mp4")])
def test_a_missing_package_is_said_before_anything_is_driven(
    capsys, folder, monkeypatch, package, out
):
    monkeypatch.setitem(sys.modules, package, None)
    message = f"{package}: is not installed: pip install 'marl-lanes[view]'"
    assert_refused(capsys, folder, [*RECORD, "--out", out], message)
