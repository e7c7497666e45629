"""Scenes by name, file or dictionary, loaded once per process; their pixels, cameras and lights.

`render_file` renders a scene by Mitsuba's own integrators, with our samplers registered.
"""

from __future__ import annotations

import contextlib
import functools
import gc
import hashlib
import math
import re
import stat
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias, final
from xml.parsers.expat import ExpatError, ParserCreate

import numpy as np

from mcspectra.core.checks import Array, as_instance, as_integer, as_path, as_reals
from mcspectra.core.display import printable, shown
from mcspectra.core.errors import (
    FileFormatError,
    McspectraError,
    Parameter,
    ParameterError,
    SpecError,
    close_match_hint,
)
from mcspectra.core.images import check_picture_size
from mcspectra.core.registry import Registry
from mcspectra.core.spec import parse
from mcspectra.core.trust import Trust, reach_of
from mcspectra.rendering.backend import (
    LOCK,
    VARIANT,
    import_mitsuba,
    load_mitsuba,
    mitsuba_folder,
    threads_for_files,
)
from mcspectra.rendering.plugin import PLUGIN, register_samplers
from mcspectra.samplers import as_sampler

__all__ = [
    "DEEPEST",
    "MOST_ELEMENTS",
    "MOST_XML",
    "SCENES",
    "DictScene",
    "Scene",
    "as_scene",
    "check_plugin",
    "emitter_name",
    "emitter_names",
    "film_size",
    "find_emitter",
    "integrator_plugin",
    "integrator_text",
    "load_scene",
    "mitsuba_reason",
    "named_pixels",
    "project",
    "referenced_files",
    "render_file",
    "scene_name",
    "sensor_of",
    "sized",
    "watched_state",
    "what_fails",
]

Scene: TypeAlias = "str | Path | DictScene | Mapping[str, Any]"
"""Ways to give a scene: a name in `SCENES`, an XML file, or a Mitsuba dictionary."""

_SEEDS, _MOST_SAMPLES = 2**32, 2**24

SCENES = Registry(
    "scene",
    "mcspectra.scenes",
    {
        "figure1": "mcspectra.rendering.builtin:figure1",
        "penumbra": "mcspectra.rendering.builtin:penumbra",
        "sky": "mcspectra.rendering.builtin:sky",
        "smooth-light": "mcspectra.rendering.builtin:smooth_light",
        "veach": "mcspectra.rendering.builtin:veach",
    },
    base=None,
)
"""Functions by scene name. Each function returns a scene as a Mitsuba dictionary."""


def as_scene(scene: object) -> str | Path | DictScene:
    """Return a hashable form of a scene: a name, a path, or a dictionary as a `DictScene`.

    Raises
    ------
    ParameterError
        If `scene` has another type, or is a dictionary without a scene.
    """
    if isinstance(scene, Path | DictScene):
        return scene
    if isinstance(scene, Mapping):
        return DictScene(scene)
    if not isinstance(scene, str) or not scene.strip():
        raise ParameterError(
            f"scene is {shown(scene)}; give the name of a scene, an XML file or a Mitsuba "
            "dictionary."
        )
    return scene


def scene_name(scene: Scene) -> str:
    """Return the text for a scene in messages: its quoted name or path, or ``'dict'``."""
    return repr(str(as_scene(scene)))


def load_scene(scene: Scene) -> Any:
    """Return a Mitsuba scene. Equal requests return the same object.

    Parameters
    ----------
    scene
        A name in `SCENES`, with optional parameters in brackets (``"veach(width=384)"``),
        the path of a Mitsuba XML file, or a dictionary for `mitsuba.load_dict`.
        A scene file is read again if it has changed since the last call.
        The file is also read again if a texture, mesh or other file in the scene has changed.
        Relative paths start in the folder of the file.

    Raises
    ------
    UnknownName
        If no scene has this name.
    ParameterError
        If `scene` is not a scene, or Mitsuba cannot evaluate one of its materials or lights.
    FileFormatError
        If the file is missing, or Mitsuba cannot read the file or the dictionary.
        The message quotes Mitsuba's reason.
    MissingDependency
        If Mitsuba or LLVM is missing.
    """
    request = as_scene(scene)
    with LOCK:
        path = None if isinstance(request, DictScene) else _as_file(request)
        if path is None:
            return _built(request if isinstance(request, DictScene) else str(request).strip())
        if not path.is_file():
            raise FileFormatError(
                f"There is no scene file {str(scene)!r}; give the path of a Mitsuba XML file "
                f"or one of the names {', '.join(SCENES)}."
            )
        return _built(path.resolve(), watched_state(path))


