"""The seeded defects of `mutations.py` still match the source."""

import ast

import pytest

from tests.mutations import BEYOND, MUTATIONS, ROOT


@pytest.mark.parametrize("package", sorted({package for package, _, _ in MUTATIONS}))
def test_each_fragment_occurs_exactly_once_in_its_package(package):
    files = [p.read_text(encoding="utf-8") for p in ROOT.glob(f"src/mcspectra/{package}/**/*.py")]
    assert files, f"the package {package} does not exist"
    assert ROOT.joinpath("tests", package).is_dir(), f"tests/{package} does not exist"
    for _, fragment, replacement in (m for m in MUTATIONS if m[0] == package):
        found = [text for text in files if fragment in text]
        assert sum(text.count(fragment) for text in files) == 1, fragment
        ast.parse(found[0].replace(fragment, replacement))


def test_additional_tests_exist_and_belong_to_seeded_defects():
    assert set(BEYOND) <= {fragment for _, fragment, _ in MUTATIONS}
    assert all(ROOT.joinpath(tests).exists() for tests in BEYOND.values())
