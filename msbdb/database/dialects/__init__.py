"""SpatiaLite and PostGIS behind one interface: opening a database, and the versions of its schema."""
