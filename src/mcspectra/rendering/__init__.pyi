from .backend import describe as describe
from .backend import load_mitsuba as load_mitsuba
from .builtin.veach import veach as veach
from .pixel import Pixel as Pixel
from .pixel import describe_pixel as describe_pixel
from .pixel import pixel_strategies as pixel_strategies
from .point_sampler import MitsubaSampler as MitsubaSampler
from .scene_checks import check_scene as check_scene
from .scenes import SCENES as SCENES
from .scenes import load_scene as load_scene
from .scenes import named_pixels as named_pixels
from .scenes import project as project

__all__ = [
    "SCENES",
    "MitsubaSampler",
    "Pixel",
    "check_scene",
    "describe",
    "describe_pixel",
    "load_mitsuba",
    "load_scene",
    "named_pixels",
    "pixel_strategies",
    "project",
    "veach",
]