def render_file(
    scene: str | Path,
    variant: str | None = None,
    *,
    integrator: str | None = None,
    sampler: str | None = None,
    joint_dims: int | None = None,
    spp: int | None = None,
    seed: int = 0,
    sensor: int = 0,
    definitions: Mapping[str, object] | None = None,
    out: str | Path | None = None,
) -> Array:
    """Render a scene by one of Mitsuba's integrators, with our samplers registered.

    Parameters
    ----------
    scene
        A name in `SCENES`, or a Mitsuba XML file, which may use ``<sampler type="mcspectra">``.
    variant
        One of Mitsuba's variants; by default ``llvm_ad_rgb``, or ``scalar_rgb`` without LLVM.
    integrator
        Mitsuba plugin, such as ``"path(max_depth=5)"``; by default the scene's own.
    sampler
        Spec of one of our samplers, which replaces the scene's own sampler in memory.
    joint_dims
        How many first numbers of a path come from one set of `sampler`. All others are padded.
        The default is 4 for randomized nets in base 2 and 0 otherwise.
    spp
        Samples per pixel; by default the number in the file.
    seed
        Seed of the image, an integer from 0 to 2^32 − 1.
    sensor
        Index of the camera.
    definitions
        Values of parameters ``$name`` in the file.
    out
        EXR file to which the film is written.

    Returns
    -------
    ndarray
        float64, shape (height, width, channels), radiance.

    Raises
    ------
    FileFormatError
        If the file is missing, or Mitsuba cannot read or render it. The message quotes the reason.
    ParameterError
        If a parameter is out of range, or the integrator or the sampler is not possible.
    UnknownName
        If no scene has this name.
    MissingDependency
        If Mitsuba is missing, or LLVM is missing for the variant.
    """
    options = {"seed": as_integer("seed", seed, least=0, most=_SEEDS - 1)}
    if spp is not None:
        options["spp"] = as_integer("spp", spp, least=1, most=_MOST_SAMPLES)
    target = None if out is None else as_path("out", out).expanduser()
    if target is not None and (target.suffix.lower() != ".exr" or not target.parent.is_dir()):
        raise ParameterError(
            Parameter("out"), f" is {str(out)!r}; give an .exr file in a folder that exists."
        )
    named = str(as_path("scene", scene))
    path = _as_file(scene)
    given = as_instance(
        "definitions",
        {} if definitions is None else definitions,
        Mapping,
        "a mapping of names to values",
    )
    plugin = None if integrator is None else integrator_plugin(integrator)
    if sampler is not None:
        # Check the spec here, because errors inside Mitsuba have less helpful messages
        as_sampler(sampler, 2)
    elif joint_dims is not None:
        raise ParameterError(Parameter("joint_dims"), " is for a sampler of this package; name it.")
    with LOCK, contextlib.ExitStack() as stack:
        (known,), mitsuba = register_samplers(variant)[:1], import_mitsuba()
        stack.enter_context(threads_for_files())
        before, resolver = mitsuba.variant(), mitsuba.file_resolver()
        mitsuba.set_variant(known)
        try:
            # Read the scene, and replace the samplers of its cameras
            parser = mitsuba.parser
            config = parser.ParserConfig(known)
            if path is None:
                state = parser.parse_dict(config, SCENES.build(parse(named.strip())))
            elif not path.is_file():
                raise FileFormatError(
                    f"There is no scene file {shown(named)}; give a Mitsuba XML file or one of the "
                    f"names {', '.join(SCENES)}."
                )
            else:
                beside = mitsuba.FileResolver(resolver)
                beside.prepend(str(path.parent))
                mitsuba.set_file_resolver(beside)
                values = {str(name): str(value) for name, value in given.items()}
                referenced_files(path, values)
                state = parser.parse_file(config, str(path), **values)
            parser.transform_all(config, state)
            if sampler is not None:
                _replace_samplers(mitsuba, state, sampler, spp, joint_dims)
            loaded = parser.instantiate(config, state)
            if not isinstance(loaded, mitsuba.Scene):
                raise FileFormatError(
                    f"{shown(named)} holds no scene; its root element must be <scene>."
                )

            # Render it
            if not (cameras := loaded.sensors()):
                raise ParameterError("The scene has no camera; add a <sensor> to it.")
            camera = cameras[as_integer("sensor", sensor, least=0, most=len(cameras) - 1)]
            if plugin is not None:
                options["integrator"] = mitsuba.load_dict(plugin)
            image = mitsuba.render(loaded, sensor=camera, **options)
            if target is not None:
                camera.film().write(str(target))
            return np.array(image, dtype=np.float64)
        except (RuntimeError, TypeError) as error:
            # If a sampler of this package raised the error, raise the original error
            if isinstance(error.__cause__, McspectraError):
                raise error.__cause__ from None
            reason = mitsuba_reason(error)
            raise FileFormatError(f"Mitsuba cannot render {shown(named)}: {reason}.") from None
        finally:
            mitsuba.set_file_resolver(resolver)
            if before is not None:
                mitsuba.set_variant(before)


