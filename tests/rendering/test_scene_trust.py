"""A study's scene can read only what the study can read, and can load no plugin of its own."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from tests.processes import python

from mcspectra.core.errors import ConfigError, FileFormatError, McspectraError, ParameterError
from mcspectra.core.trust import Trust
from mcspectra.rendering import backend, load_mitsuba
from mcspectra.rendering.backend import mitsuba_folder
from mcspectra.rendering.scenes import (
    DictScene,
    integrator_plugin,
    load_scene,
    referenced_files,
    render_file,
)
from mcspectra.studies.vetting import Vetting

SCENE = "<scene version='3.0.0'>{}</scene>"
BITMAP = "<texture type='bitmap'><string name='filename' value='{}'/></texture>"
SPEC = "pixel(scene='scene.xml', x=0, y=0)"
OUTSIDE = "outside the folders that a study may read"


@pytest.fixture
def study(tmp_path, monkeypatch):
    """The folder of a study, next to a private folder; it is not the current folder."""
    for name in ("study/sub", "private", "cwd"):
        (tmp_path / name).mkdir(parents=True)
    for name in ("study/in.png", "study/sub/in.png", "private/out.png", "private/x.eta.spd"):
        (tmp_path / name).write_text(SCENE.format(""))  # any element may name this file
    (tmp_path / "private" / "out.xml").write_text(SCENE.format(""))
    (tmp_path / "study" / "link.png").symlink_to(tmp_path / "private" / "out.png")
    (tmp_path / "study" / "folder").symlink_to(tmp_path / "private")
    monkeypatch.chdir(tmp_path / "cwd")
    return tmp_path / "study"


def vetted(study, inside, frame=SCENE, trust=None, *, data=None):
    file = study / "scene.xml"
    file.write_bytes(frame.format(inside).encode() if data is None else data)
    return Vetting(study, Trust() if trust is None else trust).calls(SPEC)[1]


REFERENCES = {
    "bitmap": BITMAP.format("{}"),
    "mesh": "<shape type='obj'><string name='filename' value='{}'/></shape>",
    "environment map": "<emitter type='envmap'><string name='filename' value='{}'/></emitter>",
    "measured": "<bsdf type='measured'><string name='filename' value='{}'/></bsdf>",
    "volume": "<volume type='gridvolume'><string name='filename' value='{}'/></volume>",
    "curves": "<shape type='linearcurve'><string name='filename' value='{}'/></shape>",
    "old name": "<shape type='obj'><string name='fileName' value='{}'/></shape>",
    "spectrum": "<spectrum name='reflectance' filename='{}'/>",
    "include": "<include filename='{}'/>",
    "default": "<default name='a' value='{}'/>" + BITMAP.format("$a"),
    "default of a default": "<default name='b' value='{}'/><default name='a' value='$b'/>"
    + BITMAP.format("$a"),
}
NAMES = [
    "../private/out.png",
    "/private/out.png",
    "link.png",
    "folder/out.png",
    "../none",
    "sub/../../x",
]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", REFERENCES)
def test_no_element_names_a_file_outside(study, kind, name):
    if name.startswith("/"):
        name = str(study.parent) + name
    with pytest.raises(ConfigError, match=rf"scene\.xml.*{OUTSIDE}.*--allow-path") as caught:
        vetted(study, REFERENCES[kind].format(name))
    assert "\n" not in str(caught.value)
    assert " in line 1, names " in str(caught.value)


@pytest.mark.parametrize("kind", REFERENCES)
def test_files_inside_and_allowed_ones_are_read(study, kind):
    text = REFERENCES[kind].format("sub/in.png")
    assert "sub/in.png" in vetted(study, text)
    text = REFERENCES[kind].format("../private/out.png")
    allowed = Trust(folders=(study.parent / "private",))
    assert str(study.parent / "private" / "out.png") in vetted(study, text, trust=allowed)
    assert vetted(study, text, trust=Trust(folders=(Path("/"),)))
    assert referenced_files(study / "scene.xml")  # a person who names the scene may read all files


def test_includes_follow_the_same_rules(study):
    (study / "sub" / "part.xml").write_text(SCENE.format(BITMAP.format("../../private/out.png")))
    with pytest.raises(ConfigError, match=rf"part\.xml.*{OUTSIDE}"):
        vetted(study, "<include filename='sub/part.xml'/>")
    (study / "sub" / "part.xml").write_text(SCENE.format(BITMAP.format("sub/in.png")))
    names = ("scene.xml", "sub/in.png", "sub/part.xml")
    assert vetted(study, "<include filename='sub/part.xml'/>") == names


@pytest.mark.parametrize(
    "inside",
    [
        "<path value='../private'/>" + BITMAP.format("out.png"),
        BITMAP.format("out.png") + "<path value='folder'/>",
        "<path value='sub'/><path value='../private'/>",
        BITMAP.format("&#46;&#x2E;/private/out.png"),
        # Names of parameters inside others, and with any characters
        "<default name='a' value='../pri'/>" + BITMAP.format("$avate/out.png"),
        "<default name='a' value='../private/'/><default name='ab' value='x'/>"
        + BITMAP.format("$about.png").replace("about", "aout"),
        f"<default name='{'p' * 60}' value='../private/out.png'/>" + BITMAP.format("$" + "p" * 60),
        # A material, which Mitsuba searches in data/ior
        "<bsdf type='conductor'><string name='material' value='../../../private/x'/></bsdf>",
        "<default name='n' value='material'/><string name='$n' value='../../folder/x'/>",
    ],
)
def test_ways_around_the_rules_are_rejected(study, inside):
    with pytest.raises(ConfigError, match=OUTSIDE):
        vetted(study, inside)


def test_the_current_folder_is_not_a_folder_of_the_study(study):
    for place in (study.parent / "cwd", study):
        (place / "wall.png").write_text("any")
    (study.parent / "cwd" / "own.png").write_text("any")
    (study.parent / "cwd" / "more").mkdir()
    assert "wall.png" in vetted(study, BITMAP.format("wall.png"))
    for inside in (BITMAP.format("own.png"), "<path value='more'/>"):
        with pytest.raises(ConfigError, match=OUTSIDE):
            vetted(study, inside)


@pytest.mark.skipif(mitsuba_folder() is None, reason="needs Mitsuba")
def test_mitsubas_folder_is_not_a_folder_of_the_study(study):
    """A deep scene could name files next to Mitsuba's folder without leaving its own."""
    up = "../" * len(mitsuba_folder().parts)
    deep = study / Path(*"abcdefghijklmnopqrst")
    deep.mkdir(parents=True)
    name = up + str((study.parent / "private" / "out.png").relative_to("/"))
    (deep / "scene.xml").write_text(SCENE.format(BITMAP.format(name)))
    with pytest.raises(ConfigError, match=OUTSIDE):
        Vetting(study, Trust()).calls(f"pixel(scene='{deep}/scene.xml', x=0, y=0)")


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"<scene version='3.0.0'><a b='<'/></scene>", "is not XML"),
        (b"<scene version='3.0.0'><a b='&c;'/></scene>", "is not XML"),
        (b"<scene version='3.0.0'><a b='\x01'/></scene>", "is not XML"),
        (b"<scene version='3.0.0'><a b='\0'/></scene>", "is not XML"),
        (b"<scene version='3.0.0'><a b='1' b='2'/></scene>", "is not XML"),
        (b"<scene version='3.0.0'><a b='\xff'/></scene>", "is not XML"),
        (b"<!DOCTYPE scene SYSTEM 'x'><scene version='3.0.0'/>", "document type"),
        (b"<?xml version='1.0' encoding='latin-1'?><scene version='3.0.0'/>", "encoding 'latin-1'"),
        ("<scene version='3.0.0'/>".encode("utf-16"), "UTF-16"),
        (b"<scene version='3.0.0'><string name='a' value='\\$b'/></scene>", "escape"),
        (b"<scene version='3.0.0'><default name='a/b' value='1'/></scene>", "'a/b'"),
        (b"<scene version='3.0.0'><default name='a' value='\\'/></scene>", "backslash"),
        (b"<?xml version='1.0' encoding='f-8'?><scene version='3.0.0'/>", "is not XML"),
        (
            b"<?xml version='1.0' encoding='shift-jis'?><scene version='3.0.0'/>",
            "is not XML|encoding",
        ),
    ],
)
def test_files_that_mitsuba_may_read_differently_are_rejected(study, data, words):
    with pytest.raises(FileFormatError, match=words):
        vetted(study, "", data=data)
    assert referenced_files(study / "scene.xml") == set()


