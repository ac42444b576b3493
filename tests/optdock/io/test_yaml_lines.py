import contextlib
from datetime import date

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.errors import InvalidFile
from optdock.io.yaml_lines import load_yaml


@pytest.fixture
def document(tmp_path):
    def read(text):
        path = tmp_path / "bay.yaml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return load_yaml(path)

    return read


TEXT = """# a comment
robot:
  limits: {max_speed: 0.5,
           max_jerk: 2.0}
obstacles:
  - [[1, 2],
     [3, 4]]
"""


def test_every_key_and_entry_knows_its_line(document):
    bay = document(TEXT)
    assert bay.value == {"robot": {"limits": {"max_speed": 0.5, "max_jerk": 2.0}}, "obstacles": [[[1, 2], [3, 4]]]}
    lines = {
        ("robot",): 2,
        ("robot", "limits"): 3,
        ("robot", "limits", "max_speed"): 3,
        ("robot", "limits", "max_jerk"): 4,
        ("obstacles",): 5,
        ("obstacles", 0): 6,
        ("obstacles", 0, 1): 7,
        ("obstacles", 0, 1, 1): 7,
    }
    assert {keys: bay.line_of(keys) for keys in lines} == lines


def test_a_missing_key_stands_where_its_parent_does(document):
    bay = document(TEXT)
    assert bay.line_of(("robot", "limits", "max_yaw_rate")) == 3
    assert bay.line_of(("dock", "pose")) == 1


def test_faults_name_file_line_and_key(document):
    bay = document(TEXT)
    assert bay.fault(("robot", "limits", "max_jerk"), "is low").endswith("bay.yaml:4: robot.limits.max_jerk: is low")
    assert bay.fault((), "is odd").endswith("bay.yaml: is odd")


@pytest.mark.parametrize(
    ("text", "value"),
    [("1e-3", 1e-3), ("1.5e3", 1500.0), (".5e2", 50.0), ("-1E5", -1e5), ("1_0e1", 100.0), ("2.5", 2.5)],
)
def test_exponents_make_numbers(document, text, value):
    found = document(f"a: {text}").value["a"]
    assert isinstance(found, float)
    assert found == value


@pytest.mark.parametrize("text", ["e3", "1e", "1e3x", "0x1e-3"])
def test_what_only_looks_like_an_exponent_stays_text(document, text):
    assert document(f"a: {text}").value["a"] == text


@settings(max_examples=25)
@given(st.floats(allow_nan=False, allow_infinity=False))
def test_every_float_survives(tmp_path_factory, value):
    path = tmp_path_factory.mktemp("yaml") / "a.yaml"
    path.write_text(f"a: {value!r}")
    assert load_yaml(path).value == {"a": value}


def test_all_repeated_keys_are_listed(document):
    with pytest.raises(InvalidFile) as error:
        document("a: 1\nb: {c: 1, c: 2}\na: 3\na: 4")
    lines = str(error.value).splitlines()
    assert [line.split(": ", 1)[1] for line in lines] == [
        "a: is repeated; first in line 1",
        "a: is repeated; first in line 1",
        "c: is repeated; first in line 2",
    ]
    assert [line.split(":")[1] for line in lines] == ["3", "4", "2"]


def test_anchors_and_merges_work(document):
    bay = document("a: &a {x: 1, y: 2}\nb: {<<: *a, y: 3}\nc: *a")
    assert bay.value == {"a": {"x": 1, "y": 2}, "b": {"x": 1, "y": 3}, "c": {"x": 1, "y": 2}}
    assert bay.line_of(("b", "y")) == 2
    assert bay.line_of(("b", "x")) == 1


def test_other_plain_values_are_kept(document):
    assert document("a: 2026-11-21\nb: ~\nc: yes\n1: x").value == {
        "a": date(2026, 11, 21),
        "b": None,
        "c": True,
        1: "x",
    }


def test_a_byte_order_mark_is_ignored(document):
    assert document(b"\xef\xbb\xbfa: 1").value == {"a": 1}


BOMB = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]\n" for n in range(1, 9)
)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("# only a comment\n", "is empty"),
        ("a: [1, 2\n", ":2: is not valid YAML"),
        ("a: b: c", ":1: is not valid YAML"),
        ("a: *nope", ":1: is not valid YAML: found undefined alias"),
        (
            "a: 1\n---\nb: 2",
            ":2: is not valid YAML: expected a single document in the stream, but found another document",
        ),
        ("a: !!python/object/apply:os.getcwd []", ":1: is not valid YAML"),
        ("a:\n\tb: 1", ":2: is not valid YAML: a tab where only spaces are allowed; indent with spaces"),
        ("a:\n  b: 1\n\tc: 2", ":3: is not valid YAML: a tab"),
        ("a: \u00e4\U0001f916\nb: @x", ":2: is not valid YAML: found character"),
        (b"a: \xff", "cannot be read as UTF-8 text"),
        (b"a: \x01", "control characters"),
        ("on: 1", ":1: a key must be text or a whole number, got 'on'"),
        ("a: 1\n1.5: 2", ":2: a key must be text or a whole number, got '1.5'"),
        ("? [1, 2]\n: 3", ":1: a key must be text or a whole number, got a collection"),
        ("a: 1\nb: 2026-13-45", ":2: '2026-13-45' cannot be read: month"),
        ("a: &x [*x]", ":1: is nested too deeply, or contains itself"),
        (BOMB, "repeats too many aliases"),
        ("[" * 5000, "is nested too deeply"),
        ("[" * 900 + "]" * 900, "nested too deeply"),
        ("0x_: 1", ":1: key '0x_' cannot be read"),
        ("a: 0x_", ":1: '0x_' cannot be read"),
        ("a: !!int ''", ":1: '' cannot be read"),
        ("a: !!timestamp x", ":1: 'x' cannot be read"),
    ],
)
def test_unreadable_files_are_named(document, text, message):
    with pytest.raises(InvalidFile) as error:
        document(text)
    assert "bay.yaml" in str(error.value)
    assert message in str(error.value)


def test_missing_files_and_folders_are_named(tmp_path):
    with pytest.raises(InvalidFile, match=r"none\.yaml: cannot be read: No such file"):
        load_yaml(tmp_path / "none.yaml")
    with pytest.raises(InvalidFile, match="cannot be read"):
        load_yaml(tmp_path)
    with pytest.raises(InvalidFile, match="cannot be read"):
        load_yaml("a\0b.yaml")


@settings(max_examples=25)
@given(st.binary(max_size=60))
def test_no_bytes_escape_as_another_error(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("yaml") / "a.yaml"
    path.write_bytes(content)
    with contextlib.suppress(InvalidFile):
        assert load_yaml(path).path == path


WORDS = [
    "a",
    "1",
    ": ",
    "- ",
    "\n",
    "  ",
    "[",
    "]",
    "{",
    "}",
    "&a ",
    "*a",
    "!!int ",
    "!!timestamp ",
    "<<: ",
    "'",
    "0x",
    "? ",
]


@settings(max_examples=25)
@given(st.lists(st.sampled_from(WORDS), max_size=12))
def test_no_yaml_like_text_escapes_as_another_error(tmp_path_factory, words):
    path = tmp_path_factory.mktemp("yaml") / "a.yaml"
    path.write_text("".join(words))
    with contextlib.suppress(InvalidFile):
        assert load_yaml(path).path == path
