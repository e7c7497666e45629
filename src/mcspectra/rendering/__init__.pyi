from .backend import describe as describe
from .backend import load_mitsuba as load_mitsuba
from .pixel import Pixel as Pixel
from .pixel import describe_pixel as describe_pixel
from .pixel import pixel_strategies as pixel_strategies
from .point_sampler import MitsubaSampler as MitsubaSampler
from .scenes import SCENES as SCENES
from .scenes import load_scene as load_scene
from .scenes import project as project
from .scenes import veach as veach

__all__ = [
    "SCENES",
    "MitsubaSampler",
    "Pixel",
    "describe",
    "describe_pixel",
    "load_mitsuba",
    "load_scene",
    "pixel_strategies",
    "project",
    "veach",
]