@pytest.mark.parametrize("name", ["scene", "scene.txt", "SCENE.XML"])
def test_a_scene_file_may_have_any_name(study, name):
    (study / name).write_text(SCENE.format(BITMAP.format("../private/out.png")))
    with pytest.raises(ConfigError, match=OUTSIDE):
        Vetting(study, Trust()).calls(f"pixel(scene='./{name}', x=0, y=0)")


def test_a_home_folder_is_not_the_studys(study, monkeypatch):
    """In the current folder, ``./~/x.xml`` was read as a path in the home folder."""
    monkeypatch.chdir(study)
    for spec in ("pixel(scene='~/x.xml')", "pixel(scene='~root/x.xml')"):
        with pytest.raises(ConfigError, match="without ~"):
            Vetting(Path(), Trust()).calls(spec)


@pytest.mark.parametrize(
    ("spec", "what"),
    [
        ('points(path="/etc/hosts")', "a file"),
        ("sobol | warp(density=\"image(path='x.png')\")", "a file"),
        ("qmcpy(generator='Lattice', options={'generating_vector': 'x.npy'})", "a file"),
        ("command('./mine {n}', dims=2)", "code"),
        ("python('module:function')", "code"),
    ],
)
def test_a_sampler_in_a_scene_names_no_file_and_no_code(study, spec, what):
    value = spec.replace("'", "&apos;").replace('"', "&quot;")
    sampler = f"<sampler type='mcspectra'><string name='spec' value='{value}'/></sampler>"
    with pytest.raises(ConfigError, match=f"which names {what}"):
        vetted(study, sampler)
    assert vetted(study, sampler.replace(value, "sobol | owen")) == ("scene.xml",)


