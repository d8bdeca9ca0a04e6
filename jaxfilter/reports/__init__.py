"""Reports on a classification for people who check terrain models: one HTML file, and a list of places for a GIS."""

from .page import ReportOptions as ReportOptions
from .page import report as report
from .places import review as review
