"""YAML files, also hostile ones: plain values, or one line, in bounded time and memory."""

import os
import time
import tracemalloc
from pathlib import Path

import pytest
import yaml
from systems import needs, needs_links

from marl_lanes.scenario import yaml_files
from marl_lanes.scenario.yaml_files import (
    MAX_BYTES,
    MAX_DEPTH,
    MAX_VALUES,
    YamlError,
    format_yaml,
    parse_yaml,
    read_scalar,
    read_yaml,
)


def error_of(text):
    """The message about a text, which is one short line and comes soon."""
    content = text if isinstance(text, bytes) else text.encode()
    begin = time.process_time()
    with pytest.raises(YamlError) as caught:
        parse_yaml(content)
    assert time.process_time() - begin < 5.0
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 250
    return message


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("", None),
        ("~", None),
        ("Null", None),
        ("true", True),
        ("FALSE", False),
        ("0", 0),
        ("-12", -12),
        ("010", 10),
        ("0o17", 15),
        ("0x1F", 31),
        ("1e6", 1e6),
        ("5e-3", 0.005),
        ("+2E1", 20.0),
        ("1.", 1.0),
        (".5", 0.5),
        ("-.Inf", -float("inf")),
        ("yes", "yes"),
        ("1_000", "1_000"),
        ("1:30", "1:30"),
        ("2024-02-31", "2024-02-31"),
        ("=", "="),
        ("0x", "0x"),
        ("1e", "1e"),
        ("9" * 4001, float("inf")),
    ],
)
def test_text_without_quotes_is_read_by_the_core_schema(text, value):
    found = read_scalar(text)
    assert found == value
    assert type(found) is type(value)


def test_nan_is_a_number():
    assert read_scalar(".NaN") != read_scalar(".NaN")


def test_text_in_quotes_stays_text():
    assert parse_yaml(b"['1', \"null\", '']") == ["1", "null", ""]


MERGED = """
base: &base {x: 1, y: 2}
other: &other {y: 3, z: 4}
one: {<<: *base, y: 5}
both:
  <<: [*base, *other]
  w: 6
again: &again {<<: *base}
nested: {<<: *again, x: 7}
"""


def test_merge_keys_give_way_to_keys_of_the_mapping_and_to_each_other():
    read = parse_yaml(MERGED.encode())
    assert read["one"] == {"x": 1, "y": 5}
    assert read["both"] == {"x": 1, "y": 2, "z": 4, "w": 6}
    assert read["nested"] == {"x": 7, "y": 2}
    assert read == yaml.safe_load(MERGED)


def test_what_is_written_is_read_again():
    texts = ["1e6", "0o7", "010", "yes", "null", "", "a: b", "two\nlines", "2024-01-01", "ü\x07"]
    data = {"texts": texts, "numbers": [1, 1e-9, 1e300, True, None], **dict.fromkeys(texts, 0)}
    assert parse_yaml(format_yaml(data).encode()) == data
    assert list(parse_yaml(format_yaml(data).encode())) == list(data)


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("a: }", "line 1: "),
        ("a: b: c", "line 1: mapping values"),
        ("\ta: 1", "line 1: "),
        ("a: 1\nb: *none", "line 2: alias 'none': has no anchor before it"),
        ("a: &a [*a]", "alias 'a': has no anchor before it"),
        ("a: 1\na: 2", "line 2: key 'a' is written twice"),
        ("a: {<<: {b: 1}, <<: {c: 1}}", "key '<<' is written twice"),
        ("<<: 5", "<<: must be a mapping or a list of mappings"),
        ("<<: [{}, 5]", "<<: must be a mapping or a list of mappings"),
        ("a: 1\n---\nb: 2", "line 2: must be a single document"),
        ("1: 2", "key 1: must be text"),
        ("~: 2", "key None: must be text"),
        ("? [1]\n: 2", "key [1]: must be text"),
        ("{{a: 1}: 2}", "key {'a': 1}: must be text"),
        ("a: !!int x", "tag '!!int': must be written without tags"),
        ("a: !!binary aGk=", "tag '!!binary'"),
        ("a: !!timestamp 2024-13-45", "tag '!!timestamp'"),
        ("a: !!python/object/apply:os.getcwd []", "tag '!!python/object/apply:os.getcwd'"),
        ("!mine {a: 1}", "tag '!mine'"),
        ("a: ! 1", "tag '!'"),
        ("a: \0", "character 4: control characters are not allowed"),
        (b"a: \xe9", "byte 4: must be UTF-8"),
        ("a: 1".encode("utf-16"), "byte 1: must be UTF-8"),
    ],
)
def test_what_is_wrong_is_said_with_its_line(text, part):
    assert part in error_of(text)


