"""The replay page: its sources, and one HTML file that holds the page and a trajectory."""

import base64
import hashlib
import html
import json
import re
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from marl_lanes.browser.encoding import encode_chunk, encode_header
from marl_lanes.colours import DARK, LIGHT, TRAFFIC
from marl_lanes.files import write_atomically
from marl_lanes.trajectory.events import find_events
from marl_lanes.trajectory.file import Trajectory

PREFIX = "replay/"
"""Before a module's name where another one imports it: ``replay/clock`` is ``page/clock.js``."""

FILE_ENTRY = "main"
"""The module that starts a page which holds its trajectory."""

NOTHING = "'none'"
"""The source list of a Content-Security-Policy that allows nothing."""

_IMPORT = re.compile(rf'^(?:import|}}) .*?"{PREFIX}(\w+)";$', re.MULTILINE)


@cache
def read_modules() -> dict[str, str]:
    """The sources of the page's JavaScript modules by name."""
    folder = files("marl_lanes.browser") / "page"
    found = {path.name: path for path in folder.iterdir()}
    return {
        name.removesuffix(".js"): found[name].read_text(encoding="utf-8")
        for name in sorted(found)
        if name.endswith(".js")
    }


def needed_modules(entry: str) -> list[str]:
    """The names of the modules that one needs, itself included, ascending."""
    modules = read_modules()
    needed, found = [entry], set[str]()
    while needed:
        name = needed.pop()
        if name not in found:
            found.add(name)
            needed += _IMPORT.findall(modules[name])
    return sorted(found)


def make_style() -> str:
    """The page's style sheet: variables for the colours, then ``page/style.css``."""
    dark = "{" + _declare(DARK.variables()) + "}"
    variables = (
        f":root{{{_declare(LIGHT.variables() | vars(TRAFFIC))}}}\n"
        f"@media(prefers-color-scheme:dark){{:root:not([data-theme=light]){dark}}}\n"
        f":root[data-theme=dark]{dark}\n"
    )
    return variables + (files("marl_lanes.browser") / "page" / "style.css").read_text("utf-8")


def make_page(
    *,
    title: str,
    entry: str,
    addresses: Mapping[str, str],
    data: Mapping[str, Any],
    sources: Sequence[str],
) -> str:
    """The page's HTML.

    Its Content-Security-Policy allows no request but to ``sources``, and no script but the page's:
    the inline ones by their hashes.

    Args:
        title: text.
        entry: name of the module to start with.
        addresses: URL of every module by name; the import map.
        data: by the id of the script element that holds it as JSON.
        sources: of the Content-Security-Policy, for scripts and connections: ``data:`` for a
            file, ``'self'`` for a server.
    """
    style = make_style()
    imports = {f"{PREFIX}{name}": address for name, address in addresses.items()}
    scripts = [
        ("importmap", _dump({"imports": imports})),
        ("module", f'import "{PREFIX}{entry}";'),
    ]
    hashes = [_hash(content) for _, content in scripts]
    servers = [source for source in sources if source != "data:"]
    policy = "; ".join(
        [
            f"default-src {NOTHING}",
            f"script-src {' '.join([*sources, *hashes])}",
            f"style-src {_hash(style)}",
            f"connect-src {' '.join(servers or [NOTHING])}",
            f"base-uri {NOTHING}",
            f"form-action {NOTHING}",
        ]
    )
    head = [
        f'<meta http-equiv="Content-Security-Policy" content="{html.escape(policy)}">',
        f"<title>{html.escape(title)}</title>",
        f"<style>{style}</style>",
    ]
    body = [
        f'<script type="application/json" id="{name}">{_dump(value)}</script>'
        for name, value in data.items()
    ]
    body += [f'<script type="{kind}">{content}</script>' for kind, content in scripts]
    page = (files("marl_lanes.browser") / "page" / "index.html").read_text(encoding="utf-8")
    before, middle = page.split("<!--head-->")
    middle, after = middle.split("<!--scripts-->")
    return "".join([before, "\n".join(head), middle, "\n".join(body), after])


def make_replay(trajectory: Trajectory, road: int, optima: Mapping[int, Any] | None) -> str:
    """One HTML file with the page and a road of a trajectory; it requests nothing.

    Args:
        trajectory: with the road.
        road: its index.
        optima: by command, from ``optima.find_optima``; None if they were not computed.

    Raises:
        TrajectoryError: there is no such road, or a value is too large for the page.
    """
    modules = read_modules()
    rows = trajectory.rows_of(road)
    return make_page(
        title=f"{trajectory.scenario.name}: replay",
        entry=FILE_ENTRY,
        addresses={name: _data_url(modules[name]) for name in needed_modules(FILE_ENTRY)},
        data={
            "header": encode_header(trajectory.metadata, road),
            "optima": optima or {},
            "chunks": [encode_chunk(rows, find_events(rows))],
        },
        sources=["data:"],
    )


def write_replay(
    path: Path, trajectory: Trajectory, road: int, optima: Mapping[int, Any] | None
) -> int:
    """Write ``make_replay`` to a file.

    Returns:
        its size [bytes].

    Raises:
        TrajectoryError: there is no such road, or a value is too large for the page.
        OSError: the file cannot be written.
    """
    page = make_replay(trajectory, road, optima).encode("utf-8")
    write_atomically(path, lambda temporary: temporary.write_bytes(page))
    return len(page)


def _declare(variables: Mapping[str, str]) -> str:
    return "".join(f"--{name.replace('_', '-')}:{value};" for name, value in variables.items())


def _dump(value: Any) -> str:
    """As JSON that can stand in a script element: no text in it ends or opens an element."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _hash(content: str) -> str:
    digest = hashlib.sha256(content.encode("utf-8")).digest()
    return f"'sha256-{base64.b64encode(digest).decode('ascii')}'"


def _data_url(source: str) -> str:
    encoded = base64.b64encode(source.encode("utf-8")).decode("ascii")
    return f"data:text/javascript;charset=utf-8;base64,{encoded}"
