"""Depth, size and type of all files of a scene are checked before Mitsuba parses them."""

import os
import struct
import zlib

import pytest

from mcspectra.cli.main import main
from mcspectra.core.errors import FileFormatError
from mcspectra.rendering import scenes
from mcspectra.rendering.scenes import DictScene, load_scene, referenced_files, render_file

SCENE = "<scene version='3.0.0'>{}</scene>"
BITMAP = "<texture type='bitmap'><string name='filename' value='{}'/></texture>"


def nested(depth, tag="bsdf"):
    return f"<{tag} type='twosided'>" * depth + f"</{tag}>" * depth


@pytest.fixture
def write(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def call(inside, name="scene.xml", frame=SCENE):
        (tmp_path / name).write_text(frame.format(inside), encoding="utf-8")
        return tmp_path / name

    return call


def refused(file, words):
    for call in (referenced_files, load_scene, render_file):
        with pytest.raises(FileFormatError, match=words) as caught:
            call(file)
        assert "\n" not in str(caught.value)


@pytest.mark.render
def test_a_deep_scene_does_not_end_the_process(write, capsys):
    """100,000 nested elements ended the process with SIGSEGV."""
    file = write(nested(100_000))
    assert main(["render", str(file)]) == 2
    assert "has elements nested 100001 deep; give at most 64." in capsys.readouterr().err


@pytest.mark.render
@pytest.mark.parametrize(
    "frame",
    [
        SCENE,
        "<!-- a -- b -->" + SCENE,
        SCENE + "<!-- -- </bsdf> -->",
        "<a b='<!--'/>" + SCENE + "-->",
        "<scene version='3.0.0' a='&no;'>{}</scene>",
        "<![CDATA[ <!-- ]]>" + SCENE + "<!-- -- -->",
        "<? <!-- -- ?>" + SCENE + "-->",
    ],
)
def test_depth_is_counted_whatever_is_wrong_with_the_xml(write, frame):
    refused(write(nested(70), frame=frame), "nested 71 deep|is not XML")


@pytest.mark.render
def test_depth_counts_over_includes(write):
    write(nested(40), "inner.txt")
    for name, value in (("inner.txt", ""), ("$part.txt", "<default name='part' value='inner'/>")):
        file = write(
            f"{value}<bsdf type='a'>" * 30 + f"<include filename='{name}'/>" + "</bsdf>" * 30
        )
        refused(file, "nested 73 deep")
    file = write("<bsdf type='a'>" * 30 + "<include filename='$given'/>" + "</bsdf>" * 30)
    with pytest.raises(FileFormatError, match="nested 73 deep"):
        render_file(file, definitions={"given": "inner.txt"})
    write("<default name='part' value='inner.txt'/>", "late.xml")
    file = write("<include filename='$part'/>" * 2 + "<bsdf>" * 60 + "<include "
            "filename='late.xml'/>"
                 + "<include filename='$part'/>" + "</bsdf>" * 60)  # fmt: skip
    refused(file, "nested 103 deep")


@pytest.mark.render
def test_elements_count_with_all_includes(write):
    for k in range(7):
        inside = (
            f"<include filename='part{k + 1}.xml'/>" * 10 if k < 6 else "<shape type='sphere'/>"
        )
        write(inside, f"part{k}.xml")
    refused(
        write("<include filename='part0.xml'/>"), r"has \d+ elements, with those .* at most 2097152"
    )
    refused(write("<include filename='scene.xml'/>" * 3), "has .* elements")


def test_limits_are_far_above_existing_scenes(write):
    write(nested(40), "inner.xml")
    file = write("<include filename='inner.xml'/>" + "<shape type='sphere'/>" * 100_000)
    assert {path.name for path in referenced_files(file)} == {"inner.xml"}


def test_a_long_file_is_refused_before_it_is_read(write, monkeypatch):
    monkeypatch.setattr(scenes, "MOST_XML", 1000)
    with pytest.raises(FileFormatError, match="has 2031 bytes; give at most 1000"):
        referenced_files(write(" " * 2000))


def test_declarations_of_entities_are_refused(write):
    bomb = "<!DOCTYPE scene [<!ENTITY a '<bsdf/>'>]>" + SCENE
    with pytest.raises(FileFormatError, match="document type with declarations"):
        referenced_files(write("&a;", frame=bomb))
    assert referenced_files(write("", frame="<!DOCTYPE scene>" + SCENE)) == set()


@pytest.mark.render
@pytest.mark.parametrize(
    "inside",
    [
        BITMAP.format("pipe"),
        "<shape type='obj'><string name='filename' value='pipe'/></shape>",
        "<include filename='pipe'/>",
        "<spectrum name='reflectance' filename='pipe'/>",
        "<default name='a' value='pipe'/>" + BITMAP.format("$a"),
        BITMAP.format("/dev/zero"),
    ],
)
def test_pipes_and_devices_are_refused(write, tmp_path, inside):
    """A pipe as a bitmap blocked forever."""
    os.mkfifo(tmp_path / "pipe")
    refused(write(inside), "a device or a pipe; give a file")


@pytest.mark.render
def test_a_pipe_is_rejected_as_a_scene_and_as_a_file_of_a_dictionary(tmp_path):
    os.mkfifo(tmp_path / "pipe.xml")
    for call in (load_scene, render_file):
        with pytest.raises(FileFormatError, match="There is no scene file"):
            call(tmp_path / "pipe.xml")
    texture = {"type": "bitmap", "filename": str(tmp_path / "pipe.xml")}
    with pytest.raises(FileFormatError, match="a device or a pipe"):
        DictScene({"type": "scene", "a": {"type": "diffuse", "reflectance": texture}})


def test_a_picture_that_is_large_in_memory_is_refused(write, tmp_path):
    """A few kilobytes of PNG can expand to gigabytes."""

    def chunk(kind, data):
        body = kind + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    head = struct.pack(">IIBBBBB", 60_000, 60_000, 8, 2, 0, 0, 0)
    png = (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", head)
        + chunk(b"IDAT", zlib.compress(b""))
        + chunk(b"IEND", b"")
    )
    (tmp_path / "bomb.dat").write_bytes(png)
    with pytest.raises(FileFormatError, match="of memory to read"):
        referenced_files(write(BITMAP.format("bomb.dat")))
    (tmp_path / "bomb.dat").write_bytes(b"\x89PNG, but broken")
    assert len(referenced_files(write(BITMAP.format("bomb.dat")))) == 1


def test_long_texts_name_no_file(write):
    assert referenced_files(write(f"<string name='a' value='{'x' * 5000}'/>")) == set()
    assert referenced_files(write(f"<string name='a' value='{'x' * 300}'/>")) == set()
