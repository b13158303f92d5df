"""Hooks of MkDocs: pages from outside of docs/, and a check that no page loads from elsewhere."""

import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files, InclusionLevel
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
NAMES = ("README.md", "CHANGELOG.md", "CODE_OF_CONDUCT.md", "CONTRIBUTING.md", "SECURITY.md")
FILES = ("CITATION.cff", "LICENSE")
OUTSIDE = [
    *NAMES,
    *FILES,
    *(path.relative_to(ROOT).as_posix() for path in sorted(ROOT.glob("agents/**/*.md"))),
]
"""Of the site and not in docs/: their paths in the repository, and in the site."""

LINK = re.compile(r"(?<=\]\()(?![a-z]+:|#)[^)\s#]+")
LOADED = re.compile(r"<(?:script|img|iframe)[^>]+src=.?https?:[^>]*>|<link[^>]+sheet[^>]+https?:")


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """Add the pages from outside of docs/; README.md takes the place of docs/README.md."""
    files.remove(files.src_uris["README.md"])
    for name in OUTSIDE:
        files.append(
            File.generated(
                config,
                name,
                abs_src_path=str(ROOT / name),
                inclusion=InclusionLevel.INCLUDED,
            )
        )
    return files


def on_page_markdown(markdown: str, *, page: Page, **_: Any) -> str:
    """Lead relative links from where pages are in the repository to where they are in the site."""
    name = page.file.src_uri
    folder = posixpath.dirname(name if name in OUTSIDE else f"docs/{name}")

    def lead(match: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(folder, match[0])).removeprefix("docs/")
        return posixpath.relpath(target, posixpath.dirname(name) or ".")

    return LINK.sub(lead, markdown)


def on_post_page(output: str, *, page: Page, **_: Any) -> str:
    """Refuse a page that loads something from another host.

    Raises:
        PluginError: a script, a picture or a style sheet of another host is in it.
    """
    found = LOADED.search(output)
    if found:
        raise PluginError(f"{page.file.src_uri} loads from another host: {found[0]}")
    return output