def _replace_samplers(
    mitsuba: Any, state: Any, spec: str, spp: int | None, joint_dims: int | None = None
) -> None:
    """Replace the sampler of every camera by ours, with `spp` or the given number of samples."""
    kinds, reference = mitsuba.ObjectType, mitsuba.Properties.ResolvedReference
    nodes = state.nodes
    samplers = {k for k in range(len(nodes)) if nodes[k].type == kinds.Sampler}
    for k in samplers:
        properties = nodes[k].props
        for name in list(properties.keys()):
            if name != "sample_count":
                properties.remove_property(name)
        properties.set_plugin_name(PLUGIN)
        properties["spec"] = spec
        if joint_dims is not None:
            properties["joint_dims"] = joint_dims
        if spp is not None:
            properties["sample_count"] = spp
    for k in range(len(nodes)):
        if nodes[k].type != kinds.Sensor:
            continue
        values = (nodes[k].props[name] for name in nodes[k].props.keys())  # noqa: SIM118
        if any(isinstance(each, reference) and each.index() in samplers for each in values):
            continue
        own = mitsuba.parser.SceneNode()
        own.type, own.props = kinds.Sampler, mitsuba.Properties(PLUGIN)
        own.props["spec"] = spec
        if joint_dims is not None:
            own.props["joint_dims"] = joint_dims
        nodes.append(own)
        nodes[k].props["sampler"] = reference(len(nodes) - 1)


def integrator_text(spec: object) -> str:
    """Check that the spec of an integrator is a text, and not an empty one."""
    if not isinstance(spec, str) or not spec.strip():
        raise ParameterError(
            Parameter("integrator"),
            f" is {shown(spec)}; give 'scene', or a plugin of Mitsuba's such as "
            "'path(max_depth=5)'.",
        )
    return spec


def integrator_plugin(spec: str) -> dict[str, Any]:
    """Return the dictionary of an integrator for `mitsuba.load_dict`: its name and properties.

    Raises
    ------
    ParameterError
        If the spec cannot be read.
    """
    # Names of Mitsuba's plugins may contain underscores, but names in our specs may not
    plugin, bracket, rest = integrator_text(spec).strip().partition("(")
    try:
        found = {"type": plugin, **parse(f"integrator{bracket}{rest}").arguments}
    except SpecError as error:
        raise ParameterError(f"The integrator {shown(spec)} cannot be read: {error}") from None
    if reach_of(found) is not None:
        raise ParameterError(f"The integrator {shown(spec)} names a file or code; remove it.")
    _copied(found)  # This call checks the files and the depth of nesting. Its result is not used
    return found


def named_pixels(scene: Scene) -> dict[str, tuple[int, int]]:
    """Return the named pixels (x, y) of a built-in scene; other scenes have none.

    A name is left out if the film does not show its world point.
    """
    request = as_scene(scene)
    if isinstance(request, DictScene) or _as_file(request) is not None:
        return {}
    points = getattr(SCENES.load(parse(str(request)).name), "named_points", {})
    found = {}
    with LOCK:
        load_scene(request)
        for name, point in points.items():
            with contextlib.suppress(ParameterError):
                x, y = project(request, point)
                found[name] = (math.floor(x), math.floor(y))
    return found


def sensor_of(scene: Scene) -> Any:
    """Return the first camera of a scene. Without a camera, raise a ParameterError."""
    sensors = load_scene(scene).sensors()
    if not sensors:
        raise ParameterError(f"The scene {scene_name(scene)} has no camera; add a <sensor> to it.")
    return sensors[0]


def sized(scene: str, **sizes: int) -> str:
    """Return the spec of a built-in scene with a different film ``width`` and ``height``."""
    call = parse(scene)
    shown = ", ".join(f"{key}={value!r}" for key, value in {**call.arguments, **sizes}.items())
    return f"{call.name}({shown})"


def film_size(scene: Scene) -> tuple[int, int]:
    """Return width and height of a scene's film, or of its crop window, in pixels."""
    width, height = sensor_of(scene).film().crop_size()
    return int(width), int(height)


def project(scene: Scene, point: Sequence[float]) -> tuple[float, float]:
    """Return the film coordinates, in pixels, of a world point in the camera's view.

    Pixel (i, j) covers [i, i+1) × [j, j+1), so its indices are the floor of the result.
    Objects between the camera and the point are ignored; see `describe_pixel`.

    Raises
    ------
    ParameterError
        If the point is not three finite numbers, or lies outside the camera's view.
    """
    if not isinstance(point, Sequence | np.ndarray):
        raise ParameterError(f"point is {shown(point)}; give three numbers, x, y and z.")
    target = as_reals("point", point, 3)
    with LOCK:
        mitsuba, sensor = load_mitsuba(), sensor_of(scene)
        interaction = mitsuba.Interaction3f()
        interaction.p = mitsuba.Point3f(*target)
        seen, _ = sensor.sample_direction(interaction, mitsuba.Point2f(0.5))
        if not float(seen.pdf[0]) > 0.0:
            raise ParameterError(
                f"The camera of {scene_name(scene)} does not see the point {target}."
            )
        return float(seen.uv.x[0]), float(seen.uv.y[0])


