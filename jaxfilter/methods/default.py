"""The method to take when nothing else is known."""

from __future__ import annotations

from typing import Any

from .ost import OST


def default_filter(cloud: Any, largest_building: float | None = None) -> OST:
    """The filter for a cloud of which nothing is known but its points: :class:`OST`, set up for their spacing.

    Args:
        cloud: a PointCloud, a ``laspy.LasData``, or coordinates f64[n, 3] in metres; whatever a filter takes.
        largest_building: width of the largest building in the cloud, metres, where it is known; without it up to 50 m.

    Returns: a filter; ``default_filter(cloud)(cloud)`` classifies the cloud.
    Raises: ParameterError.

    >>> filter_ = jf.default_filter(cloud)
    >>> type(filter_).__name__, round(filter_.spacing, 1)
    ('OST', 1.0)
    """
    return OST.for_cloud(cloud, largest_building)
