"""Reports on a classification for people who check terrain models: one HTML file that needs no network."""

from .page import report as report