def find_emitter(scene: Scene, light: int | str) -> Any:
    """Return the light of a scene with this index or name. A name may also be the id of its shape.

    Raises
    ------
    ParameterError
        If no light has this name or index; the message lists all lights.
    """
    emitters, names = load_scene(scene).emitters(), emitter_names(scene)
    if isinstance(light, str):
        if light in names:
            return emitters[names.index(light)]
        hint, _ = close_match_hint(light, names)
        raise ParameterError(f"The scene {scene_name(scene)} has no light {shown(light)}.{hint}")
    if not emitters:
        raise ParameterError(f"The scene {scene_name(scene)} has no lights; add an emitter to it.")
    try:
        return emitters[as_integer("light", light, least=0, most=len(emitters) - 1)]
    except ParameterError as error:
        raise ParameterError(error, f" The lights are {', '.join(names)}.") from None


def emitter_name(emitter: Any, scene: Any = None) -> str:
    """Return the id of an emitter's shape, or its own id if it has no shape.

    Without an id, the name is ``emitter-K``, where K is the emitter's index in the Mitsuba `scene`.
    If no scene is given, the name is the emitter's class.
    """
    shape = emitter.get_shape()
    name = str(shape.id() if shape is not None else emitter.id())
    if name or scene is None:
        return name or str(emitter.class_name())
    return next(f"emitter-{k}" for k, e in enumerate(scene.emitters()) if e == emitter)


def emitter_names(scene: Scene) -> list[str]:
    """Return the names of all lights of a scene, in order."""
    loaded = load_scene(scene)
    return [emitter_name(emitter, loaded) for emitter in loaded.emitters()]


@functools.lru_cache(maxsize=16)
def _built(request: str | Path | DictScene, _state: Hashable = None) -> Any:
    """Load a scene from a name, a dictionary, or a file in its current state."""
    mitsuba, name = load_mitsuba(), str(request)
    load: Any = mitsuba.load_file
    source: Any = name
    if not isinstance(request, Path):
        load = mitsuba.load_dict
        source = SCENES.build(parse(name)) if isinstance(request, str) else request.contents
    register_samplers(VARIANT)  # the scene may use one of our samplers
    try:
        # Do not optimize the scene: merging renames shapes and changes their order
        with threads_for_files():
            scene = load(source, optimize=False)
    except (RuntimeError, TypeError, UnicodeDecodeError) as error:
        raise FileFormatError(
            f"Mitsuba cannot read the scene {shown(name)}: {mitsuba_reason(error)}."
        ) from None
    if not isinstance(scene, mitsuba.Scene):
        raise FileFormatError(f"{shown(name)} holds no scene; its root element must be <scene>.")
    found = what_fails(scene)
    if found is None:
        return scene
    part, reason = found[0], mitsuba_reason(found[1])
    # Delete the scene with its materials.
    # Otherwise Dr.Jit also runs the code of these materials when it records other scenes
    del scene, found
    gc.collect()
    raise ParameterError(
        f"Mitsuba cannot evaluate {part} in the scene {shown(name)}: {reason}; change its "
        "parameters or textures."
    )


def mitsuba_reason(error: Exception) -> str:
    """Return Mitsuba's message in one line, without references to Mitsuba's source code.

    For an error in a Python plugin, return the last line of the traceback without the error's type.
    """
    text = str(error).strip()
    if "Traceback" in text:
        text = text.splitlines()[-1].partition(": ")[2]
    words = " ".join(re.sub(r"\[\w+\.(?:cpp|h):\d+\]\s*", "", text).split()).rstrip(".")
    # With bytes that are not UTF-8 in Mitsuba's message, some versions of Python leave it empty
    return printable(words, _LONGEST_REASON) or "it gives no reason; is the file valid utf-8"


def _as_file(request: str | Path) -> Path | None:
    """Return the path if a request is a path, or None if it is a name."""
    if isinstance(request, Path):
        return request.expanduser()
    looks = request.lower().endswith(".xml")
    looks = looks or (("/" in request or "\\" in request) and "(" not in request)
    return Path(request).expanduser() if looks else None


