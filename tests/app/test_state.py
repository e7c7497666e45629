"""Conversion of states to and from query strings, and refused values."""

import contextlib
import dataclasses

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mcspectra.app.state import (
    MIRRORS,
    MOST_HALF_WIDTH,
    MOST_POINTS,
    OPTIONS,
    THEMES,
    ExplorerSetup,
    ExplorerState,
)
from mcspectra.core.errors import ConfigError, ParameterError, SpecError
from mcspectra.core.trust import allow
from mcspectra.samplers import allow_code

UPLOAD = f"upload(digest='{'0a' * 32}')"

samplers = st.sampled_from(["jittered", "sobol | owen", "jittered(sides=[4, 2]) | shift"])
integrands = st.sampled_from(["gaussian(width=0.1)", "disk", "step(at=0.3)", UPLOAD])
densities = st.sampled_from(["uniform", "linear(slope=-1.25)", "mixture(parts=['tent', 'power'])"])


@st.composite
def setups(draw):
    dims = draw(st.integers(1, 2))
    return ExplorerSetup(
        sampler=draw(samplers),
        n=draw(st.integers(1, MOST_POINTS)),
        density=draw(densities),
        integrand=draw(integrands),
        dims=dims,
        strata_shift=draw(st.floats(0, 1, exclude_max=True)),
        mirror=draw(st.sampled_from(MIRRORS)),
        smoothing=draw(st.floats(0, 1)),
        basis=draw(st.sampled_from(OPTIONS["basis"].choices)),
        half_width=draw(st.integers(1, MOST_HALF_WIDTH[dims])),
        frequency_step=draw(st.floats(0, 1, exclude_min=True)),
        realizations=draw(st.integers(2, 2**14)),
        seed=draw(st.integers(0, 2**63)),
        counts=draw(st.sampled_from([None, (1,), (4, 16, 64)])),
        fit_last=draw(st.sampled_from([None, "auto", 3])),
        space=draw(st.sampled_from([None, "domain", "primary"])),
        bands=draw(st.sampled_from(OPTIONS["bands"].choices)),
        engine=draw(st.sampled_from(OPTIONS["engine"].choices)),
        eps=draw(st.sampled_from([1e-9, 1e-3])),
    )


@settings(max_examples=150, deadline=None)
@given(setups(), st.none() | setups(), st.sampled_from(THEMES))
def test_a_query_is_its_state(a, b, theme):
    state = ExplorerState(a=a, b=b, theme=theme)
    assert ExplorerState.from_query(state.query()) == state
    assert ExplorerState.from_query("?" + state.query()) == state


def test_the_defaults_need_no_query():
    assert ExplorerState().query() == ""
    assert ExplorerState.from_query("") == ExplorerState()


def test_a_second_set_up_of_defaults_is_kept():
    assert ExplorerState.from_query(ExplorerState(b=ExplorerSetup()).query()).b == ExplorerSetup()


@settings(max_examples=200, deadline=None)
@given(st.text(max_size=80))
def test_any_query_is_a_state_or_a_package_error(query):
    with contextlib.suppress(ParameterError):
        assert isinstance(ExplorerState.from_query(query), ExplorerState)