@pytest.mark.parametrize(
    "inside",
    [
        "<default name='a' value='x$a'/>",
        "<default name='a' value='1'/><default name='a' value='x$a'/>" + BITMAP.format("$a"),
        "".join(f"<default name='a{k}' value='$a{k - 1}$a{k - 1}'/>" for k in range(1, 60)).replace(
            "$a0$a0", "ab"
        ),
        "".join(f"<default name='a{k}' value='$a{k + 1}x'/>" for k in range(100))
        + "<default name='a100' value='1'/>",
    ],
)
def test_parameters_do_not_grow_without_end(study, inside):
    with pytest.raises(FileFormatError, match="values for|refer to later ones"):
        vetted(study, inside)


@pytest.mark.parametrize("ending", [".so", ".dylib", ".dll"])
@pytest.mark.parametrize("name", ["own", "diffuse"])
def test_a_library_next_to_a_scene_is_not_run(study, name, ending):
    (study / "sub" / "plugins").mkdir()
    (study / "sub" / "plugins" / f"{name}{ending}").touch()
    for inside in (
        f"<path value='sub'/><bsdf type='{name}'/>",
        f"<bsdf type='{name}'/><path value='sub'/>",
        f"<default name='a' value='{name}'/><path value='sub'/><bsdf type='$a'/>",
    ):
        with pytest.raises(FileFormatError, match="libraries are not run"):
            vetted(study, inside)
        with pytest.raises(FileFormatError, match="libraries are not run"):
            referenced_files(study / "scene.xml")
    for type_ in ("../sub/plugins/own", "/x", "a.b", ""):
        with pytest.raises(FileFormatError, match="names of plugins have"):
            vetted(study, f"<bsdf type='{type_}'/>")


def test_a_library_in_the_current_folder_is_not_run(study):
    (Path.cwd() / "plugins").mkdir()
    (Path.cwd() / "plugins" / "own.so").touch()
    with pytest.raises(FileFormatError, match="libraries are not run"):
        vetted(study, "<bsdf type='own'/>")
    with pytest.raises(FileFormatError, match="libraries are not run"):
        DictScene({"type": "scene", "a": {"type": "own"}})
    for spec in ("own", "own(depth=3)", "aov(inner={'type': 'own'})"):
        with pytest.raises(FileFormatError, match="libraries are not run"):
            integrator_plugin(spec)
    for spec in ("my_path(a={'type': 'bitmap', 'filename': '/x.png'})", "a(b='points(path=3)')"):
        if "3" in spec:
            assert integrator_plugin(spec)["b"] == "points(path=3)"
            continue
        with pytest.raises(ParameterError, match="names a file or code"):
            integrator_plugin(spec)
    with pytest.raises(ParameterError, match="such as 'Au'"):
        DictScene({"type": "scene", "a": {"type": "conductor", "material": "../x"}})


