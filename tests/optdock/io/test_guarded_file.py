"""Whatever a name leads to and a file holds, reading it ends soon, in little memory, with a value or a named error."""

import json
import math
import os
import socket
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import pytest
from PIL import Image

from optdock.config import load_scenario
from optdock.errors import InvalidFile
from optdock.executor.log import read_log
from optdock.io.guarded_file import MostBytes, check_regular, parse_json, read_bytes, read_text
from optdock.io.maps import load_map
from optdock.io.plan_file import load_plan
from optdock.io.quoting import shown
from optdock.io.run_file import load_run
from optdock.nav2.docks import load_dock_database
from optdock.nav2.params import load_nav2_params
from optdock.ros.bag import open_bag


def load_bag(path):
    with open_bag(path):
        pass


def load_image(path):
    described = path.parent / "described.yaml"
    described.write_text(
        f"image: {path}\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    load_map(described)


READERS = [
    load_scenario,
    load_plan,
    load_run,
    read_log,
    load_map,
    load_image,
    load_dock_database,
    load_nav2_params,
    load_bag,
]


@pytest.fixture
def strange(tmp_path):
    """Names that lead to what is not a regular file, or to a very large one."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to("loop")
    with socket.socket(socket.AF_UNIX) as held:
        held.bind(os.path.relpath(tmp_path / "socket"))
        yield tmp_path


@pytest.mark.parametrize("load", READERS)
def test_only_regular_files_are_opened(strange, load):
    """A pipe without a writer would be waited for without end."""
    for name, said in (
        (strange / "pipe", "pipe: cannot be read: is a pipe, not a regular file"),
        (strange / "socket", "socket: cannot be read: is a socket, not a regular file"),
        ("/dev/zero", "/dev/zero: cannot be read: is a device, not a regular file"),
        (strange / "loop", "loop: cannot be read: Too many levels of symbolic links"),
        (strange / "none", "none: cannot be read: No such file or directory"),
        (strange / ("x" * 3000), "xxx: cannot be read: File name too long"),
        (strange / "a\0b", "cannot be read: embedded null"),
    ):
        if load is load_image and "\0" in str(name):
            continue  # YAML cannot name it
        with pytest.raises(InvalidFile) as refused:
            load(strange / name)
        assert said in str(refused.value)
        assert len(str(refused.value)) < 700


@pytest.mark.parametrize("load", [reader for reader in READERS if reader is not load_bag])
def test_a_file_beyond_its_size_is_refused_unread(tmp_path, load):
    with (tmp_path / "sparse").open("wb") as file:
        file.truncate(2**30)
    with pytest.raises(InvalidFile, match=r"sparse: cannot be read: has more than the \d+ bytes"):
        load(tmp_path / "sparse")


def test_a_file_that_says_it_is_empty_is_read_no_further_than_its_size_allows():
    assert Path("/proc/self/maps").stat().st_size == 0
    with pytest.raises(InvalidFile, match="more than the 100 bytes"):
        read_bytes(Path("/proc/self/maps"), 100)
    with pytest.raises(InvalidFile, match="/proc/self/mem: cannot be read: Input/output error"):
        read_text(Path("/proc/self/mem"), 100)


def test_a_name_that_leads_elsewhere_after_it_was_asked_is_refused(tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "pipe")
    regular = tmp_path / "plan.json"
    regular.write_text("{}")
    true_open = os.open
    monkeypatch.setattr(os, "open", lambda _, flags: true_open(tmp_path / "pipe", flags))
    with pytest.raises(InvalidFile, match=r"plan\.json: cannot be read: is a pipe"):
        read_bytes(regular, 10)


def test_text_of_another_encoding_is_named(tmp_path):
    (tmp_path / "a").write_bytes("format: x".encode("utf-16"))
    with pytest.raises(InvalidFile, match="a: cannot be read as UTF-8 text: byte 0: .*it looks like UTF-16"):
        read_text(tmp_path / "a", MostBytes.YAML)
    (tmp_path / "a").write_bytes(b"\xef\xbb\xbfab")
    assert read_text(tmp_path / "a", MostBytes.YAML) == "ab"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"a": 1e999}', "1e999 is too large"),
        ("[1" + "0" * 400 + ".0]", "is too large"),
        ("[NaN]", "NaN is not JSON"),
        ("[1" + "0" * 5000 + "]", "4300"),
        ("[" * 1_000_000, "nested too deeply"),
        ("[" + "0," * 2_000_001 + "0]", "holds more than 2000000 values"),
        ("[" + "{}," * 200_001 + "0]", "or 200000 objects"),
        ('{"path": 1, "a": {"path": 2}, "path": 3}', "key 'path' is repeated"),
        ('[{"a": {"b": 1, "b": 1}}]', "key 'b' is repeated"),
        ('["\\ud800"]', "unpaired surrogate"),
        ('{"\\uDFFF": 1}', "unpaired surrogate"),
    ],
)
def test_json_that_would_expand_is_refused(text, said):
    with pytest.raises(ValueError, match=said):
        parse_json(text)


def test_json_values_read_as_they_are():
    assert parse_json('["\\ud83d\\ude00", "\\u00e9"]') == ["\U0001f600", "\u00e9"]
    assert parse_json('[{"a": 1}, {"a": 1}]') == [{"a": 1}, {"a": 1}]
    assert parse_json('{"a": [1, -2.5e-3, 1e308, 0.1]}') == {"a": [1, -2.5e-3, 1e308, 0.1]}


# The worst that a few bytes can ask for, read in a process of its own so that its memory can be measured.

_MEASURED = """
import json, resource, sys, time
from pathlib import Path
sys.path.insert(0, sys.argv[1])
import test_guarded_file
from optdock.errors import InvalidFile
resource.setrlimit(resource.RLIMIT_AS, (3 << 30, 3 << 30))
resource.setrlimit(resource.RLIMIT_CPU, (60, 60))
found = {}
for name, reader, file in json.loads(sys.argv[2]):
    began, said = time.process_time(), ""
    try:
        getattr(test_guarded_file, reader)(Path(file))
    except InvalidFile as error:
        said = str(error)
    # Not ru_maxrss, which begins with what the process had that started this one.
    peak = next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmHWM")) // 1024
    found[name] = [time.process_time() - began, peak, said]
print(json.dumps(found))
"""


def measured(jobs):
    """Of every job its seconds of CPU, the peak of memory in MB until then, and what was said."""
    command = [sys.executable, "-c", _MEASURED, str(Path(__file__).parent), json.dumps(jobs)]
    return json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def merge_bomb(levels):
    text = "{x: 1}"
    for level in range(levels):
        text = f"{{<<: [&a{level} {text}, {', '.join([f'*a{level}'] * 9)}]}}"
    return f"format: optdock-scenario/1\nrobot: {text}\n".encode()


def png(width, height, data):
    def chunk(kind, content):
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


RING = ", ".join(f"[{math.cos(i / 1600):.5f}, {math.sin(i / 1600):.5f}]" for i in range(10_000))
BOMBS = {
    "merge keys": (load_scenario, merge_bomb(7), "repeats too many aliases"),
    "aliases": (
        load_nav2_params,
        b"a0: &a0 [x, x]\n" + b"".join(b"a%d: &a%d [*a%d, *a%d]\n" % (n, n, n - 1, n - 1) for n in range(1, 60)),
        "repeats too many aliases",
    ),
    "brackets of YAML": (load_dock_database, b"[" * 1_000_000, "nested too deeply"),
    "values of YAML": (load_nav2_params, b"a: [" + b"1, " * 1_000_000 + b"1]", "holds more than 50000 values"),
    "base 60": (load_scenario, b"time_budget: " + b":".join([b"1"] * 20_000), "more than 1000 characters"),
    "hexadecimal": (load_scenario, b"time_budget: 0x" + b"f" * 100_000, "more than 1000 characters"),
    "vertices": (load_scenario, f"obstacles: [[{RING}]]\nrobot: 1\n".encode(), "must have at most 300 vertices"),
    "polygons": (
        load_scenario,
        b"obstacles: [" + b"[[0, 0], [1, 0], [1, 1]], " * 4000 + b"]\nrobot: 1\n",
        "must be at most 2000 polygons",
    ),
    "keys": (load_scenario, b"robot: 1\n" + b"".join(b"abcdefgh%d: 1\n" % i for i in range(20_000)), "more faults"),
    "brackets of JSON": (load_plan, b"[" * 1_000_000, "nested too deeply"),
    "values of JSON": (load_plan, b"[" + b"0," * 3_000_000 + b"0]", "holds more than"),
    "decompression bomb": (load_image, png(60_000, 60_000, zlib.compress(bytes(1000))), "25000000"),
    "header of a PGM": (load_image, b"P5 4000000000 4000000000 255\n" + bytes(100), "25000000"),
    "digits of a PGM": (load_image, b"P2 5000 5000 255\n" + b"0 " * 3_000_000, "2000000 pixels"),
    "a program": (load_image, b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 10 10\nshowpage\n", "is not an image"),
}


LARGEST = {"L": "png", "P": "gif", "I;16": "png", "RGBA": "png"}  # of 25 million pixels, by mode


@pytest.fixture(scope="module")
def exploded(tmp_path_factory):
    """What became of every bomb, and of the largest maps."""
    folder, jobs = tmp_path_factory.mktemp("bombs"), []
    for mode, suffix in LARGEST.items():
        file = folder / f"{mode[0]}.{suffix}"
        Image.new(mode, (5000, 5000)).save(file, **({"compress_level": 1} if suffix == "png" else {}))
        jobs.append((mode, "load_image", str(file)))
    for name, (load, content, _) in BOMBS.items():
        (folder / name).write_bytes(content)
        jobs.append((name, load.__name__, str(folder / name)))
    return measured(jobs)


@pytest.mark.parametrize("name", BOMBS)
def test_no_file_takes_more_than_a_second_or_half_a_gigabyte(exploded, name):
    seconds, megabytes, message = exploded[name]
    assert BOMBS[name][2] in message
    assert len(message) < 20 * 500
    assert seconds < 1.0
    assert megabytes < 500


@pytest.mark.parametrize("mode", LARGEST)
def test_the_largest_map_takes_half_a_gigabyte_at_most(exploded, mode):
    _, megabytes, message = exploded[mode]
    assert message == ""
    assert megabytes < 500


def test_a_map_that_names_another_file_does_not_print_it(tmp_path):
    secret = "root:x:0:0:secret words of nobody's business\nuser:y:1:1:more\n"
    (tmp_path / "secret").write_text(secret)
    (tmp_path / "bay.yaml").write_text("format: optdock-scenario/1\nmap: secret\nrobot: {radius: 1}\n")
    with pytest.raises(InvalidFile) as refused:
        load_scenario(tmp_path / "bay.yaml")
    said = next(line for line in str(refused.value).splitlines() if "map: " in line)
    assert said.endswith("secret: must be a mapping of map_server keys, got text or a number")


@pytest.mark.parametrize("load", [load_scenario, load_dock_database, load_nav2_params, load_map])
def test_a_message_quotes_no_more_than_the_beginning_of_a_value(tmp_path, load):
    (tmp_path / "a").write_text(json.dumps({"format": "y" * 1000, "docks": "y" * 1000, "resolution": "y" * 1000}))
    with pytest.raises(InvalidFile) as refused:
        load(tmp_path / "a")
    assert "y" * 100 not in str(refused.value)


def test_any_value_is_quoted_on_one_short_line():
    for value in ("y" * 1000, ["y"] * 1000, {"y": "y" * 1000}, 10**5000, b"y" * 1000, "\n" * 1000):
        assert len(shown(value)) <= 63
        assert "\n" not in shown(value)


def test_a_recording_with_a_pipe_in_its_folder_is_refused(tmp_path):
    os.mkfifo(tmp_path / "a.mcap")
    with pytest.raises(InvalidFile, match=r"a\.mcap: cannot be read: is a pipe"), open_bag(tmp_path):
        pass
    (tmp_path / "a.mcap").unlink()
    (tmp_path / "metadata.yaml").write_bytes(merge_bomb(8))
    with pytest.raises(InvalidFile, match="repeats too many aliases"), open_bag(tmp_path):
        pass


def test_a_regular_file_passes(tmp_path):
    (tmp_path / "a").write_bytes(b"abc")
    check_regular(tmp_path / "a", 3)
    assert read_bytes(tmp_path / "a", 3) == b"abc"
    with pytest.raises(InvalidFile, match="has more than the 2 bytes"):
        check_regular(tmp_path / "a", 2)