def test_a_mark_of_byte_order_is_no_content():
    assert parse_yaml(b"\xef\xbb\xbfa: 1") == {"a": 1}


@pytest.mark.parametrize("text", ["", "# nothing\n", "---\n"])
def test_a_file_may_be_empty(text):
    assert parse_yaml(text.encode()) is None


def bomb(width, height):
    """Lists of aliases to lists of aliases: ``width ** height`` values in a few lines."""
    lines = ["a0: &a0 x"]
    for level in range(1, height):
        aliases = ", ".join([f"*a{level - 1}"] * width)
        lines.append(f"a{level}: &a{level} [{aliases}]")
    return "\n".join(lines)


TOO_MANY = f"must have at most {MAX_VALUES:,} values"
TOO_DEEP = f"must be nested at most {MAX_DEPTH} levels deep"
TOO_DEEP_FOR_YAML = "exceeded maximum nesting depth"
"""What a newer PyYAML says of still deeper ones."""


@pytest.mark.parametrize(
    ("text", "part"),
    [
        (bomb(9, 12), TOO_MANY),
        (bomb(2, 30), TOO_MANY),
        (bomb(1, 40), TOO_DEEP),
        ("- 1\n" * (MAX_VALUES + 1), TOO_MANY),
        ("a: &a {b: 1}\nc: {<<: [" + "*a, " * MAX_VALUES + "]}", TOO_MANY),
        ("[" * 100_000, TOO_DEEP),
        ("{a: " * 100_000, TOO_DEEP),
        ("- " * 100_000, TOO_DEEP),
        ("? " * 100_000, TOO_DEEP),
        ("x" * (MAX_BYTES + 1), f"must have at most {MAX_BYTES:,} bytes"),
        ("x" * 1_000_000 + ": 1", "line 1: "),
        ("? " + "x" * 1_000_000 + "\n: 1\n? " + "x" * 1_000_000 + "\n: 1", "bytes"),
    ],
    ids=range(12),
)
def test_absurd_sizes_are_refused(text, part):
    error = error_of(text)
    assert part in error or (part == TOO_DEEP and TOO_DEEP_FOR_YAML in error)


def test_many_keys_and_merged_mappings_take_a_time_in_proportion():
    keys = "".join(f"k{key}: 1\n" for key in range(40_000))
    merged = "".join(f"- &m{key} {{k{key}: 1}}\n" for key in range(8000))
    aliases = ", ".join(f"*m{key}" for key in range(8000))
    begin = time.process_time()
    assert len(parse_yaml(keys.encode())) == 40_000
    assert len(parse_yaml(f"a:\n{merged}b: {{<<: [{aliases}]}}".encode())["b"]) == 8000
    assert time.process_time() - begin < 5.0


def test_the_depth_that_is_allowed_is_read():
    text = "[" * MAX_DEPTH + "]" * MAX_DEPTH
    assert parse_yaml(text.encode()) is not None


def test_the_parser_without_c_reads_the_same(monkeypatch):
    monkeypatch.setattr(yaml_files, "_Loader", yaml.SafeLoader)
    assert parse_yaml(MERGED.encode()) == yaml.safe_load(MERGED)
    assert "line 2: key 'a' is written twice" in error_of("a: 1\na: 2")
    assert "tag '!!int'" in error_of("a: !!int 1")
    assert "control characters" in error_of("a: \0") or "special characters" in error_of("a: \0")
    assert TOO_DEEP in error_of("[" * 2000)


@needs("mkfifo")
@needs_links
def test_only_regular_files_are_read(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "circle").symlink_to("circle")
    with (tmp_path / "large").open("wb") as file:
        file.truncate(64 * MAX_BYTES)
    (tmp_path / "good.yaml").write_text("a: 1\n", encoding="utf-8")
    (tmp_path / "link").symlink_to("good.yaml")
    assert read_yaml(tmp_path / "link") == {"a": 1}
    wrong = {
        ".": "must be a regular file",
        "pipe": "must be a regular file",
        "circle": "Too many levels",
        "large": f"must have at most {MAX_BYTES:,} bytes",
        "absent": "No such file",
        "good.yaml/below": "Not a directory",
        "x" * 5000: "too long",
        "with\0": "no file can have this name",
    }
    tracemalloc.start()
    for name, part in wrong.items():
        with pytest.raises(YamlError, match=f"^cannot be read: .*{part}"):
            read_yaml(tmp_path / name)
    assert tracemalloc.get_traced_memory()[1] < 8 * MAX_BYTES
    tracemalloc.stop()
    with pytest.raises(YamlError, match="must be a regular file"):
        read_yaml(Path("/dev/zero"))
