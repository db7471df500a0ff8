"""The tables, views and queries of the database, generated from their declarations, and its versions."""