compiles = pytest.mark.skipif(
    sys.platform != "linux" or shutil.which("cc") is None, reason="compiles a library"
)


def marking_libraries(study):
    """Write libraries and modules that leave a file if they run; return the file."""
    source, mark = study.parent / "mark.c", study.parent / "mark"
    source.write_text(
        "#include <stdio.h>\n__attribute__((constructor)) void mark(void) {"
        f'FILE *f = fopen("{mark}", "w"); if (f) fclose(f); }}\n'
    )
    (study / "plugins").mkdir()
    library = study / "plugins" / "own.so"
    subprocess.run(["cc", "-shared", "-fPIC", "-o", library, source], check=True)
    for name in ("diffuse", "sphere", "independent"):
        shutil.copy(library, library.with_stem(name))
    for name in ("mitsuba", "drjit"):  # the test of LLVM runs in a separate process
        (study / f"{name}.py").write_text(f"open({str(mark)!r}, 'w').close()\n")
    return mark


@pytest.mark.render
@compiles
def test_mitsuba_searches_no_library_in_the_current_folder(study, monkeypatch):
    mark = marking_libraries(study)
    monkeypatch.chdir(study)
    folders = [Path(str(folder)) for folder in load_mitsuba().file_resolver()]
    assert folders == [mitsuba_folder()]
    assert backend._worked(backend._tried(backend._SCALAR_PROBE))  # in a process of its own
    assert not mark.exists()


@pytest.mark.render
@pytest.mark.slow
@compiles
def test_no_code_of_a_folder_runs(study):
    """Mitsuba searched ``plugins/diffuse.so`` in the current folder first, for all scenes."""
    mark = marking_libraries(study)
    (study / "scene.xml").write_text(SCENE.format("<bsdf type='own'/>"))
    (study / "study.toml").write_text(
        'title = "t"\nsamplers = ["jittered"]\n[points]\nn = 4\n[[estimators]]\nname = "a"\n'
        "dims = 2\nintegrand = \"pixel(scene='veach(width=8, height=8)', x=3, y=3)\"\n"
    )
    # One process starts Mitsuba once. The verb that may load libraries of a scene comes first
    verbs = (["pixel", "scene.xml", "1", "1"], ["run", "study.toml", "--dry-run"], ["doctor"])
    program = (
        "import os; from mcspectra.cli.main import main\n"
        f"for verb in {verbs}:\n"
        f"    print(*verb, main(verb), os.path.exists({str(mark)!r}))\n"
    )
    safe = {**os.environ, "MCSPECTRA_CACHE": str(study.parent / "cache")}
    done = python("-P", "-c", program, cwd=study, timeout=300, env=safe)
    ended = [line for line in done.stdout.splitlines() if line.endswith(("True", "False"))]
    assert [line.split()[0] for line in ended] == [verb[0] for verb in verbs], done.stderr
    assert [line for line in ended if line.endswith("True")] == []
    assert "pixel scene.xml 1 1 2 False" in ended  # exit code 2: the library is refused


@pytest.mark.render
def test_a_link_that_is_exchanged_later_is_a_change(study):
    """A folder's owner can exchange files between check and load: this changes the study."""
    vetting = Vetting(study, Trust())
    (study / "scene.xml").write_text(SCENE.format(BITMAP.format("in.png")))
    vetting.calls(SPEC)
    (study / "in.png").unlink()
    (study / "in.png").symlink_to(study.parent / "private" / "out.png")
    with pytest.raises(ConfigError, match=OUTSIDE):
        Vetting(study, Trust()).calls(SPEC)


@pytest.mark.render
def test_scenes_named_by_a_person_may_read_everything(study):
    """Scenes given in Python or on the command line are read as before."""
    text = SCENE.format(
        BITMAP.format("../private/out.png") + "<include filename='folder/out.xml'/>"
    )
    (study / "scene.xml").write_text(text)
    names = {path.name for path in referenced_files(study / "scene.xml")}
    assert names == {"out.png", "out.xml"}
    for call in (load_scene, render_file):
        with pytest.raises(McspectraError, match="Mitsuba cannot"):  # the file is not a picture
            call(study / "scene.xml")
    (study / "alias.xml").symlink_to(study / "scene.xml")
    assert {path.name for path in referenced_files(study / "alias.xml")} == names
