"""From labels to polygons with shared edges, and back; outlines of points; simplification."""
