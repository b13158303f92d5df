"""Bad calls of every command, as data: the arguments, and what the line about them must contain.

They run in a folder with the files that ``write_files`` writes.
"""

from contextlib import suppress
from itertools import chain

from checkpoints import save_trained
from cli.commands import QUICK
from public_api import commands

from marl_lanes import load_scenario
from marl_lanes.cli.main import main
from marl_lanes.scenario.messages import shown
from marl_lanes.training.checkpoint import make_network, save_checkpoint

LONG = "x" * 5000

NO_NUMBERS = ["", " ", "x", "nan", "-inf", "1e400", "5 ", "\t5", "३", "0x10", "1e", "\udcff", LONG]
NO_WHOLE_NUMBERS = [*NO_NUMBERS, "1.0", "1e308", "-1", str(10**30), "9" * 5000]
NO_SCENARIOS = ["", "papier", "PAPER", "absent.yaml", ".", "d", "list.yaml", "broken.yaml"]
NO_SCENARIOS += ["binary.yaml", "empty.yaml", "unknown.yaml", "nan.yaml", "text.pt/x.yaml"]
NO_SCENARIOS += ["paper.yaml", "\udcff", "\udcff.yaml", "x" * 300 + ".yaml"]
NO_CHECKPOINTS = [" ", "absent.pt", "d", "text.pt", "empty.pt", "cut.pt", "quick.yaml", "text.pt/x"]
NO_CHECKPOINTS += ["zoo:", "zoo:absent", "zoo:../good", "absent:make", "raises:make"]
NO_CHECKPOINTS += ["blind.pt", "tuned-cascade.pt", "Random", "\udcff.pt", "x" * 300]
NO_FOLLOWERS = ["", " ", "learned:", "learned:absent.pt", "learned:text.pt", "learned:d", "a:b"]
NO_FOLLOWERS += [
    "learned:good.pt",
    "learned:zoo:absent",
    "unheard_of",
    "Neutral",
    ":",
    "learned",
    "\udcff",
    "other:x.pt",
]
NO_MODULES = ["absent", "../x", "a.", "", "a b", "a-b", "raises", "ends", "syntax", "d.x"]
NO_FILES = ["", " ", "d", ".", "/", "text.pt/x", "loop", "loop/x", "y" * 300]
NO_TRAJECTORIES = ["absent.parquet", "d.parquet", "text.parquet", "empty.parquet", "cut.parquet"]
NO_TRAJECTORIES += ["text.pt/x.parquet", "\udcff.parquet", "x" * 300 + ".parquet"]
NO_RUNS = ["", " ", "absent", "d", "text.pt", "good.pt", "plain", "listed", "broken", "unnamed"]
NO_RUNS += ["papier", "halved", "wrong", "text.pt/x", "\udcff", "y" * 300, "..", "/", "paper"]
NO_SIZES = ["", "x", "640", "640x", "640X480", "640x480x3", "-640x480", "1e3x480", "६४x४८"]
NO_SIZES += ["640 x 480", "123456x480", LONG]
SMALL_OR_LARGE = ["99999x99999", "319x180", "641x480", "0x0"]
NOBODY = ["", "x", "changer_", "changer_-1", "changer_1.5", "changer_३", "-1", "nan", "changer_01"]
NOBODY += ["Changer_1", " 3", "vehicle_3", LONG]

OPTIONS = ["--json", "--out", "--figure", "--scenario", "--seed", "--maneuvers", "--maneuver"]
OPTIONS += ["--policy", "--changers", "--followers", "--import", "--trajectories", "--road"]
OPTIONS += ["--no-optimum", "--port", "--open", "--speed", "--span", "--size", "--follow", "--at"]
OPTIONS += [
    "--task",
    "--label",
    "--page",
    "--start",
    "--seconds",
    "--x",
    "-x",
    "-v",
    "--json2",
    "--Seed",
]
"""Of all commands, and some of none."""

