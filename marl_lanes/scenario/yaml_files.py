"""YAML files, a stranger's too: plain values within bounds, or one line about what is wrong."""

import errno
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from marl_lanes.scenario.messages import shown

MAX_BYTES = 2**20
"""[bytes] of a file."""

MAX_VALUES = 100_000
"""Values of a file; an alias counts as all that it stands for."""

MAX_DEPTH = 32
"""Levels of lists and mappings inside of each other."""

_MERGE = "<<"

# The same parser in C is ten times faster; not every build of PyYAML has it.
_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

# What text without quotes means by YAML 1.2's core schema. It stays text where nothing matches.
_WORDS: dict[str, bool | None] = {"": None, "~": None, "null": None, "Null": None, "NULL": None}
_WORDS |= dict.fromkeys(("true", "True", "TRUE"), True)
_WORDS |= dict.fromkeys(("false", "False", "FALSE"), False)
_NUMBERS: tuple[tuple[str, Callable[[str], float]], ...] = (
    # Python reads no more than 4,300 digits.
    ("[-+]?[0-9]{1,4000}", int),
    ("0o[0-7]{1,4000}", lambda text: int(text, 8)),
    ("0x[0-9a-fA-F]{1,4000}", lambda text: int(text, 16)),
    (r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?", float),
    (r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)", lambda text: float(text.replace(".", ""))),
)


class YamlError(ValueError):
    """A file that is not read; the message says why, on one line."""


def read_yaml(path: Path) -> Any:
    """The content of a YAML file: null, booleans, numbers, text, lists, mappings with text as keys.

    Text without quotes is read by YAML 1.2's core schema. Merge keys (``<<``) are followed. Tags
    are refused, so that nothing but these values can come out.

    Raises:
        YamlError: it is no regular file, cannot be read, is too large, or not such YAML.
    """
    try:
        if path.exists() and not path.is_file():
            # Reading a pipe or a device might never end.
            raise OSError(errno.EINVAL, "must be a regular file")
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise YamlError(f"cannot be read: {error.strerror}") from None
    except ValueError:
        raise YamlError("cannot be read: no file can have this name") from None
    return parse_yaml(content)


def parse_yaml(content: bytes) -> Any:
    """As ``read_yaml``, from the bytes of a file.

    Raises:
        YamlError: they are too many, or not such YAML.
    """
    if len(content) > MAX_BYTES:
        raise YamlError(f"cannot be read: must have at most {MAX_BYTES:,} bytes")
    try:
        return _Builder().build(yaml.parse(content.decode("utf-8-sig"), Loader=_Loader))
    except UnicodeDecodeError as error:
        reason = f"byte {error.start + 1:,}: must be UTF-8"
    except yaml.reader.ReaderError as error:
        reason = f"character {error.position + 1:,}: {error.reason}"
    except yaml.MarkedYAMLError as error:
        reason = f"{_line(error.problem_mark)}{' '.join(str(error.problem).split())}"
    raise YamlError(f"not readable as YAML: {reason}")


def read_scalar(text: str) -> Any:
    """What text without quotes means."""
    if text in _WORDS:
        return _WORDS[text]
    for pattern, read in _NUMBERS:
        if re.fullmatch(pattern, text):
            return read(text)
    return text


def format_yaml(data: Any) -> str:
    """The text that ``parse_yaml`` reads as ``data``; keys keep their order."""
    return yaml.dump(data, Dumper=_Dumper, sort_keys=False)


class _Dumper(yaml.SafeDumper):
    """PyYAML's safe dumper, which also quotes texts that would be read as numbers."""


def _quote(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    style = None if isinstance(read_scalar(text), str) else "'"
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=style)


_Dumper.add_representer(str, _quote)


@dataclass
class _Node:
    """A value of the file.

    Args:
        value: a scalar, a list or a mapping.
        anchor: the name that aliases have for it.
        size: number of values, with all below it.
        height: levels of lists and mappings, with its own.
        key: of a mapping: the key whose value comes next.
    """

    value: Any
    anchor: str | None = None
    size: int = 1
    height: int = 0
    key: str | None = None


class _Builder:
    """Makes values of a parser's events, without recursion, within the bounds."""

    def __init__(self) -> None:
        self._anchors: dict[str, _Node] = {}
        self._documents = _Node([])
        self._opened = [self._documents]

    def build(self, events: Iterable[yaml.Event]) -> Any:
        """The value of the only document; None if there is none."""
        for event in events:
            tag = getattr(event, "tag", None)
            if tag is not None:
                tag = tag.replace("tag:yaml.org,2002:", "!!")
                raise _error(event, f"tag {shown(tag)}: must be written without tags")
            if isinstance(event, yaml.SequenceStartEvent):
                self._open(_Node([], event.anchor, height=1), event)
            elif isinstance(event, yaml.MappingStartEvent):
                self._open(_Node({}, event.anchor, height=1), event)
            elif isinstance(event, yaml.CollectionEndEvent):
                self._add(_merged(self._opened.pop(), event), event)
            elif isinstance(event, yaml.ScalarEvent):
                value = read_scalar(event.value) if event.implicit[0] else event.value
                self._add(_Node(value, event.anchor), event)
            elif isinstance(event, yaml.AliasEvent):
                if event.anchor not in self._anchors:
                    raise _error(event, f"alias {shown(event.anchor)}: has no anchor before it")
                self._add(self._anchors[event.anchor], event)
            elif isinstance(event, yaml.DocumentStartEvent) and self._documents.value:
                raise _error(event, "must be a single document")
        values = self._documents.value
        return values[0] if values else None

    def _open(self, node: _Node, event: yaml.Event) -> None:
        self._check_depth(node, event)
        self._opened.append(node)

    def _add(self, node: _Node, event: yaml.Event) -> None:
        """Add an item, a key, or a key's value to the innermost list or mapping."""
        self._check_depth(node, event)
        if node.anchor is not None:
            self._anchors[node.anchor] = node
        parent = self._opened[-1]
        parent.height = max(parent.height, node.height + 1)
        parent.size += node.size
        if parent.size > MAX_VALUES:
            raise _error(event, f"must have at most {MAX_VALUES:,} values, those of aliases too")
        if isinstance(parent.value, list):
            parent.value.append(node.value)
        elif parent.key is not None:
            parent.value[parent.key] = node.value
            parent.key = None
        elif not isinstance(node.value, str):
            raise _error(event, f"key {shown(node.value)}: must be text")
        elif node.value in parent.value:
            raise _error(event, f"key {shown(node.value)} is written twice")
        else:
            parent.key = node.value

    def _check_depth(self, node: _Node, event: yaml.Event) -> None:
        if len(self._opened) - 1 + node.height > MAX_DEPTH:
            raise _error(event, f"must be nested at most {MAX_DEPTH} levels deep")


def _merged(node: _Node, event: yaml.Event) -> _Node:
    """The same; a merge key of a mapping becomes the entries of what it names."""
    if isinstance(node.value, dict) and _MERGE in node.value:
        named = node.value.pop(_MERGE)
        sources = named if isinstance(named, list) else [named]
        if not all(isinstance(source, dict) for source in sources):
            raise _error(event, f"{_MERGE}: must be a mapping or a list of mappings")
        merged: dict[str, Any] = {}
        for source in reversed(sources):
            merged.update(source)
        node.value = merged | node.value
    return node


def _error(event: yaml.Event, problem: str) -> YamlError:
    return YamlError(f"not readable as YAML: {_line(event.start_mark)}{problem}")


def _line(mark: Any) -> str:
    return "" if mark is None else f"line {mark.line + 1:,}: "
