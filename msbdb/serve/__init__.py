"""A server of a database for browsers and GIS clients: OGC API Features and Tiles by pygeoapi, and the page in 3-D."""
