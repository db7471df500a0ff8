"""SpatiaLite and PostGIS behind one set of names, and how a database is opened."""