@final
class DictScene:
    """A Mitsuba scene dictionary as a cache key. Two keys are equal if their contents are equal.

    Parameters
    ----------
    scene
        A scene dictionary for `mitsuba.load_dict`.
        Dictionaries, lists and arrays in the scene are copied, so later changes have no effect.
        Transforms, bitmaps and arrays are compared by their numbers,
        and objects that Mitsuba has already built are compared by identity.

    Raises
    ------
    ParameterError
        If the root's ``type`` is not ``"scene"``, a key is not a string, or nesting is too deep.

    Notes
    -----
    The dictionary prints as ``dict``. It can be pickled only if it holds no Mitsuba objects.
    """

    def __init__(self, scene: Mapping[str, Any]) -> None:
        if scene.get("type") != "scene":
            raise ParameterError(
                f"The root of a scene dictionary has the type {shown(scene.get('type'))}; "
                "it must be 'scene'."
            )
        self._copy: dict[str, Any] = _copied(scene)
        self._key = _key(self._copy)

    @property
    def contents(self) -> dict[str, Any]:
        """Return a copy of the dictionary."""
        return dict(_copied(self._copy))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, DictScene) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    def __repr__(self) -> str:
        return "dict"

    def __reduce__(self) -> tuple[Any, ...]:
        return DictScene, (self._copy,)  # Ids of objects differ between processes


def _copied(value: Any, depth: int = 0) -> Any:
    """Copy a scene dictionary, and check that paths in it belong to regular files."""
    if depth > DEEPEST:
        raise ParameterError(
            f"The scene dictionary is nested more than {DEEPEST} deep; remove parts that contain "
            "themselves."
        )
    if isinstance(value, Mapping):
        for name in value:
            if not isinstance(name, str):
                raise ParameterError(
                    f"A key of the scene dictionary is {shown(name)}; it must be a string."
                )
        if isinstance(name := value.get("filename"), str) and len(name) <= _LONGEST_PATH:
            _regular(Path(name), Path("dict"))
        if isinstance(name := value.get("type"), str):
            check_plugin(name, [Path.cwd()])
        if isinstance(name := value.get("material"), str) and "/" in name:
            raise ParameterError(
                f"A material of the scene dictionary is {shown(name)}; give a name such as 'Au'."
            )
        return {name: _copied(entry, depth + 1) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_copied(entry, depth + 1) for entry in value]
    return value.copy() if isinstance(value, np.ndarray) else value


def _key(value: Any) -> Hashable:
    # Keep the order of entries, which determines the order and the index of lights
    if isinstance(value, Mapping):
        return "dict", tuple((name, _key(entry)) for name, entry in value.items())
    if isinstance(value, list):
        return "list", tuple(map(_key, value))
    if isinstance(value, str | int | float | bool | None):
        return type(value).__name__, value
    # Use the numbers in an array, a bitmap or a transform
    holder = getattr(value, "matrix", value)
    readable = hasattr(holder, "__array__") or hasattr(holder, "__array_interface__")
    numbers = np.asarray(holder if readable else None)
    if numbers.dtype == object:
        return "object", id(value)  # the scene keeps the object, so its address is unique
    digest = hashlib.sha256(np.ascontiguousarray(numbers).tobytes()).hexdigest()
    return type(value).__name__, numbers.shape, str(numbers.dtype), digest


State: TypeAlias = "tuple[tuple[Path, int, int], ...]"
"""State of files: for each its path, its size in bytes, and its time of change in nanoseconds."""

DEEPEST = 64
"""Largest depth of nested elements, in files and in dictionaries.

Shapes in groups with nested materials and textures reach 12 levels.
A depth of about 10,000 levels would crash the process.
"""

MOST_ELEMENTS = 2**21
"""Largest number of elements, counting repeated includes: 700,000 shapes load in 20 s."""

MOST_XML = 2**26
"""Largest size of an XML file in bytes: a million elements take about 32 MB."""

_LONGEST_REASON = 300  # maximum length of Mitsuba's message in characters
_INCLUDES = 16  # maximum levels of includes; Mitsuba allows at most 15
_MOST_NAMES = 64  # maximum number of values that the parameters in one text can produce
# Maximum number of searches for names in a scene. Each search may resolve an include or a default
_MOST_ROUNDS = 64
_LONGEST_PATH = 4096  # maximum length of a path in Linux; a longer text cannot be a file
_LONGEST_PARAMETER, _LONGEST_TEXT = 64, 2**20  # longest name and longest text, in characters
_PARAMETER = re.compile(rf"\w{{1,{_LONGEST_PARAMETER}}}", re.ASCII)
_PLUGIN_NAME = re.compile(r"[\w-]+")
_LIBRARIES = (".so", ".dylib", ".dll")
_COMMENT = re.compile(rb"<!--(.*?)-->", re.DOTALL)
_watched: dict[Path, State] = {}


def watched_state(scene: Path) -> State:
    """Return the state of a scene's file and of all files that it names, for comparison.

    The XML is read again only if one of the files has changed since the last call.
    A file counts as unchanged if its size and its time of change are equal.
    The check takes a few microseconds per file.
    """
    file = scene.resolve()
    known = _watched.get(file, ())
    if not known or _states(path for path, *_ in known) != known:
        known = _watched[file] = _states((file, *sorted(referenced_files(file))))
    return known