@pytest.mark.parametrize(
    ("query", "said"),
    [
        ("n=1e9", "whole number"),
        ("n=1000000000", "from 1 to 65536"),
        ("n=0", "from 1"),
        (f"n={'9' * 5000}", "whole number"),
        ("n=4&n=5", "twice"),
        ("m=4", "unknown key"),
        ("b.m=4", "unknown key"),
        ("sampler=", "give a spec"),
        ("sampler=jittered%00", "control"),
        ("sampler=jittered%0A", "control"),
        (f"sampler={'a' * 3000}", "at most 2000"),
        (f"sampler={'a' * 9000}", "longer than"),
        ("density=a|b", "chains"),
        ("smoothing=nan", "finite"),
        ("strata_shift=1", "less than 1"),
        ("strata_shift=inf", "finite"),
        ("half_width=129", "from 1 to 128"),
        ("dims=3", "from 1 to 2"),
        ("frequency_step=0", "greater than 0"),
        ("seed=-1", "from 0"),
        ("realizations=1", "from 2"),
        ("theme=pink", "light, dark"),
        ("counts=4,x", "counts"),
        ("counts=16,4", "ascending"),
        ("counts=4,100000", "65536"),
        ("engine=cuda", "nufft"),
        ("eps=2", "eps"),
        ("bands=3", "radial"),
        ("fit_last=1", "fit_last"),
        ("basis=wavelet", "fourier"),
        ("mirror=yes", "none"),
        ("channel=alpha", "luminance"),
        ("n", "cannot be read"),
        ("n=%ff", "cannot be read"),
        ("integrand=upload(digest='12')", "digest"),
        ("integrand=upload(digest=12)", "digest"),
        ("integrand=upload", "digest"),
    ],
)
def test_odd_addresses_get_a_sentence(query, said):
    with pytest.raises(ParameterError, match=said) as caught:
        ExplorerState.from_query(query)
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize(
    "query",
    [
        "integrand=image(path='picture.png')",
        "integrand=image(path='/picture')",
        "integrand=pixel(scene='/a/scene.xml', x=1, y=2)",
        "integrand=pixel(scene='scene.xml', x=1, y=2)",
        "sampler=points(path=['a.dat'])",
        "sampler=digital-net(matrices='a')",
        "density=mixture(parts=[\"image(path='a.png')\"])",
        "density=defensive(density=\"image(path='a')\")",
        "sampler=qmcpy(options={'generating_matrices': 'a'})",
        "sampler=qmcpy(options={'x': '..\\\\a'})",
    ],
)
def test_addresses_open_no_files(query):
    with pytest.raises(ParameterError, match=r"file|brackets"):
        ExplorerState.from_query(query)


def test_the_user_who_starts_it_may_allow_code_and_folders(tmp_path):
    (tmp_path / "in").mkdir()
    inside, outside = tmp_path / "in" / "a.dat", tmp_path / "b.dat"
    for file in (inside, outside):
        file.write_text("0.5 0.5\n")
    (tmp_path / "in" / "link.dat").symlink_to(outside)
    for text in ("command('./mine {n} {seed}')", "python('os:getcwd')"):
        with pytest.raises(ConfigError, match="--allow-code"):
            ExplorerSetup(sampler=text)
    with pytest.raises(SpecError, match="--allow-path"):
        ExplorerSetup(sampler=f"points(path={str(inside)!r}) | shift")
    allow(folders=[tmp_path / "in"])
    for name in ("a.dat", "a*"):
        ExplorerSetup(sampler=f"points(path={str(tmp_path / 'in' / name)!r}) | shift")
    for path in (outside, tmp_path / "in" / "link.dat", tmp_path / "in" / "*", tmp_path / "*"):
        with pytest.raises(SpecError, match="names a file"):
            ExplorerSetup(sampler=f"points(path={str(path)!r})")
    allow_code("./explored {n} {seed}")
    ExplorerSetup(sampler="command('./explored {n} {seed}', name='mine')")
    with pytest.raises(ConfigError, match="--allow-code"):
        ExplorerSetup(sampler="command('./explored {n} {seed}; rm')")


@pytest.mark.parametrize("field", [each.name for each in dataclasses.fields(ExplorerSetup)])
@pytest.mark.parametrize("value", [None, [], True, float("nan"), b"x"])
def test_fields_of_a_wrong_type_are_refused(field, value):
    if value is None and getattr(ExplorerSetup(), field) is None:
        return  # The explorer chooses this value itself
    with pytest.raises(ParameterError):
        ExplorerSetup(**{field: value})


def test_an_invalid_set_up_is_refused():
    with pytest.raises(ParameterError, match="ExplorerSetup"):
        ExplorerState(a="jittered")
    with pytest.raises(ParameterError, match="ExplorerSetup"):
        ExplorerState(b="jittered")


def test_the_strata_shift_is_a_step_of_the_sampler():
    assert (
        ExplorerSetup(strata_shift=0.25).displaced_sampler == "jittered | strata-shift(offset=0.25)"
    )
    assert ExplorerSetup().displaced_sampler == "jittered"


def test_formulas_have_slashes_and_dots():
    spec = "formula(expression='exp(-x/2.5)*y.real')"
    assert (
        ExplorerState.from_query(ExplorerState(a=ExplorerSetup(integrand=spec)).query()).a.integrand
        == spec
    )
    with pytest.raises(ParameterError, match="looks like a file"):
        ExplorerSetup(integrand="formula(expression='x', other='/etc/passwd')")
    with pytest.raises(ParameterError, match="looks like a file"):
        ExplorerSetup(integrand="gaussian(expression='x/2')")
