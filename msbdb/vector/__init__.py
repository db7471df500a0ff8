"""From raster labels to polygons with shared edges, and back."""
