"""Registries: names map to classes, similar names are suggested, and other packages add names."""

import sys
from dataclasses import dataclass
from typing import ClassVar

import pytest

from mcspectra.core.errors import MissingDependency, ParameterError, SpecError, UnknownName
from mcspectra.core.registry import Registry, optional_package
from mcspectra.core.spec import Call, Component, parse

GROUP = "mcspectra.tests"
HERE = "mcspectra_registry_test_components"


@dataclass(frozen=True, kw_only=True)
class Plain(Component):
    """A component."""

    name: ClassVar[str] = "plain"
    dims: int = 2
    scale_: float = 1.0


@dataclass(frozen=True, kw_only=True)
class Flat(Component):
    """A component of one dim, with a required parameter."""

    name: ClassVar[str] = "flat"
    width: float

    @property
    def dims(self):
        return 1


@pytest.fixture
def registry(monkeypatch):
    """A registry of this module's classes, under an importable name."""
    monkeypatch.setitem(sys.modules, HERE, sys.modules[__name__])
    builtin = {
        "plain": f"{HERE}:Plain",
        "flat": f"{HERE}:Flat",
        "no-module": "no_such_module_anywhere:Thing",
        "no-class": f"{HERE}:NoSuchClass",
    }
    return Registry("thing", GROUP, builtin)


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Return a function that adds a distribution with entry points to sys.path."""

    def add(entries, source, module="third_party_things"):
        info = tmp_path / "third_party-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: third-party\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[{GROUP}]\n" + "\n".join(entries) + "\n")
        (tmp_path / f"{module}.py").write_text(source)
        monkeypatch.syspath_prepend(tmp_path)

    yield add
    sys.modules.pop("third_party_things", None)


def test_a_registry_is_a_sorted_mapping_that_imports_nothing(registry):
    assert list(registry) == ["flat", "no-class", "no-module", "plain"]
    assert len(registry) == 4
    assert registry["plain"] == f"{HERE}:Plain"
    assert "plain" in registry
    assert "other" not in registry
    assert "no_such_module_anywhere" not in sys.modules
    with pytest.raises(TypeError):
        registry["new"] = "module:Class"


def test_calls_become_components(registry):
    assert registry.load("plain") is Plain
    assert registry.build(parse("plain(scale=2.0)")) == Plain(scale_=2.0)
    assert registry.build(parse("plain"), 3) == Plain(dims=3)
    assert registry.build(parse("plain(dims=3)"), 3) == Plain(dims=3)
    assert registry.build(parse("flat(width=0.5)"), 1) == Flat(width=0.5)


@pytest.mark.parametrize(
    ("call", "dims", "error", "words"),
    [
        ("plan", None, UnknownName, "There is no thing called 'plan'. Did you mean 'plain'"),
        ("zzz", None, UnknownName, "Allowed: flat, no-class, no-module, plain."),
        ("plain(skale=1)", None, ParameterError, "no parameter 'skale'; it takes dims, scale"),
        ("plain(skale=1)", None, ParameterError, "Did you mean 'scale'"),
        ("plain(dims=3)", 2, ParameterError, "has dims=3, but 2 dims are needed"),
        ("flat", None, ParameterError, "flat needs width."),
        ("flat(width=1)", 2, ParameterError, "flat is for 1 dim, but 2 dims are needed"),
        ("no-module", None, MissingDependency, "'no-module' .* cannot be loaded"),
        ("no-class", None, MissingDependency, "'no-class' .* cannot be loaded"),
    ],
)
def test_components_that_cannot_be_built_raise_one_sentence(registry, call, dims, error, words):
    with pytest.raises(error, match=words) as caught:
        registry.build(parse(call), dims)
    assert "\n" not in str(caught.value)
    assert str(caught.value).rstrip().endswith((".", "?"))


def test_unknown_names_carry_the_close_ones(registry):
    with pytest.raises(UnknownName) as caught:
        registry.load("plian")
    assert caught.value.close == ("plain",)
    assert isinstance(caught.value, SpecError)


THIRD_PARTY = """
from dataclasses import dataclass
from mcspectra.core.spec import Component

@dataclass(frozen=True, kw_only=True)
class Theirs(Component):
    "A component of another distribution."
    name = "theirs"
    dims: int = 2
    depth: int = 1
"""


def test_other_distributions_add_names(registry, install):
    assert "theirs" not in registry
    install(["theirs = third_party_things:Theirs"], THIRD_PARTY)
    assert "theirs" in registry
    assert list(registry) == sorted(["flat", "no-class", "no-module", "plain", "theirs"])
    # the name is registered, but the module is not imported
    assert "third_party_things" not in sys.modules
    made = registry.build(parse("theirs(depth=3)"), 4)
    assert (made.dims, made.depth, made.spec) == (4, 3, "theirs(depth=3)")
    with pytest.raises(UnknownName, match="Did you mean 'theirs'"):
        registry.load("their")


def test_a_built_in_name_wins(registry, install):
    install(["plain = third_party_things:Theirs"], THIRD_PARTY)
    assert registry["plain"] == f"{HERE}:Plain"
    assert registry.load("plain") is Plain
    assert len(registry) == 4


@pytest.mark.parametrize(
    ("entry", "source", "words"),
    [
        ("theirs = third_party_things:Missing", THIRD_PARTY, "Missing"),
        ("theirs = third_party_things:Theirs", "import no_such_module_anywhere", "no_such_module"),
        ("theirs = no_such_module_anywhere:Theirs", "", "no_such_module"),
        ("theirs = third_party_things:nothing", "nothing = {}", "not a class"),
    ],
)
def test_a_broken_distribution_affects_only_its_own_names(registry, install, entry, source, words):
    install([entry], source)
    assert registry.build(Call("plain", {})) == Plain()
    with pytest.raises(MissingDependency, match=words):
        registry.load("theirs")


def test_optional_packages_are_loaded_or_named(monkeypatch):
    assert optional_package("json.decoder", "any", "It needs").__name__ == "json"
    for name in ("no_such_package", "no_such_package.part"):
        with pytest.raises(MissingDependency) as caught:
            optional_package(name, "extra", "These files need")
        assert str(caught.value) == (
            "These files need the package no_such_package; install it with: "
            "pip install 'mcspectra[extra]'"
        )

    def fail(name):
        raise OSError("lib.so: cannot\nopen.")

    monkeypatch.setattr("importlib.import_module", fail)
    with pytest.raises(
        MissingDependency, match=r"; it cannot be loaded: lib.so: cannot open; reinstall it"
    ):
        optional_package("json", "extra", "It needs")
