"""Simulated airborne lidar surveys whose truth is known at every point: ``scenes.make("town", density=4)``."""

from .layouts import ASPRS, LAYOUTS, Kind, Layout
from .scene import Scene, make

__all__ = ["ASPRS", "LAYOUTS", "Kind", "Layout", "Scene", "make"]
