"""Styles, forms and projects for QGIS, written as its own XML."""