def referenced_files(
    scene: Path, definitions: Mapping[str, str] | None = None, trust: Trust | None = None
) -> set[Path]:
    """Return the existing files that a scene's XML names. Included XML files are also read.

    A name is searched for in the folders of the scene, of the naming file, and of every ``<path>``.
    A file that is in none of these folders is searched for in the current folder.
    A file that is not XML names no other file. All XML that Mitsuba would parse is checked.

    Parameters
    ----------
    scene
        XML file.
    definitions
        Values for each ``$name`` in the file. The file's own ``<default>`` values are added.
    trust
        Files that an untrusted scene may name.
        None allows every file, for a scene that the user gave directly.

    Raises
    ------
    FileFormatError
        If a file is larger, has more elements, or nests them deeper than this module allows.
        If a file has a document type with entities, or is long and not well-formed XML.
        If a name belongs to a device or a pipe.
        If a picture takes too much memory (see `mcspectra.core.decoding`).
        If a plugin that the scene uses does not belong to Mitsuba.
    ConfigError
        If a name or link points outside the folders of `trust`, even if the file does not exist.
    """
    first = scene.resolve()
    if trust is not None and trust.reads_all:
        trust = None
    own = mitsuba_folder()
    own_too = (trust or Trust()).widened(folders=[] if own is None else [own])
    values: dict[str, dict[str, None]] = {k: {v: None} for k, v in (definitions or {}).items()}
    folders, here = {first.parent: None}, Path.cwd()
    files: dict[Path, _SceneFile] = {}
    # Paths of the files that a scene file includes.
    # The dictionary's key is a scene file, and the position of the included name in this file
    places_of: dict[tuple[Path, int], dict[Path, None]] = {}
    found: set[Path] = set()

    @functools.cache
    def places(name: str, where: tuple[Path, ...], named_in: str) -> list[Path]:
        """Return the paths of files with this name; `trust`, if given, must allow each path."""
        beside = [place for folder in where if (place := _regular(folder / name, first))]
        if not beside and (elsewhere := _regular(here / name, first)):
            beside = [elsewhere]
        if trust is not None:
            for folder in where:
                trust.check_scene_file(folder / name, name, named_in)
            # Mitsuba searches other files in its own folder and in the current folder
            if not _exists(first.parent / name):
                if _exists(here / name):
                    trust.check_scene_file(here / name, name, named_in)
                if own is not None and _exists(own / name):
                    own_too.check_scene_file(own / name, name, named_in)
        return beside

    before = (-1, -1, -1)
    rounds = 0
    # Search for all names again in each pass, because a file may have defined a folder or a value
    while before != (now := (len(files), len(folders), sum(map(len, values.values())))):
        before, rounds = now, rounds + 1
        if rounds > _MOST_ROUNDS:
            raise FileFormatError(
                f"The scene {str(scene)!r} has defaults that refer to later ones; define each "
                "before it is used."
            )
        if first not in files:
            files[first] = _parsed(first)
        for file, parsed in list(files.items()):
            if trust is not None and parsed.unclear:
                raise FileFormatError(
                    f"The scene file {str(file)!r} {parsed.unclear}; the scene file of a study "
                    "must be plain XML in UTF-8: correct it."
                )
            for parameter, text in parsed.defaults:
                if trust is not None and not _PARAMETER.fullmatch(parameter):
                    raise FileFormatError(
                        f"The scene file {str(file)!r} has the parameter {parameter[:80]!r}; its "
                        "name must be letters, digits and underscores."
                    )
                known = values.setdefault(parameter, {})
                known.update(dict.fromkeys(_expanded(text, values, file)))
                if len(known) > _MOST_NAMES:
                    raise _too_many(file, text)
            for number, (tag, _, text, line) in enumerate(parsed.names):
                where = f"The scene file {str(file)!r}, <{tag}> in line {line},"
                for name in _expanded(text, values, file):
                    around = tuple(folders | {file.parent: None})
                    if trust is not None and tag == "string":
                        trust.check_scene_spec(name, where)
                        for ending in ("eta", "k"):  # Mitsuba may open two files per material
                            places(f"data/ior/{name}.{ending}.spd", around, where)
                    if tag == "path":
                        for folder in (*around, here):
                            place = folder / name
                            if trust is not None and (folder != here or _exists(place)):
                                trust.check_scene_file(place, name, where)
                            if _exists(place, stat.S_ISDIR):
                                folders.setdefault(place.resolve())
                        continue
                    for place in places(name, around, where if trust else ""):
                        places_of.setdefault((file, number), {})[place] = None
                        is_xml = tag == "include" or place.suffix.lower() == ".xml"
                        if is_xml and place not in files:
                            files[place] = _parsed(place)
                        elif place not in found and not is_xml:
                            check_picture_size(place)
                        found.add(place)
            for text in parsed.plugins:
                for name in _expanded(text, values, file):
                    check_plugin(name, (*folders, file.parent, here))

    # Count elements and their depth as if all includes were expanded
    @functools.cache
    def extent(file: Path, level: int) -> tuple[int, int]:
        count, deepest = files[file].elements, files[file].depth
        for number, (tag, depth, *_) in enumerate(files[file].names):
            if tag == "include" and level < _INCLUDES:
                inner = [extent(place, level + 1) for place in places_of.get((file, number), ())]
                count += max((elements for elements, _ in inner), default=0)
                deepest = max(deepest, depth + max((below for _, below in inner), default=0))
        return count, deepest

    count, deepest = extent(first, 0)
    if count > MOST_ELEMENTS:
        raise FileFormatError(
            f"The scene {str(scene)!r} has {count} elements, with those that it includes; give at "
            f"most {MOST_ELEMENTS}."
        )
    if deepest > DEEPEST:
        raise FileFormatError(
            f"The scene {str(scene)!r} has elements nested {deepest} deep; give at most {DEEPEST}."
        )
    return found - {first}