TEXTS = {
    "text.pt": "hello\n",
    "empty.pt": "",
    "text.parquet": "hello\n",
    "empty.parquet": "",
    "quick.yaml": QUICK,
    "endless.yaml": "{num_agents: null, horizon: null}\n",
    "rows.json": "[]\n",
    "wrong.json": "[{}]\n",
    "page.md": "no place for tables\n",
    "list.yaml": "[1, 2]\n",
    "broken.yaml": "{a: [\n",
    "empty.yaml": "",
    "unknown.yaml": "speeed: 1\n",
    "nan.yaml": "time_step: .nan\n",
    "raises.py": "1 / 0\n",
    "ends.py": "raise SystemExit('no')\n",
    "syntax.py": "def\n",
    "plain/config.yaml": "scenario: paper\n",
    "listed/config.yaml": "[1]\n",
    "broken/config.yaml": "{a: [\n",
    "papier/config.yaml": "scenario: papier\n",
    "unnamed/config.yaml": "seed: 1\n",
    "halved/config.yaml": "scenario: paper\n",
    "halved/evaluation.json": '{"scenario": "pap',
    "wrong/config.yaml": "scenario: paper\n",
    "wrong/evaluation.json": "[]",
    "old.html": "mine",
}


def write_files(folder):
    """What commands read, good and bad."""
    for name, text in TEXTS.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    (folder / "binary.yaml").write_bytes(bytes(range(128, 256)))
    (folder / "d").mkdir()
    (folder / "d.parquet").mkdir()
    with suppress(OSError):
        # Not on every system.
        (folder / "loop").symlink_to("loop")
    save_trained(folder / "good.pt")
    blind = load_scenario("paper", {"observation": {"features": ["speed", "curvature"]}})
    save_checkpoint(folder / "blind.pt", make_network(blind, "mlp"), "blind", 0)
    rows = folder / "rows.parquet"
    assert main(["record", "lane-keeping", "--seconds", "1", "--out", str(rows)]) == 0
    for whole, cut in ((folder / "good.pt", "cut.pt"), (rows, "cut.parquet")):
        content = whole.read_bytes()
        (folder / cut).write_bytes(content[: len(content) // 2])


def part(value):
    """The beginning of a value, where a message shows it as it is, or as its ``repr``."""
    return value.removeprefix("learned:")[:20].strip(" /") if value.isascii() else ""


def numbers(base, option, values, kind="number"):
    """Values of a number; ``base`` is a call that lacks nothing."""
    for value in values:
        beginning = shown(value)[1:20].rstrip("'")
        yield [*base, f"{option}={value}"], [f"{option}: ", beginning, f"must be a {kind}, "]
    for arguments in ([option], [f"{option}=--"], [option, "--import"]):
        yield [*base, *arguments], [f"{option}: expected one argument"]


def whole_numbers(base, *options):
    return chain(*(numbers(base, one, NO_WHOLE_NUMBERS, "whole number") for one in options))


def each(base, values, *fragments, option=None):
    """Values of an argument, or of an option; they may begin with a dash where that ends in =."""
    for value in values:
        given = [value] if option is None else [option, value]
        given = ["".join(given)] if option is not None and option.endswith("=") else given
        yield [*base, *given], [part(value), *fragments]


def outputs(base, option, ending=""):
    yield from each(base, NO_FILES, option, option=option)
    wrong = ("new", "new.xyz", ending, f"new{ending}.", f"new{ending}/x") if ending else ()
    yield from each(base, wrong, option=option)


def replacing(base, *given):
    """Outputs that would replace what is read, or each other; the last is named."""
    last = given[-1].removeprefix("./")
    yield [*base, *given], [f"{given[-2]} {last}: must be another file"]


def odd(base):
    """What the command does not have."""
    known = {name for action in commands()[base[0]] for name in action.option_strings}
    for option in OPTIONS:
        if not any(one.startswith(option) for one in known):
            yield [*base, option], ["unrecognized arguments"]
            yield [*base, f"{option}=1"], ["unrecognized arguments"]
        yield [*base, option, LONG], []
    for more in (["\udcff"] * 3, ["\x1b[2J", "", ""], ["line\nbreak", "x", "y"], [LONG] * 3):
        yield [*base, *more], ["unrecognized arguments"]


def fixed(*calls):
    return [(call.split(), [fragment]) for call, fragment in calls]


EVALUATE = ["evaluate", "--policy", "lane-keeping"]
CROSSPLAY = ["crossplay", "--changers", "lane-keeping", "--followers", "neutral"]
FOLLOWERS = ["followers", "--figure", "new.png"]
RECORD = ["record", "lane-keeping", "--out", "new.parquet"]
PICTURE = ["record", "lane-keeping", "--out", "new.png"]
REPLAY = ["replay", "rows.parquet", "--out", "new.html"]
WATCH = ["watch", "lane-keeping"]
BENCHMARK = ["benchmark", "lane-keeping"]
TABLE = ["benchmark-table", "rows.json"]
MANY = 10**12

CALLS = {
    "scenarios": [
        *outputs(["scenarios"], "--json"),
        *odd(["scenarios"]),
        *fixed(("scenarios paper", "unrecognized arguments: paper")),
    ],
    "show": [
        *each(["show"], NO_SCENARIOS, "scenario"),
        *outputs(["show", "paper"], "--json"),
        *replacing(["show", "quick.yaml"], "--json", "./quick.yaml"),
        *odd(["show", "paper"]),
        *fixed(("show", "SCENARIO"), ("show paper paper", "unrecognized arguments: paper")),
    ],
    "validate": [
        *each(["validate", "paper"], NO_MODULES, "--import", option="--import"),
        *outputs(["validate", "paper"], "--json"),
        *replacing(["validate", "paper", "quick.yaml"], "--json", "./quick.yaml"),
        # Any number of scenarios is read; what is wrong with them is no bad call.
        *(one for one in odd(["validate", "paper"]) if one[0][2].startswith("-")),
        *fixed(("validate", "SCENARIO")),
    ],
    "evaluate": [
        *whole_numbers(EVALUATE, "--maneuvers", "--seed"),
        *each(EVALUATE, NO_SCENARIOS, "scenario", option="--scenario"),
        *each(["evaluate"], NO_CHECKPOINTS),
        *each(EVALUATE, NO_MODULES, "--import", option="--import"),
        *outputs(EVALUATE, "--json"),
        *outputs(EVALUATE, "--trajectories", ".parquet"),
        *replacing(["evaluate", "good.pt"], "--json", "good.pt"),
        *replacing(["evaluate", "good.pt"], "--trajectories", "d/../good.pt"),
        *replacing([*EVALUATE, "--scenario", "quick.yaml"], "--json", "quick.yaml"),
        *replacing(EVALUATE, "--json", "x.parquet", "--trajectories", "x.parquet"),
        *fixed(
            ("evaluate", "--policy"),
            ("evaluate good.pt --policy random", "--policy"),
            ("evaluate --policy perfect", "perfect"),
            (f"evaluate --policy random --maneuvers {MANY}", f"num_maneuvers = {MANY}: needs"),
            ("evaluate --policy random --scenario endless.yaml", "num_agents"),
        ),
    ],
    "zoo": [
        *each(["zoo"], [*NO_SCENARIOS, "zoo:", "zoo:absent", "zoo:zoo.json"], "no such policy"),
        *outputs(["zoo"], "--json"),
        *odd(["zoo"]),
        *fixed(("zoo paper paper", "unrecognized arguments: paper")),
    ],
    "benchmark": [
        *whole_numbers(BENCHMARK, "--maneuvers", "--seed"),
        *each(["benchmark"], NO_CHECKPOINTS),
        *each(
            BENCHMARK, ["", "papier", "touch", "paper.yaml", "\udcff"], "--task", option="--task"
        ),
        *each(BENCHMARK, NO_MODULES, "--import", option="--import"),
        *outputs(BENCHMARK, "--json"),
        *replacing(["benchmark", "good.pt"], "--json", "good.pt"),
        *fixed(
            ("benchmark", "POLICY"),
            ("benchmark random random", "unrecognized arguments: random"),
            ("benchmark good.pt --task interactive", "good.pt: its features are"),
            ("benchmark good.pt --task paper interactive", "good.pt: its features are"),
            ("benchmark raises:make", "policy raises:make: ZeroDivisionError"),
            (f"benchmark random --maneuvers {MANY}", f"num_maneuvers = {MANY}: needs"),
        ),
    ],
    "benchmark-table": [
        *each(["benchmark-table"], [*NO_CHECKPOINTS, "wrong.json", "d.parquet", "binary.yaml"]),
        *outputs(TABLE, "--page"),
        *replacing(TABLE, "--page", "rows.json"),
        # Any number of files is read.
        *(one for one in odd(TABLE) if one[0][2].startswith("-")),
        *fixed(
            ("benchmark-table", "FILE"),
            ("benchmark-table wrong.json", "wrong.json: 0.policy: Field required"),
            ("benchmark-table rows.json --page page.md", "page.md: must have the lines"),
            ("benchmark-table rows.json --page absent.md", "absent.md: cannot be read"),
        ),
    ],
    "crossplay": [
        *whole_numbers(CROSSPLAY, "--maneuvers", "--seed"),
        *each(CROSSPLAY, NO_SCENARIOS, "scenario", option="--scenario"),
        *each(["crossplay", "--followers", "neutral", "--changers"], NO_CHECKPOINTS),
        *each(CROSSPLAY, NO_FOLLOWERS, option="--followers"),
        *each(CROSSPLAY, NO_MODULES, "--import", option="--import"),
        *outputs(CROSSPLAY, "--json"),
        *outputs(CROSSPLAY, "--figure", ".png"),
        *replacing([*CROSSPLAY, "learned:good.pt"], "--json", "good.pt"),
        *replacing([*CROSSPLAY, "--changers", "good.pt@quick.yaml"], "--json", "quick.yaml"),
        *replacing([*CROSSPLAY, "--changers", "good.pt"], "--json", "good.pt"),
        *replacing(CROSSPLAY, "--json", "x.png", "--figure", "x.png"),
        *replacing(CROSSPLAY, "--figure", "x.png", "--figure", "./x.png"),
        *fixed(
            ("crossplay --changers random", "--followers"),
            ("crossplay --followers neutral", "--changers"),
            (
                "crossplay --changers random random --followers neutral",
                "random: must be given once",
            ),
            ("crossplay --changers good.pt@ --followers neutral", "good.pt@: must be"),
            ("crossplay --changers @paper --followers neutral", "@paper: must be"),
            ("crossplay --changers random@papier --followers neutral", "'papier': no such"),
            ("crossplay --changers random --followers a a", "a: must be given once"),
            (
                f"crossplay --changers random --followers neutral --maneuvers {MANY}",
                f"num_maneuvers = {MANY}: needs",
            ),
        ),
    ],
    "followers": [
        *whole_numbers(FOLLOWERS, "--maneuvers", "--seed", "--maneuver"),
        *each(FOLLOWERS, NO_SCENARIOS, "scenario", option="--scenario"),
        *each(FOLLOWERS, NO_CHECKPOINTS),
        *each(FOLLOWERS, NO_FOLLOWERS, option="--followers"),
        *each(FOLLOWERS, NO_MODULES, "--import", option="--import"),
        *outputs(FOLLOWERS, "--json"),
        *outputs(["followers"], "--figure", ".svg"),
        *replacing([*FOLLOWERS, "good.pt"], "--json", "good.pt"),
        *replacing(["followers"], "--json", "x.png", "--figure", "x.png"),
        *fixed(
            ("followers", "--figure"),
            ("followers --figure x.png --policy perfect", "perfect"),
            ("followers --figure x.png --maneuver 200", "maneuver = 200: must be 0 to 199"),
            (f"followers --figure x.png --maneuvers {MANY}", f"num_maneuvers = {MANY}: needs"),
        ),
    ],
    "record": [
        *whole_numbers(RECORD, "--seed", "--road", "--maneuver"),
        *numbers(RECORD, "--start", ["-1", "1e10"]),
        *numbers(RECORD, "--seconds", ["-1", "1e10"]),
        *numbers(PICTURE, "--at", [*NO_NUMBERS, "-1", "1e308"]),
        *numbers(PICTURE, "--span", ["19", "2001", "-140", "0"]),
        *numbers(PICTURE, "--speed", ["0", "-1", "101", "1e308"]),
        *each(PICTURE, NO_SIZES, "size", option="--size="),
        *(([*PICTURE, "--size", one], ["size = ("]) for one in SMALL_OR_LARGE),
        *each(PICTURE, NOBODY, "follow", option="--follow="),
        *each(RECORD, NO_SCENARIOS, "scenario", option="--scenario"),
        *each(["record", "--out", "new.parquet"], NO_CHECKPOINTS),
        *each(["record", "--out", "new.png"], NO_TRAJECTORIES),
        *each(RECORD, NO_FOLLOWERS, option="--followers"),
        *each(RECORD, NO_MODULES, "--import", option="--import"),
        *outputs(["record", "lane-keeping"], "--out", ".csv"),
        *replacing(["record", "rows.parquet"], "--out", "rows.parquet"),
        *replacing(["record", "good.pt"], "--out", "x.csv", "--out", "x.csv"),
        *fixed(
            ("record random", "--out"),
            ("record --out x.png", "POLICY"),
            ("record random random --out x.png", "random: must be given once"),
            ("record good.pt@ --out x.png", "good.pt@: must be"),
            ("record random --out x.csv --seconds 0", "--seconds 0: must be above 0"),
            ("record random --out x.csv --maneuver 10", "--maneuver 10: must be 0 to 9"),
            ("record random --out x.csv --maneuver 1 --start 3", "--start 3: not with --maneuver"),
            ("record random --out x.csv --at 3", "--at 3: is the time of a .png"),
            ("record random --out x.csv --scenario endless.yaml", "num_agents"),
            (
                "record random --out x.csv --scenario endless.yaml --seconds 1e9",
                "last_time = 1000000000.0: needs about",
            ),
            ("record rows.parquet --out x.png --road 1", "road"),
            ("record rows.parquet --out x.png --seed 1", "--seed 1: not with recorded"),
            ("record rows.parquet --out x.png --scenario paper", "--scenario paper: not with"),
            ("record rows.parquet --out x.png --followers neutral", "rows.parquet: is recorded"),
            ("record rows.parquet@paper --out x.png", "rows.parquet: is recorded"),
            ("record rows.parquet --out x.png --at 5", "--at 5: recorded is the time from"),
        ),
    ],
    "replay": [
        *whole_numbers(REPLAY, "--road"),
        *(([*one, "--out", "new.html"], parts) for one, parts in each(["replay"], NO_TRAJECTORIES)),
        *(([*one, "--out", "new.html"], parts) for one, parts in each(["replay"], ["", " ", "d"])),
        *outputs(["replay", "rows.parquet"], "--out"),
        *replacing(["replay", "rows.parquet"], "--out", "rows.parquet"),
        *odd(REPLAY),
        *fixed(
            ("replay", "trajectory"),
            ("replay rows.parquet", "--out"),
            ("replay rows.parquet --out x.html --road 1", "road"),
            ("replay rows.parquet --out x.html --no-optimum=1", "--no-optimum"),
        ),
    ],
    "report": [
        *each(["report"], NO_RUNS),
        *odd(["report", "d"]),
        *fixed(("report", "RUN"), ("report d d", "unrecognized arguments: d")),
    ],
    "watch": [
        *whole_numbers(WATCH, "--seed", "--port"),
        *numbers(WATCH, "--speed", [*NO_NUMBERS, "0", "-1", "0.09", "20.1", "1e308"]),
        *each(WATCH, ["65536", "-1"], option="--port"),
        *each(WATCH, NO_SCENARIOS, "scenario", option="--scenario"),
        *each(["watch"], ["", *NO_CHECKPOINTS]),
        *each(["watch"], ["d", ".", "/", "listed", "broken", "unnamed", "papier"]),
        *each(WATCH, NO_MODULES, "--import", option="--import"),
        *fixed(("watch", "RUN|POLICY"), ("watch random --open=yes", "--open")),
    ],
    "doctor": [
        *outputs(["doctor"], "--json"),
        *odd(["doctor"]),
        *fixed(
            ("doctor paper", "unrecognized arguments: paper"),
            ("doctor --json", "--json: expected one argument"),
            ("doctor --json=--", "--json: expected one argument"),
        ),
    ],
}
"""By command."""
