from .causes import Cause as Cause
from .primary import primary_picture as primary_picture

__all__ = [
    "Cause",
    "primary_picture",
]
