"""Studies run in folders; URLs and stores by name are for exports, and said to be."""

from pathlib import Path

import pytest

from mcspectra.cli.main import main
from mcspectra.core.errors import McspectraError, MissingDependency, ParameterError, StoreError
from mcspectra.studies import decode_study, run_study, study_status
from mcspectra.studies.places import first_line, is_url, output_folder, url_files

STUDY = (
    'title = "t"\nsamplers = ["random"]\n[exact]\ncounts = [4]\n'
    '[[estimators]]\nname = "a"\nintegrand = "linear"\ndims = 1\n'
)


@pytest.mark.parametrize("out", ["memory://foo", "s3://bucket/x.zarr", "zip::file:///tmp/x"])
def test_a_run_into_a_url_is_refused_before_it_begins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, out: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert is_url(out)
    with pytest.raises(ParameterError, match="is a URL, .*mcspectra export DIR --to"):
        run_study(decode_study(STUDY), out)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["x.zarr", "x.zarr.zip", "x.ZIP"])
def test_a_run_into_what_is_named_as_a_store_is_refused(tmp_path: Path, name: str) -> None:
    for out in (tmp_path / name, str(tmp_path / name)):
        with pytest.raises(ParameterError, match=f"export DIR --to {name}"):
            run_study(decode_study(STUDY), out)
    assert list(tmp_path.iterdir()) == []


def test_a_run_into_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text(STUDY)
    with pytest.raises(ParameterError, match=r"a.toml' is a file; give another --out\."):
        run_study(decode_study(STUDY), tmp_path / "a.toml")
    assert (tmp_path / "a.toml").read_text() == STUDY


def test_folders_are_what_they_were(tmp_path: Path) -> None:
    assert output_folder(tmp_path) == tmp_path
    assert output_folder("out/some.thing") == Path("out/some.thing")


@pytest.mark.parametrize("out", ["memory://foo", "foo.zarr", "study.toml"])
@pytest.mark.parametrize("further", [[], ["--dry-run"]])
def test_the_command_says_so_and_makes_nothing(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    out: str,
    further: list[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("study.toml").write_text(STUDY)
    assert main(["run", "study.toml", "--out", out, *further]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith(f"mcspectra: The output folder '{out}' is ")
    assert printed.err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["study.toml"]


def test_the_status_of_an_exported_store_is_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "x.zarr.zip").write_bytes(b"PK")
    for place in ("memory://x", tmp_path / "x.zarr.zip"):
        with pytest.raises(StoreError, match="is not the output folder of a run"):
            study_status(place)


def test_urls_that_cannot_be_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    files, path = url_files("memory://a/b/")
    assert path == "/a/b"
    assert files.protocol == "memory"
    with pytest.raises(StoreError, match="'strange://x' cannot be opened: Protocol not known"):
        url_files("strange://x")

    def missing(_: str) -> None:
        raise ImportError("Install s3fs\n to access S3.")

    monkeypatch.setattr("fsspec.core.url_to_fs", missing)
    with pytest.raises(MissingDependency, match=r"needs more: Install s3fs to access S3\.$"):
        url_files("s3://x")
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(McspectraError, match="needs fsspec, which is not installed"):
        url_files("s3://x")


def test_errors_without_words_are_named() -> None:
    assert first_line(KeyError()) == "KeyError"
    assert first_line(ValueError("one\n  two.")) == "one two"
