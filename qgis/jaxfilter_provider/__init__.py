"""The plugin of QGIS that runs the command ``jaxfilter``; it does not import the package of that name."""

from __future__ import annotations

from typing import Any


def classFactory(iface: Any) -> Any:
    """What QGIS calls to load the plugin; ``iface`` is None in qgis_process."""
    from .provider import Plugin

    return Plugin()
