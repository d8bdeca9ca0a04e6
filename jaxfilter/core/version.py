"""The version of this library, which pyproject.toml and CITATION.cff say too."""

__version__ = "0.2.0"
