"""Care of a database: create, upgrade, copy, dump, check, and grant rights."""
