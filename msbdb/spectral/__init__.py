"""Spectral classes: from image bands to a class map, by gridding, filtering, k-means and suggested labels."""
