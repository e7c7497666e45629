from .profiling import Profile as Profile
from .profiling import profile as profile
from .scene_profile import SceneProfile as SceneProfile
from .scene_profile import plan_scene as plan_scene
from .scene_profile import profile_scene as profile_scene

__all__ = [
    "Profile",
    "SceneProfile",
    "plan_scene",
    "profile",
    "profile_scene",
]
