import math

import pytest

from marl_lanes.rendering.options import ViewOptions


def test_the_defaults():
    options = ViewOptions.make()
    assert options == ViewOptions((1280, 720), 140.0, None, 1.0)
    assert ViewOptions.make(options) is options


def test_a_mapping_sets_some_fields():
    options = ViewOptions.make({"size": [640, 360], "span": 200, "follow": "changer_3"})
    assert options == ViewOptions((640, 360), 200.0, "changer_3")
    assert options.followed_command == 3
    assert ViewOptions(follow=17).followed_command is None


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("size", (319, 180)),
        ("size", (320, 178)),
        ("size", (641, 360)),
        ("size", (3842, 2160)),
        ("size", (640.0, 360.0)),
        ("size", (640,)),
        ("size", 640),
        ("size", "640x360"),
        ("span", 19.0),
        ("span", 2001.0),
        ("span", math.nan),
        ("span", "100"),
        ("span", True),
        ("follow", "changer"),
        ("follow", "changer_-1"),
        ("follow", "changer_03"),
        ("follow", -1),
        ("follow", True),
        ("follow", 1.0),
        ("speed", 0.0),
        ("speed", math.inf),
        ("speed", None),
    ],
)
def test_a_field_that_is_not_valid_is_named(field, value):
    with pytest.raises(ValueError, match=rf"^{field} = .*: must be "):
        ViewOptions.make({field: value})


@pytest.mark.parametrize("size", [(320, 180), (3840, 2160), (320, 2160), (3840, 180), (1080, 1920)])
def test_sizes_within_the_limits(size):
    assert ViewOptions(size=size).size == size


def test_an_unknown_option_is_refused():
    with pytest.raises(ValueError, match=r"^zoom: is no option of a view: size, span, "):
        ViewOptions.make({"zoom": 2.0})
    with pytest.raises(ValueError, match="must be ViewOptions, a mapping or None"):
        ViewOptions.make([("span", 100.0)])
