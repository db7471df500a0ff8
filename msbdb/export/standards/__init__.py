"""Formats with a schema of their own: CityJSON, exposure of OpenQuake, Overture, INSPIRE."""