@dataclass
class _SceneFile:
    """Checked contents of an XML file: its ``<default>`` values, plugins, and named files.

    Attributes
    ----------
    names
        Element, depth, text and line number of every entry that may name a file.
    unclear
        Why Mitsuba's parser may read the file differently than this module; empty if it does not.
    """

    elements: int = 0
    depth: int = 0
    defaults: list[tuple[str, str]] = field(default_factory=list)
    names: list[tuple[str, int, str, int]] = field(default_factory=list)
    plugins: set[str] = field(default_factory=set)
    unclear: str = ""


def _parsed(file: Path) -> _SceneFile:
    """Read an XML file without building a tree. A short file that is not XML names no files."""
    try:
        size = file.stat().st_size
        data = file.read_bytes() if size <= MOST_XML else b""
    except OSError:
        return _SceneFile()
    if size > MOST_XML:
        raise FileFormatError(
            f"The scene file {str(file)!r} has {size} bytes; give at most {MOST_XML}, and meshes "
            "as files of their own."
        )
    try:
        return _elements(file, data)
    except ExpatError as error:
        wrong = error
    # Mitsuba's parser accepts "--" in comments, and other text that is not XML
    if b"<![CDATA[" not in data and data.count(b"<?") < 2:
        plain = _COMMENT.sub(lambda m: b"<!--" + m[1].replace(b"-", b" ") + b"-->", data)
        with contextlib.suppress(ExpatError):
            return _elements(file, plain)
    if data.count(b"<") > DEEPEST:
        raise FileFormatError(f"The scene file {str(file)!r} is not XML: {wrong}; correct it.")
    return _SceneFile(unclear=f"is not XML ({wrong})")


def _elements(file: Path, data: bytes) -> _SceneFile:
    found, depth = _SceneFile(), 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        found.elements += 1
        found.depth = max(found.depth, depth)
        value = attributes.get("value", "")
        name = attributes.get("filename") or (value if tag in ("string", "path") else "")
        if found.depth > DEEPEST or found.elements > MOST_ELEMENTS:
            return  # The file is rejected later; the message states the counted size and depth
        # The text \$ is an escape. A default value with a backslash may form it when inserted
        if any("\\$" in each for each in attributes.values()) or (
            tag == "default" and "\\" in value
        ):
            found.unclear = "has the escape \\$, or a default with a backslash"
        if "type" in attributes:
            found.plugins.add(attributes["type"])
        if tag == "default":
            found.defaults.append((attributes.get("name", ""), value))
        elif name and ("$" in name or len(name) <= _LONGEST_PATH):
            found.names.append((tag, depth, name, parser.CurrentLineNumber))

    def end(_: str) -> None:
        nonlocal depth
        depth -= 1

    def doctype(*given: Any) -> None:
        if given[-1]:
            raise FileFormatError(
                f"The scene file {str(file)!r} has a document type with declarations; remove it."
            )
        found.unclear = "has a document type"

    def declaration(_: str, encoding: str | None, __: int) -> None:
        if (encoding or "utf-8").lower() not in ("utf-8", "us-ascii"):
            found.unclear = f"has the encoding {encoding!r:.40}"

    parser = ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.StartDoctypeDeclHandler, parser.XmlDeclHandler = doctype, declaration
    if b"\0" in data or data.startswith((b"\xff\xfe", b"\xfe\xff")):
        found.unclear = "has the encoding UTF-16"
    try:
        parser.Parse(data, True)
    except McspectraError:
        raise
    except (
        LookupError,
        ValueError,
    ) as error:  # the encoding is unknown to Python, or multi-byte
        raise ExpatError(str(error)) from None
    return found


