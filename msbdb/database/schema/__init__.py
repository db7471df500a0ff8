"""The tables, views and SQL texts of the database, generated from their declarations, and its one CRS."""
