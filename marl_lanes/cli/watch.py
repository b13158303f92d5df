"""The command that shows a running simulation in the browser."""

import argparse
import gc
import threading
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING

from marl_lanes.cli.arguments import Commands, add_command, add_scenario, add_seed
from marl_lanes.cli.completers import offer, policies
from marl_lanes.cli.policies import TRAINED, UNTRAINED, is_policy, make_policy
from marl_lanes.cli.values import number, whole_number
from marl_lanes.extras import need
from marl_lanes.plugins import add_import, import_modules
from marl_lanes.terminal import say, warn

if TYPE_CHECKING:
    from marl_lanes.browser.episodes import Show


def add(commands: Commands) -> None:
    """Add ``watch``."""
    watch = add_command(
        commands,
        "watch",
        _watch,
        summary="watch a policy, or a training's newest model, drive",
        description="Simulate a road and show it in the browsers of this computer, until Ctrl-C. "
        "Of a run folder the newest saved model drives; a newer one takes over at the start of "
        "the next episode.",
        examples="""
            marl-lanes watch tuned-cascade --open
            marl-lanes watch zoo:interactive --scenario interactive --open
            marl-lanes watch runs/paper --port 8000 --speed 2
        """,
    )
    source = f"a run folder, {', '.join(UNTRAINED)}, {TRAINED}"
    offer(watch.add_argument("source", metavar="RUN|POLICY", help=source), policies)
    add_scenario(watch, default=None, note="that of the run, else paper")
    add_seed(watch, default=0)
    watch.add_argument(
        "--port",
        type=whole_number(0, 65535),
        default=0,
        help="on 127.0.0.1 (default: a free one)",
    )
    watch.add_argument(
        "--speed",
        type=number(0.1, 20.0),
        default=1.0,
        help="relative to real time, 0.1 to 20 (default: 1)",
    )
    watch.add_argument("--open", action="store_true", help="open the page in the browser")
    add_import(watch)


def _watch(options: argparse.Namespace) -> None:
    for package in ("starlette", "uvicorn"):
        need(package, "view")

    # Here, because other commands do not need it, and it is slow to load.
    import asyncio

    from marl_lanes.browser.hub import Hub
    from marl_lanes.browser.server import LiveServer, open_socket
    from marl_lanes.training.interruptions import note_interruptions

    import_modules(options.modules)
    show = _make_show(options)
    with open_socket(options.port) as listener:
        show.prepare()
        address = "http://{}:{}/".format(*listener.getsockname())

        def begin() -> None:
            say(f"{address}  (Ctrl-C ends)")
            if options.open:
                # Some browsers hold the call until they are closed.
                threading.Thread(target=webbrowser.open, args=[address], daemon=True).start()

        # What is loaded stays: without this, Python would search it all when it ends.
        gc.freeze()
        # uvicorn takes Ctrl-C as the wish to end, and passes it on when it has ended.
        with note_interruptions():
            asyncio.run(LiveServer(show, Hub(), begin=begin).run_on(listener))


def _make_show(options: argparse.Namespace) -> "Show":
    from marl_lanes.browser.episodes import Show
    from marl_lanes.browser.models import FixedModel, Model, Models, RunModels
    from marl_lanes.scenario import load_scenario

    source, seed = options.source, options.seed
    given = None if options.scenario is None else load_scenario(options.scenario)
    models: Models
    if source not in UNTRAINED and Path(source).is_dir():
        run = RunModels(Path(source), given, warn=lambda trouble: warn(f"warning: {trouble}"))
        scenario, models = run.scenario, run
    else:
        if not is_policy(source):
            raise ValueError(
                f"{source}: must be a run folder, {TRAINED}, or one of {', '.join(UNTRAINED)}"
            )
        scenario = given or load_scenario("paper")
        models = FixedModel(Model(source, make_policy(source, scenario, seed)))
    return Show(scenario, models, seed=seed, speed=options.speed)
