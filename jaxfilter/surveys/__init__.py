"""Surveys of many files: what they hold, where it lies, and what does not fit together."""
