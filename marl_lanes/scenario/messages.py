"""Messages about fields that are not valid: field, value, what is allowed."""

import re
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from reprlib import Repr
from types import UnionType
from typing import TYPE_CHECKING, Any, Union, get_args, get_origin

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError

MAX_SHOWN = 80
"""[characters] of a value in a message."""

MAX_NAME = 200
"""[characters] of a name or a path in a message."""

MAX_PROBLEMS = 10
"""Problems of one message."""

_WORDS = (
    (r"^Value error, ", ""),
    (r"^\w+ should", "must"),
    (r"a valid (tuple|list)", "a list"),
    (r"a valid dictionary", "a mapping"),
    (r"a valid string", "text"),
    (r" after validation", ""),
)
"""What pydantic says, as a pattern, and how a message says it."""

_SHORT = Repr()
_SHORT.maxstring = _SHORT.maxother = _SHORT.maxlong = MAX_SHOWN


def explain(error: "ValidationError", kind: "type[BaseModel]") -> str:
    """The problems in one line, each with field, value and what is allowed; the first of many.

    Args:
        error: the error of a validation.
        kind: the model that was validated. Validators of a whole section name the field themselves.
    """
    problems = error.errors(include_url=False)
    lines = []
    for problem in problems[:MAX_PROBLEMS]:
        path = problem["loc"]
        location = ".".join(shown_name(part) for part in path)
        message = problem["msg"]
        for pydantics, ours in _WORDS:
            message = re.sub(pydantics, ours, message)
        if problem["type"] == "extra_forbidden":
            lines.append(unknown_key(location, fields_at(kind, path[:-1]) or ()))
        elif problem["type"] == "missing":
            lines.append(f"{location}: must be given")
        elif problem["type"] == "model_type":
            allowed = ", ".join(fields_at(kind, path) or ())
            lines.append(f"{location} = {shown(problem['input'])}: must be a mapping of {allowed}")
        elif problem["type"] == "value_error" and fields_at(kind, path) is not None:
            lines.append(f"{location}.{message}" if location else message)
        else:
            lines.append(f"{location} = {shown(problem['input'])}: {message}")
    if len(problems) > MAX_PROBLEMS:
        lines.append(f"and {len(problems) - MAX_PROBLEMS:,} more")
    return "; ".join(lines)


def unknown_key(location: str, allowed: Iterable[str]) -> str:
    """The message about an unknown key, with the nearest allowed key and all allowed keys."""
    names = list(allowed)
    near = get_close_matches(location.rpartition(".")[2], names, n=1)
    nearest = f"did you mean {near[0]}? " if near else ""
    return f"{location}: unknown key; {nearest}allowed: {', '.join(names)}"


def fields_at(kind: "type[BaseModel]", path: Sequence[str | int]) -> list[str] | None:
    """The keys of the section at the path; None if there is no section."""
    found: Any = kind
    for part in path:
        if _is_section(found):
            if part not in found.model_fields:
                return None
            found = found.model_fields[str(part)].annotation
        else:
            # dict[str, X] and tuple[X, ...]: the type of every entry.
            inner = get_args(found)
            if not inner:
                return None
            found = inner[1 if get_origin(found) is dict else 0]
        if get_origin(found) in (Union, UnionType):
            # A section, or null.
            found = get_args(found)[0]
    return list(found.model_fields) if _is_section(found) else None


def _is_section(found: Any) -> bool:
    from pydantic import BaseModel

    return isinstance(found, type) and issubclass(found, BaseModel)


def shown(value: object) -> str:
    """A value as a message shows it: its ``repr`` on one line, short however large it is."""
    try:
        text = " ".join(_SHORT.repr(value).split())
    except Exception:  # an object's repr may raise anything
        text = f"<{type(value).__name__}>"
    return text if len(text) <= MAX_SHOWN else f"{text[: MAX_SHOWN - 3]}..."


def shown_name(name: object) -> str:
    """A name or a path as a message shows it: as it is, unless it is long or cannot be printed."""
    text = str(name)
    return text if text.isprintable() and len(text) <= MAX_NAME else shown(text)
