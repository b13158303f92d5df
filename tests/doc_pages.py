"""The pages of the documentation, and the shell commands and files that they show."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES = [
    *sorted(ROOT.glob("*.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "agents").rglob("*.md")),
]
FENCE = re.compile(r"^ *```(\w*)")
SHELLS = ("sh", "bash", "shell", "console")
PROGRAMS = "marl-lanes|python3?|pip|make|pytest|ray|uv|git|cd|npm|docker"
INDENTED = re.compile(rf"^ {{4}}((?:\S*[/\\])?(?:{PROGRAMS})(?: .*)?|\.ci/\w+.*)$")
"""A command without a fence. Formulas and what programs print stand in the same way."""
COMMENT = re.compile(r"(?:^|\s+)# .*$")
NAMED = re.compile(
    r"^[^\n]*`([\w./-]+\.(?:py|yaml))`[^\n]*\n\n```(?:python|yaml)\n(.*?)^```",
    re.DOTALL | re.MULTILINE,
)
"""A file that the reader shall write: its name in the line above the block."""


def text_of(path):
    return path.read_text(encoding="utf-8")


def name_of(page):
    return page.relative_to(ROOT).as_posix()


def commands_of(text):
    """The command lines of a page, in order: continued lines as one, without comments."""
    language, found = None, []
    for line in re.sub(r"\s*\\\n\s*", " ", text).splitlines():
        if fence := FENCE.match(line):
            language = fence[1] if language is None else None
        elif language in SHELLS:
            found.append(COMMENT.sub("", line))
        elif language is None and (shown := INDENTED.match(line)):
            found.append(COMMENT.sub("", shown[1]))
    return [line.strip() for line in found if line.strip()]


COMMANDS = {page: commands for page in PAGES if (commands := commands_of(text_of(page)))}
FILES = {name: text for page in PAGES for name, text in NAMED.findall(text_of(page))}
