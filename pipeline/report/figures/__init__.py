"""Draw the figures of the paper from the user's own data, as PNG and SVG files."""
