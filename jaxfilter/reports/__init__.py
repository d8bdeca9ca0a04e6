"""Reports on a classification for people who check terrain models: one HTML file, and a list of places for a GIS."""
