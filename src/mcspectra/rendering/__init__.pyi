from .backend import describe as describe
from .backend import load_mitsuba as load_mitsuba
from .builtin import veach as veach
from .files import write_comparison as write_comparison
from .files import write_exr as write_exr
from .files import write_png as write_png
from .files import write_render as write_render
from .frame_statistics import frames as frames
from .gate import gate as gate
from .gate_frames import write_reference as write_reference
from .image import compare_strategies as compare_strategies
from .image import reference as reference
from .image import render as render
from .maps import variance_map as variance_map
from .paths import PathPixel as PathPixel
from .paths import path_pixel as path_pixel
from .pixel import Pixel as Pixel
from .pixel import PixelMIS as PixelMIS
from .pixel import describe_pixel as describe_pixel
from .pixel import pixel_mis as pixel_mis
from .pixel import pixel_strategies as pixel_strategies
from .plugin import register_samplers as register_samplers
from .point_sampler import MitsubaSampler as MitsubaSampler
from .point_sampler import from_mitsuba as from_mitsuba
from .scene_checks import check_scene as check_scene
from .scenes import SCENES as SCENES
from .scenes import load_scene as load_scene
from .scenes import named_pixels as named_pixels
from .scenes import project as project
from .scenes import render_file as render_file
from .screen_samplers import CommandScreen as CommandScreen
from .screen_samplers import FunctionScreen as FunctionScreen
from .screen_samplers import PythonScreen as PythonScreen
from .screen_samplers import ScreenBlock as ScreenBlock
from .screen_samplers import ScreenSampler as ScreenSampler
from .screen_samplers import Tables as Tables
from .screen_samplers import Tiles as Tiles
from .screen_samplers import as_screen_sampler as as_screen_sampler
from .screen_spectra import screen_spectrum as screen_spectrum
from .skies import sky_pixels as sky_pixels
from .wavefront import Wavefront as Wavefront

__all__ = [
    "SCENES",
    "CommandScreen",
    "FunctionScreen",
    "MitsubaSampler",
    "PathPixel",
    "Pixel",
    "PixelMIS",
    "PythonScreen",
    "ScreenBlock",
    "ScreenSampler",
    "Tables",
    "Tiles",
    "Wavefront",
    "as_screen_sampler",
    "check_scene",
    "compare_strategies",
    "describe",
    "describe_pixel",
    "frames",
    "from_mitsuba",
    "gate",
    "load_mitsuba",
    "load_scene",
    "named_pixels",
    "path_pixel",
    "pixel_mis",
    "pixel_strategies",
    "project",
    "reference",
    "register_samplers",
    "render",
    "render_file",
    "screen_spectrum",
    "sky_pixels",
    "variance_map",
    "veach",
    "write_comparison",
    "write_exr",
    "write_png",
    "write_reference",
    "write_render",
]
