"""Checks by people: verdicts on places are carried out, and a statement says how accurate a terrain model is."""