def _expanded(text: str, values: Mapping[str, Iterable[str]], file: Path) -> list[str]:
    """Return all versions of a text: each parameter ``$name`` is replaced by each of its values.

    A parameter without a value is not replaced.
    Mitsuba replaces the names that have a value when it reads the text.
    If ``a`` has a value but ``ab`` does not yet, Mitsuba replaces only the ``$a`` in ``$ab``.
    """
    beginning, *rest = text.split("$")
    found = [beginning]
    for part in rest:
        names = (part[:k] for k in range(1, min(len(part), _LONGEST_PARAMETER) + 1))
        choices = [
            value + part[len(name) :] for name in names for value in values.get(name, ())
        ] or [f"${part}"]
        found = list(dict.fromkeys(before + each for before in found for each in choices))
        if len(found) > _MOST_NAMES or max(map(len, found)) > _LONGEST_TEXT:
            raise _too_many(file, text)
    return found


def _too_many(file: Path, text: str) -> FileFormatError:
    return FileFormatError(
        f"The scene file {str(file)!r} has more than {_MOST_NAMES} values for {text[:80]!r}, or "
        f"longer ones than {_LONGEST_TEXT} characters; give its parameters one value each."
    )


def check_plugin(name: str, folders: Iterable[Path]) -> None:
    """Reject a plugin if one of these folders has a library of this name. Mitsuba would run it.

    Raises
    ------
    FileFormatError
        If a library with this name exists, or the name is a path.
    """
    if "$" in name:  # Mitsuba itself rejects undefined parameters in names
        return
    if not _PLUGIN_NAME.fullmatch(name):
        raise FileFormatError(
            f"A scene has the plugin {shown(name)}; names of plugins have letters, digits, hyphens "
            "and underscores."
        )
    home = mitsuba_folder()
    own = None if home is None else home / "plugins"
    for folder in dict.fromkeys(folders):
        for ending in _LIBRARIES:
            place = folder / "plugins" / f"{name}{ending}"
            if _exists(place) and place.resolve().parent != own:
                raise FileFormatError(
                    f"The plugin {shown(name)} is in {str(place)!r}; a scene's own libraries are "
                    "not run: remove it, or put it into Mitsuba's folder of plugins."
                )


def _exists(place: Path, kind: Callable[[int], bool] = bool) -> bool:
    """Whether a path exists and has this file type; false if its name is too long."""
    try:
        return kind(place.stat().st_mode)
    except (OSError, ValueError):
        return False


def _regular(place: Path, scene: Path) -> Path | None:
    """Return the resolved path of a file, or None if missing. Devices and pipes raise an error."""
    try:
        place = place.resolve()
        mode = place.stat().st_mode
    except (OSError, RuntimeError, ValueError):  # RuntimeError means that links form a loop
        return None
    if stat.S_ISREG(mode):
        return place
    if not stat.S_ISDIR(mode):
        raise FileFormatError(
            f"The scene {str(scene)!r} names {str(place)!r}, a device or a pipe; give a file."
        )
    return None


def _states(files: Iterable[Path]) -> State:
    """Return the states of those files that exist."""
    found = []
    for file in files:
        with contextlib.suppress(OSError):
            status = file.stat()
            found.append((file, status.st_size, status.st_mtime_ns))
    return tuple(found)


def what_fails(scene: Any) -> tuple[str, RuntimeError] | None:
    """Return the first material or light that cannot be evaluated, with the error, or None.

    If Dr.Jit traces a call of a BSDF, it traces all BSDFs in the process, of all scenes.
    If one BSDF cannot be evaluated, all other scenes therefore fail as well.
    For this reason, each BSDF and each light of a scene is called once by itself before use.
    Calls that are only traced take microseconds. The caller must hold `backend.LOCK`.
    """
    import drjit

    # Create a surface point in its local frame
    mitsuba = load_mitsuba()
    at = drjit.zeros(mitsuba.SurfaceInteraction3f)
    at.n = at.wi = mitsuba.Normal3f(0.0, 0.0, 1.0)
    at.sh_frame = mitsuba.Frame3f(at.n)
    at.dp_du, at.dp_dv = mitsuba.Vector3f(1.0, 0.0, 0.0), mitsuba.Vector3f(0.0, 1.0, 0.0)
    context, u = mitsuba.BSDFContext(), mitsuba.Point2f(0.5)

    part = ""
    seen: list[Any] = []
    try:
        for shape in scene.shapes():
            bsdf = shape.bsdf()
            if bsdf is None or any(bsdf is other for other in seen):
                continue
            seen.append(bsdf)
            part = f"the BSDF ({bsdf.class_name()}) of the shape {shape.id()!r}"
            bsdf.sample(context, at, mitsuba.Float(0.5), u)
            bsdf.eval_pdf(context, at, mitsuba.Vector3f(0.0, 0.6, 0.8))
        for light in scene.emitters():
            part = f"the light {light.id()!r} ({light.class_name()})"
            light.sample_direction(at, u)
            light.eval(at)
    except RuntimeError as error:
        return part, error
    return None
