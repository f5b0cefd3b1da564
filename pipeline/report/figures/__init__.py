"""The paper's figures, from the reader's own data: PNG and SVG files, the same bytes each time."""
