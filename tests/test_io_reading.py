"""Text, JSON and YAML of users: what is read, and the one line that says what is wrong."""

import pytest
import yaml

from omniocc.errors import DataError
from omniocc.io import MOST_BYTES, number_of, parse_json, parse_yaml, read_short_text, read_yaml, text_of, twice

LAUGHS = "a0: &a0 [x, x, x]\n" + "".join(f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 12))
MERGED = "a0: &a0 {x: 1}\n" + "".join(f"a{k}: &a{k}\n  <<: [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 12))
LONG = f"a: &a {'x' * 100_000}\nb: [{', '.join(['*a'] * 1000)}]"
DEEP = "a0: &a0 [x]\n" + "".join(f"a{k}: &a{k} [*a{k - 1}]\n" for k in range(1, 990))


@pytest.mark.parametrize(
    ("text", "content"),
    [
        ("a: 1\nb: {a: 2, c: [1, {a: 3}]}", {"a": 1, "b": {"a": 2, "c": [1, {"a": 3}]}}),
        (
            "lens: &lens {f: 1, k: 2}\nfront: {<<: *lens, k: 3}\nrear: *lens",
            {"lens": {"f": 1, "k": 2}, "front": {"f": 1, "k": 3}, "rear": {"f": 1, "k": 2}},
        ),
        ("top: {deep: &b {<<: {x: 1}, x: 2}}\nc: {<<: *b}", {"top": {"deep": {"x": 2}}, "c": {"x": 2}}),
        ("%YAML:1.0\n---\nm: !!opencv-matrix\n   rows: 1\n   data: [ 1. ]", {"m": {"rows": 1, "data": [1.0]}}),
        ("", None),
        ("[" * 100 + "]" * 100, yaml.safe_load("[" * 100 + "]" * 100)),
    ],
)
def test_plain_yaml_is_read(text, content):
    assert parse_yaml(text) == content


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: 1\nb: 2\na: 3", "line 3: the key 'a' is in line 1 already; keep one"),
        ("cameras:\n  - {front: {width: 1, width: 2}}", "line 2: the key 'width' is in line 2 already"),
        ("1: x\n0x1: y", "line 2: the key 1 is in line 1 already"),
        ("x: 1\n<<: {a: 1}\n<<: {b: 1}", "line 3: the key '<<' is in line 2 already"),
        ("%YAML:1.0\n---\na: 1\na: 2", "line 4: the key 'a' is in line 3 already"),
        ("[" * 200_000, "line 1: it is nested in more than 100 levels"),
        ("".join(f"{' ' * k}a:\n" for k in range(1000)), "line 101: it is nested in more than 100 levels"),
        (LAUGHS, "it holds more than 500,000 values"),
        (MERGED, "it holds more than 500,000 values"),
        (LONG, "it holds more than 500,000 values"),
        (DEEP, "line 100: it is nested in more than 100 levels"),
        (f"a: 1\nb: 0x{'f' * 5000}", f"line 2: '0x{'f' * 37} ... {'f' * 39}' is no int"),
        ("a: &a [1, *a]", "line 1: '*a' stands in itself"),
        ("a: 1\nb: !!python/object/apply:os.system [ls]", "line 2: the tag 'tag:yaml.org,2002:python/object/apply:"),
        ("a: !own 1", "line 1: the tag '!own' is none of plain data"),
        ("date: 2024-13-45", "line 1: '2024-13-45' is no timestamp"),
        ("on: !!bool maybe", "line 1: 'maybe' is no bool"),
        ("a: [1, 2", "line 2: while parsing a flow sequence"),
        ("? [1, 2]\n: 3", "line 1: while constructing a mapping, found unhashable key"),
        ("a: \x01", "control characters are not allowed"),
    ],
)
def test_other_yaml_gets_one_line(text, message):
    with pytest.raises(ValueError, match=r"^the file is not valid YAML: ") as caught:
        parse_yaml(text)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_files_of_yaml_are_named(tmp_path):
    path = tmp_path / "some.yaml"
    with pytest.raises(DataError, match=r"some\.yaml: the file is missing"):
        read_yaml(path)
    path.write_bytes(b"\xef\xbb\xbfa: 1\r\n")
    assert read_yaml(path) == {"a": 1}
    with path.open("wb") as file:
        file.truncate(100 << 20)
    with pytest.raises(DataError, match=r"some\.yaml: it has more than 16 MiB; is it the right file\?"):
        read_yaml(path)
    path.write_bytes(b" " * MOST_BYTES)
    assert len(read_short_text(path)) == MOST_BYTES


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\x89PNG\r\n\x1a\n", "line 1 holds the byte 0x89"),
        ("a: 1".encode("utf-16"), "line 1 holds the byte 0xff"),
        ("# Straße".encode("latin-1"), "line 1 holds the byte 0xdf"),
        (b"a: 1\nb: 2\nc\0", "line 3 holds the byte 0x00"),
    ],
)
def test_bytes_that_are_no_text_are_named(content, message):
    with pytest.raises(ValueError, match=f"^it is no text in UTF-8: {message}$"):
        text_of(content)
    assert text_of("\ufeffStraße".encode()) == "Straße"


def test_json_has_every_key_once():
    assert parse_json('{"a": [{"b": 1}, {"b": 2}]}') == {"a": [{"b": 1}, {"b": 2}]}
    with pytest.raises(ValueError, match=r"^the key 'b' stands twice in one object; keep one$"):
        parse_json('{"a": [{"b": 1, "c": 2, "b": 1}]}')
    with pytest.raises(ValueError, match="nested too deeply"):
        parse_json("[" * 200_000)


def test_values_keep_their_types():
    assert [type(value) for value in parse_yaml("[1, true, 0x10, null]")] == [int, bool, int, type(None)]


@pytest.mark.parametrize(
    ("text", "number"), [("1", 1.0), (" -2.5e-3 ", -2.5e-3), ("+.5", 0.5), ("7.", 7.0), ("1E5", 1e5)]
)
def test_numbers_of_text(text, number):
    assert number_of(text) == number


@pytest.mark.parametrize(
    "text",
    ["1_0", "١٢", "nan", "1e400", "1" * 5000, "1,5", ""],
)
def test_what_python_alone_takes_for_a_number_is_refused_in_few_characters(text):
    with pytest.raises(ValueError, match="' is no finite number") as caught:
        number_of(text)
    assert len(str(caught.value)) < 120


def test_the_first_name_that_stands_twice():
    assert twice(["a", "b", "c", "b", "a"]) == "b"
    assert twice([3, 0, 1, 0]) == 0
    assert twice([]) is None
