"""SpatiaLite and PostGIS behind one interface, and opening a database."""
