"""An SVG figure as a part of a page: in the page's colours, without anything that runs or loads."""

import re
from pathlib import Path
from xml.etree import ElementTree

from marl_lanes.colours import LIGHT
from marl_lanes.report.run_files import ReportError

_TAGS = {"svg", "g", "path", "use", "defs", "clipPath", "rect", "text", "tspan", "image"}
"""What a figure is drawn with. All else is left out: scripts, links, styles of the whole page."""

_LOOK = r"(?:fill|stroke)(?:-[a-z]+)?|text-anchor|opacity"
_ATTRIBUTES = re.compile(
    "id|d|x|y|width|height|transform|viewBox|style|clip-path|href|preserveAspectRatio|" + _LOOK
)
_PROPERTIES = re.compile("font(?:-[a-z]+)?|" + _LOOK)
"""Of a style. Others could move a part of the figure over the page."""

_OWN_REFERENCE = re.compile(r"url\(#([\w.-]+)\)")
_IMAGE = re.compile(r"data:image/png;base64,[A-Za-z0-9+/=\s]*")

VARIABLES = {
    name: colour
    for name, colour in LIGHT.variables().items()
    if name in ("background", "text", "grid") or name.startswith("series-")
}
"""By name of the page's CSS variable: the colour of a figure that it takes the place of."""

_NAMES = {colour: f"var(--{name})" for name, colour in VARIABLES.items()}
_COLOUR = re.compile("|".join(_NAMES))


def inline_svg(path: Path, prefix: str, label: str) -> str:
    """The figure as an element of HTML.

    Args:
        path: of the SVG file.
        prefix: goes in front of its ids, so that those of several figures differ.
        label: what it shows, for those who do not see it.

    Raises:
        ReportError: the file cannot be read, or is no SVG.
    """
    try:
        # expat reads no external entities and limits the growth of internal ones.
        root = ElementTree.parse(path).getroot()  # noqa: S314
    except FileNotFoundError:
        raise ReportError(f"{path}: is missing; resume={path.parents[1]} draws it") from None
    except (OSError, ElementTree.ParseError) as error:
        raise ReportError(f"{path}: cannot be read as SVG: {error}") from None
    if _local(root.tag) != "svg":
        raise ReportError(f"{path}: cannot be read as SVG: it is <{_local(root.tag)}>")
    clean = _clean(root, f"{prefix}-")
    # The page gives it the size; the drawing's own is in the view box.
    for name in ("width", "height"):
        clean.attrib.pop(name, None)
    clean.attrib |= {"role": "img", "aria-label": label}
    return ElementTree.tostring(clean, encoding="unicode", short_empty_elements=False)


def _local(name: str) -> str:
    return name.rpartition("}")[2]


def _clean(element: ElementTree.Element, prefix: str) -> ElementTree.Element:
    """A copy with what is allowed, in the page's colours."""
    clean = ElementTree.Element(_local(element.tag))
    clean.text = element.text
    for name, value in element.attrib.items():
        kept = _clean_value(_local(name), value, prefix)
        if kept is not None:
            clean.set(_local(name), kept)
    for child in element:
        if isinstance(child.tag, str) and _local(child.tag) in _TAGS:
            clean.append(_clean(child, prefix))
            clean[-1].tail = child.tail
    return clean


def _clean_value(name: str, value: str, prefix: str) -> str | None:
    """The attribute's value on the page; None if it is left out."""
    if not _ATTRIBUTES.fullmatch(name):
        return None
    if name == "id":
        return prefix + value
    if name == "href":
        if value.startswith("#"):
            return f"#{prefix}{value[1:]}"
        return value if _IMAGE.fullmatch(value) else None
    if name == "style":
        declarations = (one for one in value.split(";") if one.strip())
        if not all(_PROPERTIES.fullmatch(one.partition(":")[0].strip()) for one in declarations):
            return None
    value = _OWN_REFERENCE.sub(rf"url(#{prefix}\1)", value)
    # Names of functions are the same in capitals.
    if "url(" in value.replace(f"url(#{prefix}", "").lower() or "\\" in value or "@" in value:
        return None
    return _COLOUR.sub(lambda match: _NAMES[match[0]], value)
